//! Reads and writes tables of values: a row per vertex and a column per channel, after an optional line of column
//! names.

use std::io::{self, Write};

use super::flaw::{Flaw, shown};
use super::text::{lines, number};
use crate::mesh::Signal;

/// Reads a table with cells separated by `separator`. The first line is treated as column names if one of its cells
/// isn't a number.
pub(super) fn read(bytes: &[u8], separator: u8) -> Result<Signal, Flaw> {
    let mut values: Vec<f64> = Vec::new();
    let (mut vertices, mut channels) = (0, None);
    let mut first = true;
    for (at, line) in lines(bytes) {
        if line.trim_ascii().is_empty() {
            continue;
        }
        let start = values.len();
        let mut bad = None;
        for cell in line.split(|&b| b == separator) {
            let cell = cell.trim_ascii();
            match number(cell) {
                Some(x) => values.push(x),
                None => bad = bad.or(Some(cell)),
            }
        }
        if let Some(cell) = bad {
            if !first {
                return Err(Flaw::new(format!("numbers on line {at}"), shown(cell)));
            }
            // A line of names determines the number of columns.
            values.truncate(start);
            channels = Some(line.split(|&b| b == separator).count());
        } else {
            let found = values.len() - start;
            let wanted = *channels.get_or_insert(found);
            if found != wanted {
                return Err(Flaw::new(
                    format!("{wanted} values on line {at}, as on the first line"),
                    found.to_string(),
                ));
            }
            vertices += 1;
        }
        first = false;
    }
    Ok(Signal { values, vertices, channels: channels.unwrap_or(0) })
}

/// Writes values in digits that read back exactly, without column names.
pub(super) fn write(out: &mut dyn Write, signal: &Signal, separator: u8) -> io::Result<()> {
    for row in signal.values.chunks_exact(signal.channels) {
        for (i, x) in row.iter().enumerate() {
            if i > 0 {
                out.write_all(&[separator])?;
            }
            write!(out, "{x:?}")?;
        }
        out.write_all(b"\n")?;
    }
    Ok(())
}
