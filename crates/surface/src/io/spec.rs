//! Defines the type of an entry in the table of formats.

use std::io::{self, Write};

use super::flaw::Flaw;
use crate::mesh::{Input, Mesh, Signal};

/// The precision with which a format stores positions and values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// All 64 bits, as decimal text that reads back exactly.
    Exact,
    /// 32 bits, or 64 if requested.
    Choice,
    /// 32 bits.
    Single,
}

/// A file format, with its properties and functions.
#[derive(Debug)]
pub struct FormatSpec {
    /// The format's name as used in messages, such as "a PLY file".
    pub name: &'static str,
    /// Extensions of the format's file names, in lower case; `.gz` may follow.
    pub endings: &'static [&'static str],
    /// Precision of positions and values.
    pub precision: Precision,
    /// Whether the order of the vertices is preserved. If not, a surface read back no longer corresponds to its sphere.
    pub keeps_order: bool,
    /// Whether this format is implied by names that begin with `lh.` or `rh.` (a hemisphere) and don't have the
    /// extension of another format. If so, the format's extensions, such as `pial`, don't determine the format of a
    /// file without this prefix, because they are common words.
    pub hemisphere_prefix: bool,
    /// Largest number of values per vertex.
    pub most_channels: usize,
    /// Returns whether the given bytes are the beginning of a file of this format. If several formats match, the first
    /// one in the table of formats is used.
    pub(super) magic: fn(&[u8]) -> bool,
    /// Reads a file's contents.
    pub(super) read: fn(&[u8]) -> Result<Input, Flaw>,
    /// Writes a surface, if the format supports surfaces.
    pub(super) write_mesh: Option<Writer<Mesh>>,
    /// Writes values on vertices, if the format supports them.
    pub(super) write_signal: Option<Writer<Signal>>,
}

/// A function that writes a surface or a signal in a format.
pub(super) type Writer<T> = fn(&mut dyn Write, &T, &Context<'_>) -> io::Result<()>;

/// Information that a writer gets in addition to the contents.
#[derive(Clone, Copy, Debug)]
pub(super) struct Context<'a> {
    /// Whether 64-bit numbers were requested.
    pub(super) double: bool,
    /// Name of the file, without `.gz`.
    pub(super) name: &'a str,
    /// Anatomical structure of the vertices, as a value of GIfTI's `AnatomicalStructurePrimary`. It is used if the
    /// contents don't specify a structure.
    pub(super) structure: Option<&'a str>,
}

impl FormatSpec {
    /// Returns whether all bits of an f64 are stored. `double` states whether 64 bits are requested.
    #[must_use]
    pub fn holds_double(&self, double: bool) -> bool {
        match self.precision {
            Precision::Exact => true,
            Precision::Choice => double,
            Precision::Single => false,
        }
    }
}
