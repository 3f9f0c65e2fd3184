//! Computes moments of samples. Least-squares fits need only these moments, not the samples. Moments of parts of the
//! data can be stored in files and added, so the samples need not fit in memory or on one machine.
//!
//! A least-squares fit of degree L of samples f at directions x with weights w depends on these data only through four
//! quantities: the moments of the weights to degree 2L, the right-hand sides `A^T W f` to degree L, `sum w f^2`, and
//! the number of samples. Here, A is the matrix of the harmonics' values at the directions, and W the diagonal matrix
//! of the weights. All four are sums over the samples, so they can be computed in one pass over the data, for parts of
//! the data, and on different machines. [`accumulate()`] reads tables in chunks, [`Moments::write`] stores the result,
//! and [`merge()`] adds parts and rejects parts that don't belong together. `docs/moments-format.md` specifies the
//! bytes of a file.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`samples`] | tables of samples, one module per file format; converts columns to directions, weights, values |
//! | [`mod@accumulate`] | moments of tables, in bounded memory |
//! | [`arrays`] | moments of samples that are in memory |
//! | [`moments`] | [`Moments`]: the sums, and a record of the samples |
//! | [`merge()`](mod@merge) | sum of the moments of several parts |
//! | `file` | the file format |
//!
//! # Example
//!
//! ```
//! use spharm_moments::{Positions, Request, Shard, accumulate, merge, Moments};
//! use spharm_monitor::Silent;
//!
//! let folder = tempfile::tempdir()?;
//! let table = folder.path().join("heights.csv");
//! std::fs::write(&table, "lon,lat,height\n0,90,1\n120,-30,2\n240,-30,3\n0,0,2\n")?;
//! let parts = (0..2).map(|index| {
//!     let mut request = Request::new(vec![table.clone()], 1);
//!     request.columns.values = vec!["height".to_owned()];
//!     request.shard = Shard { index, of: 2 };
//!     accumulate(&request, &Silent)
//! });
//! let parts = parts.map(|part| part.map(|part| part.moments)).collect::<Result<Vec<_>, _>>()?;
//! let all = merge(parts, false)?;
//! all.write(&folder.path().join("heights.moments"), false)?;
//! let all = Moments::read(&folder.path().join("heights.moments"))?;
//! assert_eq!((all.rows, all.sums.squares[0]), (4, 18.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod accumulate;
pub mod arrays;
mod error;
mod file;
mod key;
pub mod merge;
pub mod moments;
pub mod samples;

pub use accumulate::{Accumulated, Request, Warning, accumulate};
pub use arrays::{Part, Samples, accumulate_samples};
pub use error::MomentsError;
pub use merge::{equal_sums, merge, merge_named};
pub use moments::{Moments, Shard, Source};
pub use samples::{Columns, Positions};
