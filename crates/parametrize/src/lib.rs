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
//! | method | least | for |
//! |---|---|---|
//! | [`cald`](cald()) | area distortion, lengths bounded | fits: the default |
//! | [`conformal`](conformal()) | angle distortion | comparison with other programs; it squeezes arms to nothing |
//! | [`stretch`](stretch()) | L2 stretch | remeshing |
//! | [`auto`](auto()) | as cald, or stretch where cald fails | those who have no wish |
//!
//! [`quality`] says whether a map is one to one, and how it distorts areas, angles and lengths.
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
mod descend;
mod domain;
mod embed;
mod energy;
mod error;
mod geometry;
mod hierarchy;
mod newton;
pub mod quality;
mod star;
mod stretch;

pub use auto::auto;
pub use cald::{CaldParams, cald};
pub use conformal::{ConformalParams, conformal};
pub use error::ParametrizeError;
pub use quality::Quality;
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
        Ok(Self { method, vertices, quality, iterations: 0, converged: false, seconds: 0.0, notes: Vec::new() })
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
