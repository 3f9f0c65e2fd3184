//! Implements the container format that basis files and factors share: a header, parts, a table of the parts, and a
//! footer.
//!
//! ```text
//! header | part 0 | part 1 | ... | table | footer
//! ```
//!
//! A part is a chunk of a basis file or a tile of a factor. Each kind of file defines the meaning of its header fields
//! and the lengths of its parts by implementing [`frame::Contents`]. This module implements everything else, for both
//! kinds of files.
//!
//! | module | contents |
//! |---|---|
//! | [`codec`] | raw, and zstd over shuffled bytes |
//! | [`frame`] | the header's frame, and the trait that each kind of file implements |
//! | [`table`] | the table of parts and the footer |
//! | [`reader`] | an open file: checked when opened, parts checked when first read |
//! | [`verify`] | checking every byte of a file against its hashes |
//! | [`writer`] | writing a file, from its temporary name to its final one |

pub(crate) mod codec;
pub(crate) mod frame;
pub(crate) mod reader;
pub(crate) mod table;
pub(crate) mod verify;
pub(crate) mod writer;
