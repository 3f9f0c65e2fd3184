//! Properties of a format, as the table of formats has them.

use std::io::{self, Write};

use super::flaw::Flaw;
use crate::mesh::{Input, Mesh, Signal};

/// How many bits of a position or value a format keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// Every bit, as text.
    Exact,
    /// 32 bits, or 64 where they are asked for.
    Choice,
    /// 32 bits.
    Single,
}

/// A file format.
#[derive(Debug)]
pub struct FormatSpec {
    /// Its name as it stands in messages: "a PLY file".
    pub name: &'static str,
    /// Endings of its files, in lower case; `.gz` may follow each.
    pub endings: &'static [&'static str],
    /// What it keeps of a position or a value.
    pub precision: Precision,
    /// Whether the order of the vertices is kept. Where it isn't, a surface and its sphere no longer correspond.
    pub keeps_order: bool,
    /// Whether names that begin with a hemisphere, `lh.` or `rh.`, and have no other format's ending ask for it. Its
    /// own endings are words that say little of a file's format.
    pub hemisphere_prefix: bool,
    /// Values that a vertex may have at most.
    pub most_channels: usize,
    /// Whether a file that begins with these bytes is in this format. The first format of the table that says so is it.
    pub(super) magic: fn(&[u8]) -> bool,
    /// Reads what a file holds.
    pub(super) read: fn(&[u8]) -> Result<Input, Flaw>,
    /// Writes a surface, if the format holds them.
    pub(super) write_mesh: Option<Writer<Mesh>>,
    /// Writes values on vertices, if the format holds them.
    pub(super) write_signal: Option<Writer<Signal>>,
}

/// Writes contents of one kind in a format.
pub(super) type Writer<T> = fn(&mut dyn Write, &T, &Context<'_>) -> io::Result<()>;

/// What a writer may want to know beside the contents.
#[derive(Clone, Copy, Debug)]
pub(super) struct Context<'a> {
    /// Whether 64 bits were asked for.
    pub(super) double: bool,
    /// The file's name in lower case, without `.gz`.
    pub(super) name: &'a str,
    /// What the vertices are of, as GIfTI's `AnatomicalStructurePrimary` has it, where the contents don't say.
    pub(super) structure: Option<&'a str>,
}

impl FormatSpec {
    /// Returns whether every bit of an f64 is kept; `double` is whether 64 bits are asked for.
    #[must_use]
    pub fn holds_double(&self, double: bool) -> bool {
        match self.precision {
            Precision::Exact => true,
            Precision::Choice => double,
            Precision::Single => false,
        }
    }
}
