//! Closed surfaces onto the sphere, one to one.
//!
//! A SPHARM model is as good as the map from the surface to the sphere that it is fitted over: where that map squeezes a
//! part of the surface, few samples see it and high degrees are wasted on it. This crate makes such maps. Whatever the
//! method, the result is one to one, by an exact predicate on each spherical triangle, or it is an error.
//!
//! # Conventions
//!
//! - A sphere has its surface's vertices, in their order, and its triangles; vertices lie on the unit sphere to rounding.
//! - Triangles that wind outwards on the surface do on the sphere.
//! - Areas are compared once the surface is scaled to the area of the sphere, 4 pi.
//! - The same input and seed give the same bits, whatever the number of threads.
//!
//! # How
//!
//! All methods for meshes begin alike: the surface is collapsed to a tetrahedron, which goes onto the sphere, and vertices
//! come back one at a time inside their kernels (`hierarchy.rs`, `embed.rs`, `star.rs`). From there a method descends its
//! energy (`energy.rs`) by Newton's steps over the whole mesh (`newton.rs`) and by sweeps over single vertices, and no
//! step that flips a triangle is taken. So there are no folds to repair at any time, and what comes out is checked anew.
//!
//! # Where what is
//!
//! | module or method | what |
//! |---|---|
//! | [`auto()`] | the one for those who have no wish |
//! | [`cald()`] | equal areas with little length distortion (Shen and Makedon 2006) |
//! | [`conformal()`] | least angle distortion |
//! | [`stretch()`] | least stretch (Praun and Hoppe 2003) |
//! | [`deform()`] | an icosphere's mesh deformed onto the surface, coarse to fine |
//! | [`equal_area()`] | equal quadrangles for the surface of a voxel object (Brechbuehler et al. 1995) |
//! | [`resample()`] | a surface on another sampling of its sphere |
//! | [`volume`] | label volumes (NIfTI): the closed surface around a label, repaired where that is asked for |
//! | [`quality`] | whether a map is one to one, and how it distorts areas, angles and lengths |
//!
//! # Example
//!
//! ```
//! use spharm_parametrize::{CaldParams, cald, silent};
//! use spharm_surface::generate::{Cortex, cortex};
//!
//! let (surface, _) = cortex(&Cortex { subdivisions: 3, variant: 0 });
//! let found = cald(&surface, &CaldParams::default(), &mut silent)?;
//! assert!(found.report.quality.is_bijective());
//! assert!(found.report.quality.area_rms < 0.1);
//! # Ok::<(), spharm_parametrize::ParametrizeError>(())
//! ```

#![forbid(unsafe_code)]

mod auto;
mod cald;
mod conformal;
mod crossings;
mod deform;
mod descend;
mod detail;
mod domain;
mod embed;
mod energy;
mod equal_area;
mod error;
mod geometry;
mod hierarchy;
mod newton;
pub mod quality;
mod resample;
mod star;
mod stretch;
pub mod volume;

pub use auto::auto;
pub use cald::{CaldParams, cald};
pub use conformal::{ConformalParams, conformal};
pub use deform::{DeformParams, deform};
pub use equal_area::{EqualAreaParams, area_deviation, equal_area};
pub use error::ParametrizeError;
pub use quality::Quality;
pub use resample::{Resampled, resample};
pub use stretch::{StretchParams, stretch};

use serde::Serialize;
use spharm_surface::Mesh;

/// A surface and its map to the sphere.
#[derive(Clone, Debug)]
pub struct Parametrization {
    /// The surface: the mesh that was given, or the one that was made of a volume.
    pub surface: Mesh,
    /// The sphere: the surface's triangles over unit vectors.
    pub sphere: Mesh,
    /// How it went.
    pub report: Report,
}

/// What a method did and what came of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// The method whose map this is.
    pub method: &'static str,
    /// Vertices.
    pub vertices: usize,
    /// Orientation and distortion.
    pub quality: Quality,
    /// Steps of optimisation over the whole mesh, all levels together.
    pub iterations: usize,
    /// Whether the optimisation stopped because there was nothing more to gain.
    pub converged: bool,
    /// Seconds from the mesh to the map.
    pub seconds: f64,
    /// By equal-area: how far the area of a quadrangle is from equal at most, as a fraction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quad_area_deviation: Option<f64>,
    /// What else is to be known, a sentence each.
    pub notes: Vec<String>,
}

impl Report {
    /// A report on a map that is one to one.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError::NotBijective`] where it isn't, with `remedy` as what to do.
    pub fn new(
        method: &'static str,
        surface: &Mesh,
        sphere: &Mesh,
        remedy: &'static str,
    ) -> Result<Self, ParametrizeError> {
        let quality = Quality::of(surface, sphere);
        if !quality.is_bijective() {
            let Quality { flipped, degenerate, triangles, .. } = quality;
            return Err(ParametrizeError::NotBijective { method, flipped, degenerate, triangles, remedy });
        }
        let vertices = surface.vertices.len();
        Ok(Self {
            method,
            vertices,
            quality,
            iterations: 0,
            converged: false,
            seconds: 0.0,
            quad_area_deviation: None,
            notes: Vec::new(),
        })
    }
}

/// What a method tells while it works.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// A stage of so many steps begins.
    Begin {
        /// What is being done, as a heading: "coarse to fine".
        stage: &'static str,
        /// How many steps there will be; an upper bound where it isn't known.
        steps: u64,
    },
    /// So many more steps are done.
    Step(u64),
}

/// Where events go. It must be quick, and may be called from the thread that called the method only.
pub type Progress<'a> = &'a mut dyn FnMut(Event);

/// For those who don't want to know.
pub fn silent(_: Event) {}
