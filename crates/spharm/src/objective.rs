//! Defines the choice between fitting a mesh's surface and fitting its vertices.

use std::str::FromStr;

use spharm_surface::Kind;

use crate::{FitParams, Method};

/// The part of a mesh to which the full least squares is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Objective {
    /// Chooses automatically: fits the surface of a mesh if the sphere has triangles and no store is given, and fits
    /// the vertices in all other cases, for example for signals.
    #[default]
    Default,
    /// Fits the surface: minimises the integral over the sphere of the squared distance. All triangles are sampled as
    /// densely as the degree requires. Signals are interpolated linearly on each triangle.
    Surface,
    /// Fits the vertices alone, as in the paper.
    Vertices,
}

impl Objective {
    /// Returns the objective's name in lower case, as models record it.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Surface => "surface",
            Self::Vertices => "vertices",
        }
    }
}

impl FromStr for Objective {
    type Err = String;

    /// Parses the names `surface` and `vertices`.
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "surface" => Ok(Self::Surface),
            "vertices" => Ok(Self::Vertices),
            _ => Err("expected surface or vertices".to_owned()),
        }
    }
}

impl FitParams {
    /// Returns whether a target of the given kind is fitted as a surface. `triangles` states whether the sphere has
    /// triangles.
    pub fn fits_surface(&self, kind: Kind, triangles: bool) -> bool {
        match (self.method, self.objective) {
            (Method::Lsq, Objective::Surface) => true,
            (Method::Lsq, Objective::Default) => kind == Kind::Surface && triangles && self.store.is_none(),
            _ => false,
        }
    }
}
