//! Builds and reads basis files. The immutable file `A_<l>` holds the matrix (n, 2 l + 1) of the harmonics of degree l
//! at n directions, in chunks of rows.
//!
//! | module | contents |
//! |---|---|
//! | `header` | the contents of a file |
//! | `reader` | an open file and windows on its chunks |
//! | `writer` | a file being written |
//! | `degrees` | the files of a scheme: listed, or opened together |
//! | `near` | the scheme with the same directions up to rounding |
//! | `plan` | the missing degrees, and the memory and disk space that a build needs |
//! | `build` | the build |

mod build;
mod degrees;
mod header;
mod near;
mod plan;
mod reader;
mod writer;

pub use build::{BuildReport, build};
pub use degrees::{FoundDegree, Scheme, degrees};
pub use header::Header;
pub use plan::{BuildParams, DEFAULT_CHUNK_ROWS};
pub use reader::{ChunkWindow, DegreeFile};
