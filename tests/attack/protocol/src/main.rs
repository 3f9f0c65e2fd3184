//! Checks the model of publishing a store's files in all variants, and that each break of the protocol violates a
//! property. The last line of the output is a JSON object.

mod model;

use std::process::ExitCode;

use model::{Broken, Locks, Protocol};
use stateright::{Checker, Expectation, HasDiscoveries, Model};

/// Checks a protocol; returns the number of its states, and the violated properties.
fn check(protocol: Protocol) -> (usize, Vec<String>) {
    let checker = protocol.checker().threads(std::thread::available_parallelism().map_or(1, usize::from));
    let found = match protocol.broken {
        None => checker,
        // For a broken protocol, one counterexample is enough.
        Some(_) => checker.finish_when(HasDiscoveries::AnyFailures),
    };
    let found = found.spawn_bfs().join();
    let discoveries = found.discoveries();
    let mut wrong = Vec::new();
    for property in protocol.properties() {
        match (property.expectation, discoveries.get(property.name)) {
            (Expectation::Always, Some(path)) => {
                let steps: Vec<String> =
                    path.clone().into_actions().iter().map(|action| format!("{action:?}")).collect();
                wrong.push(format!("not so: {}: {}", property.name, steps.join(", ")));
            }
            (Expectation::Sometimes, None) if protocol.broken.is_none() => {
                wrong.push(format!("never: {}", property.name))
            }
            _ => {}
        }
    }
    (found.unique_state_count(), wrong)
}

fn main() -> ExitCode {
    let (mut states, mut failures) = (0, Vec::new());
    let mut variants = 0;
    let kinds = [(Locks::Honest, true), (Locks::Honest, false), (Locks::None, false), (Locks::Lying, false)];
    for (locks, folder_lock) in kinds {
        for links in [false, true] {
            let protocol = Protocol { locks, folder_lock, links, broken: None };
            let (count, wrong) = check(protocol);
            println!("{protocol:?}: {count} states");
            wrong.iter().for_each(|text| println!("  {text}"));
            failures.extend(wrong.into_iter().map(|text| format!("{protocol:?}: {text}")));
            (states, variants) = (states + count, variants + 1);
        }
    }
    let mut noticed = 0;
    for broken in Broken::ALL {
        let (_, wrong) =
            check(Protocol { locks: Locks::Honest, folder_lock: false, links: false, broken: Some(broken) });
        match wrong.first() {
            Some(text) => println!("{broken:?} is noticed: {text}"),
            None => failures.push(format!("{broken:?} isn't noticed")),
        }
        noticed += usize::from(!wrong.is_empty());
    }
    let breaks = Broken::ALL.len();
    let done = format!("{states} states of {variants} variants; {noticed} of {breaks} breaks of the protocol noticed");
    let failures_text: Vec<String> = failures.iter().map(|text| format!("{text:?}")).collect();
    println!(
        "{{\"name\": \"publishing, all interleavings\", \"done\": \"{done}\", \"failures\": [{}]}}",
        failures_text.join(", ")
    );
    ExitCode::from(u8::from(!failures.is_empty()))
}
