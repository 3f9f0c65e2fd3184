//! What of a mesh is fitted: its surface, or its vertices.

use std::str::FromStr;

use spharm_surface::Kind;

use crate::{FitParams, Method, Preconditioner, Smoothness};

/// What of a mesh the full least squares fits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FitTo {
    /// The surface, for meshes over a sphere with triangles; the vertices for signals, and with what is of the vertices: a
    /// store, vertices held out, standard errors, a smoothness by cross-validation, the density as preconditioner.
    #[default]
    Default,
    /// The surface: the integral over the sphere of the squared distance, by samples of all triangles that are as dense as
    /// the degree needs. Signals are linear on each triangle.
    Surface,
    /// The vertices alone, as in the paper.
    Vertices,
}

impl FitTo {
    /// Returns its name in lower case, as models record it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Surface => "surface",
            Self::Vertices => "vertices",
        }
    }
}

impl FromStr for FitTo {
    type Err = String;

    /// Parses `surface` and `vertices`.
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "surface" => Ok(Self::Surface),
            "vertices" => Ok(Self::Vertices),
            _ => Err("expected surface or vertices".to_owned()),
        }
    }
}

impl FitParams {
    /// Returns whether a target of this kind is fitted as a surface, over a sphere with triangles or without.
    pub fn fits_surface(&self, kind: Kind, triangles: bool) -> bool {
        match (self.method, self.target) {
            (Method::Lsq, FitTo::Surface) => true,
            (Method::Lsq, FitTo::Default) => kind == Kind::Surface && triangles && self.of_the_vertices().is_none(),
            _ => false,
        }
    }

    /// Returns a setting that only has a meaning for a fit of the vertices, where there is one: the name of its field, and
    /// its value where others are of surfaces too.
    pub fn of_the_vertices(&self) -> Option<&'static str> {
        let settings = [
            (self.store.is_some(), "store"),
            (self.hold_out.is_some(), "hold_out"),
            (self.standard_errors, "standard_errors"),
            (self.smoothness == Smoothness::Auto, "smoothness auto"),
            (self.preconditioner == Preconditioner::Density, "preconditioner density"),
        ];
        settings.into_iter().find(|(given, _)| *given).map(|(_, name)| name)
    }
}
