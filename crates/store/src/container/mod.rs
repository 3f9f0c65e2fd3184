//! The container format that basis files and factors share: a header, parts, a table of the parts, and a footer.
//!
//! ```text
//! header | part 0 | part 1 | ... | table | footer
//! ```
//!
//! A part is a chunk of a basis file or a tile of a factor. What the header's fields mean and how long the parts are is
//! the business of the kind of file, which implements [`frame::Contents`]; everything else is here, once.
//!
//! | module | what |
//! |---|---|
//! | [`codec`] | raw, and zstd over shuffled bytes |
//! | [`frame`] | the header's frame, and the trait of a kind of file |
//! | [`table`] | the table of parts and the footer |
//! | [`reader`] | an open file: checked when opened, parts checked when first read |
//! | [`verify`] | every byte of a file against its hashes |
//! | [`writer`] | a file from its temporary name to its final one |

pub(crate) mod codec;
pub(crate) mod frame;
pub(crate) mod reader;
pub(crate) mod table;
pub(crate) mod verify;
pub(crate) mod writer;
