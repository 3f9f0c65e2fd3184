//! Stores the harmonics of a sampling scheme on disk, computed once and shared by every fit on that scheme.
//!
//! A store is a folder with one subfolder for each sampling scheme, named by the scheme's [key](SchemeKey). The
//! subfolder has one basis file for each degree l, `A_<l>`. The file holds the matrix `A_l` (n, 2 l + 1), the harmonics
//! of degree l at n directions, in chunks of rows:
//!
//! ```text
//! STORE/<key>/A_0   header | chunk 0 | chunk 1 | ... | table | footer
//!             A_1   header | chunk 0 | ...
//! ```
//!
//! Files are immutable. A file is valid if its footer passes all checks and it has its final name; there is no separate
//! manifest that could contradict the files. A store built to degree 60 is extended to 100 by adding files.
//! `store-format.md` specifies every byte.
//!
//! Any number of processes may build and read a store at the same time. If a file is damaged, or truncated while it is
//! read, the reader returns an error that states the file's path. The reader neither crashes nor returns wrong values.
//!
//! Long-running functions take a [`Monitor`](spharm_monitor::Monitor) as their last argument and run on the caller's
//! rayon pool.
//!
//! | module | contents |
//! |---|---|
//! | [`scheme`] | key of a sampling scheme: a hash of everything that its basis depends on |
//! | [`basis`] | basis files: building them, opening a scheme, reading chunks |
//! | [`factor`] | the Cholesky factor of a scheme's normal equations, in the scheme's folder |
//! | [`catalog`] | listing the contents of a store, verifying it, removing leftovers |
//! | [`mod@format`] | versions and limits of the format |
//! | `container` | the parts shared by basis files and factors: header frame, table, footer, checks, publishing |
//! | `folder`, `temporary` | folders of schemes, locks, disk space; temporary files |
//! | `source`, `map` | open files, and memory windows on them that survive a shrinking file |
//! | `platform` | system calls of Unix and Windows |
//!
//! Building a basis and reading the harmonic of degree 0:
//!
//! ```
//! use spharm_harmonics::Directions;
//! use spharm_monitor::Silent;
//! use spharm_store::{BuildParams, Scheme, build};
//!
//! let folder = tempfile::tempdir()?;
//! let directions = Directions::from_angles(&[[0.3, 0.1], [1.2, 4.0], [2.8, 2.0]])?;
//! let params = BuildParams { max_degree: 4, ..BuildParams::default() };
//! let report = build(folder.path(), &directions, &params, &Silent)?;
//! assert_eq!(report.built, 5);
//! let scheme = Scheme::open(folder.path(), report.key, 3, 4)?;
//! let window = scheme.files()[0].window(0..1)?;
//! let mut scratch = Vec::new();
//! let a0 = window.values(0, &mut scratch)?;
//! assert!(a0.iter().all(|s| (s - 0.28209479177387814).abs() < 1e-15));
//! window.check()?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod basis;
mod bytes;
pub mod catalog;
mod container;
mod error;
pub mod factor;
mod folder;
pub mod format;
mod map;
mod platform;
pub mod scheme;
mod source;
mod temporary;

pub use basis::{BuildParams, BuildReport, ChunkWindow, DegreeFile, Header, Scheme, build};
pub use container::codec::Codec;
pub use error::{StoreError, StoreWarning};
pub use factor::{FactorFile, FactorSpec, FactorWriter, TileGrid, WeightsHash};
pub use map::prefetch;
pub use scheme::{Scalar, SchemeKey};
