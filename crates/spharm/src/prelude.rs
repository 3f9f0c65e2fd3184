//! What most programs need: `use spharm::prelude::*;`.

pub use crate::{Error, Fit, FitParams, Kind, Mesh, Method, Signal, Smoothness, Sphere, Weights, fit};
