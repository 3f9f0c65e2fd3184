//! Gives advice on errors and warnings of fits.

use std::path::PathBuf;

use spharm::machine::available_memory;
use spharm::{Error, FitParams, Method, Smoothness};
use spharm_cohort::rerun::Refusal;

use crate::names::NameTemplate;

/// Returns the advice on an error of a fit.
pub(super) fn of_fit(error: &Error) -> Option<String> {
    match error {
        Error::HoldOut { fraction, .. } => Some(format!("--hold-out {fraction} is too small")),
        Error::Memory { needed, .. } => Some(of_memory(*needed)),
        Error::Degree { .. } => Some("give a lower --max-degree".to_owned()),
        Error::NotConverged(_) => Some("without --strict this is only a warning".to_owned()),
        _ => None,
    }
}

/// Returns the advice on a memory budget that is too small. If the free memory is also too small, the advice states how
/// much memory is free.
fn of_memory(needed: usize) -> String {
    let free = available_memory();
    if free >= needed {
        return "give a budget with --memory".to_owned();
    }
    format!(
        "only {} MiB are free; use a machine with more free memory, or raise the memory limit of the process (ulimit) \
         or of its control group",
        free >> 20
    )
}

/// Returns the advice on an existing output that must not be replaced.
pub(super) fn of_refusal(refusal: &Refusal) -> String {
    match refusal {
        Refusal::OtherInput { recorded, input, .. } => {
            let inputs = [recorded, input].map(PathBuf::from);
            let template = NameTemplate::distinguishing(&inputs);
            let template = template.map_or(String::new(), |template| format!("--name-template '{template}', "));
            format!("give {template}another --output, or --force to replace it")
        }
        Refusal::Exists { .. } => "choose another --output, or give --force or --skip-existing".to_owned(),
        _ => "choose another --output, or give --force to replace it".to_owned(),
    }
}

/// Returns the advice on a model that oscillates between the vertices.
pub fn of_oscillation(params: &FitParams) -> String {
    let smoother = match (params.method, params.smoothness) {
        (Method::Lsq, Smoothness::Auto) => "",
        (Method::Lsq, _) => "--objective vertices --smoothness auto, ",
        _ => "--method lsq, ",
    };
    format!("use {smoother}a lower --max-degree, or a sphere that gives large triangles more area")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_that_the_free_memory_limits_is_explained() {
        let advice = |needed| of_fit(&Error::Memory { budget: 1, needed }).unwrap();
        assert!(advice(1 << 10).contains("--memory"));
        assert!(advice(usize::MAX).contains("MiB are free") && advice(usize::MAX).contains("ulimit"));
    }
}
