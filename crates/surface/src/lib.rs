//! Reads, writes, checks, compares and generates triangle meshes and signals on their vertices.
//!
//! This crate reads and writes all surface files. It doesn't trust their contents: sizes are checked before memory is
//! allocated. An output file appears complete or not at all.
//!
//! # Conventions
//!
//! - Positions are f64, in the file's own unit and axes (mm and RAS+ for brains). Transforms in files aren't applied.
//! - Triangles are counter-clockwise seen from outside. The order of vertices and the winding are kept, because the
//!   subjects of a study share them. The exceptions are [`repair`], reflections, and formats that store a vertex
//!   several times.
//! - A [`Signal`] is a row-major array of shape (vertices, channels).
//! - msd and xsd are the mean and maximum of the squared distances between corresponding vertices, after the surface is
//!   scaled such that its bounding box has volume 1.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`io`] | [`read_mesh`](io::read_mesh), [`read_signal`](io::read_signal), [`write_mesh`](io::write_mesh), one file per format; [`write_new`](io::write_new), through which every output file is written; [`check_output`](io::check_output); [`landmarks`](io::landmarks) |
//! | [`topology`] | checks that a mesh is a closed surface of genus zero, and gives the reasons if it isn't |
//! | [`generate`] | icospheres, and folded surfaces with a known parameterisation |
//! | [`metrics`] | bounding-box scale, msd, xsd, distance between surfaces with different triangles, colour map |
//! | [`nearest`], [`Place`] | the nearest point of a mesh; a point within a triangle |
//! | [`repair`] | welds vertices, and drops triangles and vertices that belong to no closed surface |
//! | [`npy`] | headers of NumPy's arrays |
//! | [`Sphere`], [`Target`] | the sphere of a fit; the surface or signal to be fitted over it; both are checked |
//! | [`Seam`] | relation between a surface that was cut open and the original surface |
//! | [`geometry`] | three-vectors, solid angles, winding numbers |
//! | [`locator`] | the triangle of a sphere that a direction meets, and interpolation there |
//! | [`samples`] | samples of a sphere's triangles, for least squares over the whole surface |
//! | [`pose`] | the motion that brings one surface onto another, or the members of a group onto each other |
//! | [`kabsch`], [`matrix3`], [`Similarity`] | the best-fitting rotation; 3 x 3 matrices; similarity transforms |
//! | [`SpreadPoints`] | points spread evenly over a mesh's area |
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
//! // GIfTI stores positions as 32-bit floats, whose rounding errors are below 1e-5 at coordinates up to 140 mm.
//! let distances = compare(&surface, &read_mesh(&path)?)?;
//! assert!(distances.xsd_raw.sqrt() < 1e-5);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod angles;
mod axes_differ;
mod error;
pub mod geometry;
mod hemisphere;
mod mesh;
mod room;
mod seam;
mod similarity;
mod sliver_tree;
mod sphere;
mod spread;
mod target;

pub mod generate;
pub mod io;
pub mod kabsch;
pub mod locator;
pub mod matrix3;
pub mod metrics;
pub mod nearest;
pub mod npy;
mod place;
pub mod pose;
pub mod range;
pub mod repair;
pub mod samples;
pub mod topology;
mod volume_geometry;

pub use angles::look_like_radians;
pub use axes_differ::AxesDiffer;
pub use error::SurfaceError;
pub use hemisphere::Hemisphere;
pub use mesh::{CoordinateSystem, Input, Kind, Mesh, Meta, Signal};
pub use place::Place;
pub use seam::{Seam, Welded};
pub use similarity::Similarity;
pub use sphere::{Sphere, SphereWarning, read_sphere};
pub use spread::SpreadPoints;
pub use target::{Target, TargetWarning, read_target, read_target_with_gaps};
pub use volume_geometry::VolumeGeometry;
