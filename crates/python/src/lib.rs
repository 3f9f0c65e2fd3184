//! Defines the Python module `spharm_rs._core`, which provides the library as functions on NumPy arrays.
//!
//! The package's Python code (`python/spharm_rs`) converts the users' arguments to arrays of fixed types, and calls
//! this crate. This crate converts types, manages thread pools, reports progress, handles interruption, and raises
//! exceptions. All computations are in the library.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | `run` | work on a pool of this process, while the calling thread checks for signals and reports progress |
//! | `errors` | the library's errors as exceptions |
//! | `arrays` | conversion between NumPy arrays and the library's types |
//! | `surfaces` | reading, writing, mapping, resampling, comparing |
//! | `metadata` | metadata of surfaces' files |
//! | `repairs` | repairs of meshes |
//! | `volumes` | labels of volumes, their surfaces and maps |
//! | `fitting` | fits of one target or of many |
//! | `methods` | the method of a fit, and its settings |
//! | `targets` | targets of fits, and their checks |
//! | `models` | models: evaluation and files |
//! | `shapes` | shape analysis on models |
//! | `correspondences` | correspondence of groups; poses of single surfaces, and registration of a template to them |
//! | `corresponding` | corresponding groups: members, files, carried points, new members |
//! | `sources` | surfaces as passed from Python |
//! | `cohorts` | fits of many surfaces from files, with results as soon as each fit is finished |
//! | `groups` | groups of models of a common degree, and their mean |
//! | `poses` | rotations, and alignment of surfaces |
//! | `modes` | modes of variation |
//! | `qualities` | landmarks, and quality of correspondences |
//! | `checks` | comparison of the subjects of a group |
//! | `morphs` | shapes between two models |
//! | `pictures` | surfaces as PNG |
//! | `studies` | tests at every vertex |
//! | `transforms` | synthesis, its adjoint, and the least squares over them |
//! | `stores` | basis stores |
//! | `moments` | sums over samples, from which fits are made |

mod arrays;
mod checks;
mod cohorts;
mod correspondences;
mod corresponding;
mod errors;
mod fitting;
mod groups;
mod memory;
mod metadata;
mod methods;
mod models;
mod modes;
mod moments;
mod morphs;
mod pictures;
mod poses;
mod qualities;
mod repairs;
mod run;
mod shapes;
mod sources;
mod stores;
mod studies;
mod surfaces;
mod targets;
mod transforms;
mod volumes;

use std::ffi::OsString;

use pyo3::prelude::*;

/// Requests huge pages for the large arrays of this module, as NumPy does for its arrays.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[global_allocator]
static ALLOCATOR: spharm_tools::allocator::LargePages = spharm_tools::allocator::LargePages;

/// Runs the command-line program with the given arguments. The first argument is the program's name. Returns the exit
/// code.
#[pyfunction]
fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| spharm_tools::main(arguments))
}

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    // Let readers compare the size of a file with the free memory, so that files that don't fit are refused before they
    // are read.
    spharm::io::ask_for_free_memory(spharm::machine::available_memory);
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<models::Model>()?;
    module.add_class::<moments::Moments>()?;
    module.add_class::<transforms::Transform>()?;
    module.add_class::<modes::Modes>()?;
    module.add_class::<cohorts::CohortRun>()?;
    module.add_function(wrap_pyfunction!(main, module)?)?;
    module.add_function(wrap_pyfunction!(fitting::fit, module)?)?;
    module.add_function(wrap_pyfunction!(pictures::picture, module)?)?;
    module.add_function(wrap_pyfunction!(fitting::fit_many, module)?)?;
    module.add_function(wrap_pyfunction!(fitting::choose_degree, module)?)?;
    module.add_function(wrap_pyfunction!(fitting::solve, module)?)?;
    surfaces::register(module)?;
    metadata::register(module)?;
    repairs::register(module)?;
    volumes::register(module)?;
    shapes::register(module)?;
    qualities::register(module)?;
    corresponding::register(module)?;
    correspondences::register(module)?;
    stores::register(module)?;
    Ok(())
}
