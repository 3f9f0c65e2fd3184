//! The table and the report that verbs print after fitting surfaces.

use anyhow::Result;
use serde_json::{Map, Value, json};
use spharm_cli::machine::memory;
use spharm_cli::output::{counted, is_stdout, print, print_json, table, write_json};
use spharm_cohort::State;
use spharm_solver::threaded::{Kernels, ThreadedKernels};

use super::console::Summary;
use super::fitted::{Columns, number};
use super::options::Options;

/// Returns the report on a call as JSON.
pub(super) fn report(options: &Options, summary: &Summary, total: f64) -> Value {
    let method = &options.run.fit.method;
    let mut report = Map::new();
    let mut set = |name: &str, value: Value| drop(report.insert(name.to_owned(), value));
    set("versions", json!(spharm::versions()));
    set("method", json!(method.name()));
    options.about.iter().for_each(|(name, value)| set(name, value.clone()));
    // The scheme's key is reported only if all surfaces share one sphere.
    set(
        "scheme_key",
        json!(summary.scheme.as_ref().filter(|_| options.about.get("sphere").is_some_and(|s| !s.is_null()))),
    );
    set("dtype", json!(summary.dtype));
    set("granularity", json!(method.granularity()));
    set("start_degree", json!(method.start_degree()));
    set("dense_kernels", json!(Kernels::version()));
    let rows: usize = summary.counts().map(|(_, count)| count).sum();
    let counts = summary.counts().map(|(state, count)| (state.name().to_owned(), json!(count)));
    set("rows", Value::Object([("all".to_owned(), json!(rows))].into_iter().chain(counts).collect()));
    match &summary.fitted {
        Some(fitted) => {
            set("surfaces", json!(fitted));
            set("skipped", json!(summary.skipped));
            set("batches", json!(summary.batches));
        }
        None => {
            let [msd, xsd] = summary.distances();
            set("msd", msd);
            set("xsd", xsd);
            set("worst", json!(summary.worst));
        }
    }
    set("failed", json!(summary.failed));
    let seconds = &summary.seconds;
    set(
        "seconds",
        json!({
            "read": seconds.read, "parametrize": summary.parametrize, "plan": seconds.plan, "solve": seconds.solve,
            "write": seconds.write, "total": total,
        }),
    );
    set("memory", json!(memory()));
    Value::Object(report)
}

/// Writes the report to a file, if a file was requested.
pub(super) fn write(options: &Options, report: &Value) -> Result<()> {
    let Some(path) = &options.report else { return Ok(()) };
    write_json(path, options.replaces_report(), report)
}

/// Prints the report as JSON if `--json` was given, otherwise the table.
pub(super) fn show(options: &Options, report: &Value, summary: &Summary, total: f64) -> Result<()> {
    if options.report.as_deref().is_some_and(is_stdout) {
        return Ok(());
    }
    if options.json {
        return print_json(report);
    }
    let done = summary.count(State::Done);
    if summary.counts().all(|(_, count)| count == 0) {
        return print(&match options.about.get("shard").and_then(Value::as_str) {
            Some(shard) => format!("shard {shard} has no rows"),
            None => "no rows".to_owned(),
        });
    }
    let nothing = summary.counts().all(|(state, count)| state == State::Skipped || count == 0);
    if nothing {
        return print("nothing to do: every output exists");
    }
    match &summary.fitted {
        Some(fitted) if fitted.is_empty() => print(&format!("no model\n{total:.2} s")),
        Some(fitted) => {
            let columns = Columns::of(fitted);
            let mut rows = vec![columns.head()];
            rows.extend(fitted.iter().filter_map(|fitted| fitted.cells(columns)));
            print(&format!("{}\n{}\n{total:.2} s", table(&rows), columns.units()))
        }
        None => {
            let mut rows = vec![["largest error", "msd", "xsd", "file"].map(str::to_owned).to_vec()];
            rows.extend(summary.worst.iter().map(|of| {
                vec![of.id.clone(), number(Some(of.msd)), number(Some(of.xsd)), of.output.display().to_string()]
            }));
            let others = summary.counts().filter(|(state, count)| *state != State::Done && *count > 0);
            let others: String = others.map(|(state, count)| format!(", {count} {state}")).collect();
            let units = "msd, xsd: squared distances at the vertices, bounding box scaled to volume 1";
            print(&format!("{}{others}\n{}\n{units}\n{total:.2} s", counted(done, "model"), table(&rows)))
        }
    }
}
