//! Triangle meshes and signals on them: files, topology, distances, made-up surfaces.
//!
//! Everything else in spharm sees arrays; this crate is where they come from and what they turn into again. It is also
//! the boundary to the outside world: files are taken as hostile, outputs appear whole or not at all.
//!
//! # Conventions
//!
//! - Positions are f64, in the file's own units (mm and RAS+ for brains), as stored: no transform is applied.
//! - Triangles are counter-clockwise seen from outside. Vertex order and winding are never changed, since a study's
//!   subjects share them.
//! - A [`Signal`] is (vertices, channels), row-major.
//! - Distances are squared; msd and xsd are those after scaling the bounding box to volume 1.
//!
//! # Where what is
//!
//! | module | what |
//! |---|---|
//! | [`io`] | [`read_mesh`](io::read_mesh), [`read_signal`](io::read_signal), [`write_mesh`](io::write_mesh), one file per format; [`write_new`](io::write_new), how every output is written |
//! | [`topology`] | whether a mesh is a closed surface of genus zero, and if not, why |
//! | [`generate`] | icospheres, and folded surfaces whose parameterisation is known |
//! | [`metrics`] | bounding-box scale, msd, xsd, the distance of two surfaces of any triangles, colours for errors |
//! | [`nearest`] | the nearest point of a mesh |
//! | [`Sphere`], [`Target`] | a sphere's directions and triangles; the values to be fitted over it; both checked |
//! | [`geometry`] | three-vectors, solid angles, winding numbers |
//! | [`sphere_locator`] | which triangle of a sphere a direction meets, values interpolated there |
//!
//! # Example
//!
//! ```
//! use spharm_surface::generate::{Cortex, cortex};
//! use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};
//! use spharm_surface::metrics::compare;
//! use spharm_surface::topology::Topology;
//!
//! let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 0 });
//! assert!(Topology::of(&surface).is_sphere());
//! assert_eq!(surface.faces, sphere.faces);
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("lh.folded.surf.gii");
//! write_mesh(&path, &surface, &WriteOptions::default())?;
//!
//! // GIfTI's positions are 32-bit floats: 24 bits of 140 mm.
//! let distances = compare(&surface, &read_mesh(&path)?)?;
//! assert!(distances.xsd_raw.sqrt() < 1e-5);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod error;
pub mod geometry;
mod hemisphere;
mod mesh;
mod sphere;
mod target;

pub mod generate;
pub mod io;
pub mod metrics;
pub mod nearest;
pub mod sphere_locator;
pub mod topology;
mod volume_geometry;

pub use error::SurfaceError;
pub use hemisphere::Hemisphere;
pub use mesh::{CoordinateSystem, Input, Kind, Mesh, Meta, Signal};
pub use sphere::{Sphere, SphereWarning, read_sphere};
pub use target::{Target, TargetWarning, read_target};
pub use volume_geometry::VolumeGeometry;
