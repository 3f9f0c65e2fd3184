//! Determines the method of a fit from Python's keyword arguments.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use spharm::{Method, defaults};

/// Settings of the methods that read the basis from a store.
#[derive(Clone, Copy)]
pub(crate) struct Streamed {
    pub(crate) passes: usize,
    pub(crate) granularity: usize,
    pub(crate) start_degree: usize,
    pub(crate) accelerate: bool,
}

/// Returns the method of the given name.
///
/// # Errors
///
/// `ValueError` if there is no method of this name, or if the method doesn't have one of the given settings. The
/// command `spharm fit` rejects the same settings.
pub(crate) fn method(name: &str, settings: Streamed) -> PyResult<Method> {
    let Streamed { passes, granularity, start_degree, accelerate } = settings;
    let method = match name {
        "lsq" => Method::Lsq,
        "irf" => Method::Irf { passes, granularity, accelerate },
        "sirf" => Method::Sirf { start_degree },
        "mirf" => Method::Mirf { passes, start_degree, accelerate },
        "nlsf" => Method::Nlsf,
        "quadrature" => Method::Quadrature,
        found => {
            let expected = "expected lsq, irf, sirf, mirf, nlsf or quadrature";
            return Err(PyValueError::new_err(format!("method: {expected}; found {found}")));
        }
    };
    let repeated = matches!(name, "irf" | "mirf");
    let conflicts = [
        (start_degree > 0 && !matches!(name, "sirf" | "mirf"), "start_degree", "sirf or mirf"),
        (granularity != defaults::GRANULARITY && name != "irf", "granularity", "irf"),
        (accelerate && !repeated, "accelerate", "irf or mirf"),
        (passes > 1 && !repeated, "passes", "irf or mirf"),
    ];
    match conflicts.into_iter().find(|(conflict, ..)| *conflict) {
        Some((_, what, methods)) => {
            Err(PyValueError::new_err(format!("{what} needs the method {methods}, found {name}")))
        }
        None => Ok(method),
    }
}
