//! Properties of a format, as listed in the table of formats.

use std::io::{self, Write};

use super::flaw::Flaw;
use crate::mesh::{Input, Mesh, Signal};

/// Number of bits of a position or value that a format keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// All bits, as text.
    Exact,
    /// 32 bits, or 64 if requested.
    Choice,
    /// 32 bits.
    Single,
}

/// A file format.
#[derive(Debug)]
pub struct FormatSpec {
    /// Name as used in messages: "a PLY file".
    pub name: &'static str,
    /// Endings of its files, in lower case; `.gz` may follow each.
    pub endings: &'static [&'static str],
    /// Precision of a position or a value.
    pub precision: Precision,
    /// Whether the order of the vertices is kept. If it isn't, a surface and its sphere no longer correspond.
    pub keeps_order: bool,
    /// Whether this format is implied by names that begin with a hemisphere, `lh.` or `rh.`, and don't have another
    /// format's ending. The format's own endings are common words that don't determine a file's format.
    pub hemisphere_prefix: bool,
    /// Most values per vertex.
    pub most_channels: usize,
    /// Whether bytes at the start of a file match this format. The first matching format of the table is used.
    pub(super) magic: fn(&[u8]) -> bool,
    /// Reads a file's contents.
    pub(super) read: fn(&[u8]) -> Result<Input, Flaw>,
    /// Writes a surface, if the format supports surfaces.
    pub(super) write_mesh: Option<Writer<Mesh>>,
    /// Writes values on vertices, if the format supports them.
    pub(super) write_signal: Option<Writer<Signal>>,
}

/// Writes contents of one kind in a format.
pub(super) type Writer<T> = fn(&mut dyn Write, &T, &Context<'_>) -> io::Result<()>;

/// Information for a writer in addition to the contents.
#[derive(Clone, Copy, Debug)]
pub(super) struct Context<'a> {
    /// Whether 64 bits were requested.
    pub(super) double: bool,
    /// The file's name in lower case, without `.gz`.
    pub(super) name: &'a str,
    /// Structure of the vertices, as a value of GIfTI's `AnatomicalStructurePrimary`, used if the contents don't
    /// specify it.
    pub(super) structure: Option<&'a str>,
}

impl FormatSpec {
    /// Returns whether every bit of an f64 is kept; `double` means that 64 bits are requested.
    #[must_use]
    pub fn holds_double(&self, double: bool) -> bool {
        match self.precision {
            Precision::Exact => true,
            Precision::Choice => double,
            Precision::Single => false,
        }
    }
}
