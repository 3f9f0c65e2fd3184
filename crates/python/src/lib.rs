//! `spharm_rs._core`: the library as functions on NumPy arrays.
//!
//! The package's Python code (`python/spharm_rs`) takes whatever users have, makes it arrays of one type, and calls
//! this. Here stand types, the thread pools of a process, progress and interruption, and exceptions; nothing computes.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | `run` | work on a pool of this process, while the calling thread looks for signals and reports progress |
//! | `errors` | the library's errors as exceptions |
//! | `arrays` | NumPy arrays to the library's types and back |
//! | `surfaces` | reading, writing, mapping, resampling, comparing |
//! | `fitting` | fits, one and many |
//! | `models` | models: evaluation and files |
//! | `shapes` | shape analysis on models |
//! | `correspondences` | groups made to correspond; poses of, and a template registered to, one surface |
//! | `corresponding` | such a group: its members, files, points carried, new members |
//! | `sources` | surfaces as they come from Python |
//! | `cohorts` | fits of many surfaces from files, as they are finished |
//! | `groups` | groups of models to one degree, and their mean |
//! | `poses` | rotations, and surfaces brought together |
//! | `modes` | modes of variation |
//! | `qualities` | landmarks, and how well groups correspond |
//! | `morphs` | shapes between two models |
//! | `studies` | tests at every vertex |
//! | `transforms` | synthesis, its adjoint, and the least squares over them |
//! | `stores` | basis stores |
//! | `moments` | sums over samples, from which fits are made |

mod arrays;
mod cohorts;
mod correspondences;
mod corresponding;
mod errors;
mod fitting;
mod groups;
mod memory;
mod models;
mod modes;
mod moments;
mod morphs;
mod poses;
mod qualities;
mod run;
mod shapes;
mod sources;
mod stores;
mod studies;
mod surfaces;
mod transforms;

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the program with these arguments, its name first, and returns its exit code.
#[pyfunction]
fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| spharm_tools::main(arguments))
}

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    // Files that don't fit in memory are refused before they are read.
    spharm::io::ask_for_free_memory(spharm::machine::available_memory);
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<models::Model>()?;
    module.add_class::<moments::Moments>()?;
    module.add_class::<transforms::Transform>()?;
    module.add_class::<modes::Modes>()?;
    module.add_class::<cohorts::CohortRun>()?;
    module.add_function(wrap_pyfunction!(main, module)?)?;
    module.add_function(wrap_pyfunction!(fitting::fit, module)?)?;
    module.add_function(wrap_pyfunction!(fitting::fit_many, module)?)?;
    surfaces::register(module)?;
    shapes::register(module)?;
    qualities::register(module)?;
    corresponding::register(module)?;
    correspondences::register(module)?;
    stores::register(module)?;
    Ok(())
}
