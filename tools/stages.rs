//! A parameterisation's stages on the console, one bar after the other.

use spharm_cli::console::{Console, Unit};
use spharm_parametrize::Event;

/// Shows what it is told of.
pub(crate) fn shown(console: &Console) -> impl FnMut(Event) {
    let mut bar = None;
    move |event| match event {
        Event::Begin { stage, steps } => {
            // The last one has to go from the screen before the next comes.
            bar = None;
            bar = Some(console.progress(stage, steps, Unit::Count("steps")));
        }
        Event::Step(steps) => {
            if let Some(bar) = &bar {
                bar.add(steps);
            }
        }
        _ => {}
    }
}
