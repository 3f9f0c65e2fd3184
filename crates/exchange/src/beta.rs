//! Reads and writes the matrices of weighted SPHARM, one file per channel. Each row of a matrix has the coefficients of
//! the cosines of one degree, followed by the coefficients of the sines.
//!
//! Moo Chung's MATLAB code returns these matrices as `fourier.x`, `.y` and `.z`; AFNI's `SpharmDeco` uses the same
//! harmonics. The files are text like AFNI's `.1D` files: numbers separated by blanks, and comments that begin with
//! `#`.

use std::io::{self, Write};

use ndarray::Array2;
use spharm_harmonics::Coefficients;

use crate::convert::{from_beta, to_beta};
use crate::flaw::Flaw;
use crate::text::{number, text, write_row};

pub(crate) fn write(out: &mut dyn Write, a: &Coefficients, channel: usize) -> io::Result<()> {
    for row in to_beta(a, channel).rows() {
        write_row(out, row, " ")?;
        writeln!(out)?;
    }
    Ok(())
}

pub(crate) fn read(bytes: &[u8]) -> Result<Vec<f64>, Flaw> {
    let (mut values, mut rows, mut columns) = (Vec::new(), 0, None);
    for (line, text) in text(bytes)?.lines().enumerate() {
        let separated = text.split('#').next().unwrap_or_default().split(|c: char| c.is_whitespace() || c == ',');
        let before = values.len();
        for word in separated.filter(|word| !word.is_empty()) {
            values.push(number(word, line + 1)?);
        }
        let found = values.len() - before;
        if found == 0 {
            continue;
        }
        let wanted = *columns.get_or_insert(found);
        if found != wanted {
            return Err(Flaw::new(format!("{wanted} numbers on line {}, as on the first line", line + 1), found));
        }
        rows += 1;
    }
    let columns = columns.unwrap_or(0);
    let matrix = Array2::from_shape_vec((rows, columns), values).map_err(|error| Flaw::new("a matrix", error))?;
    from_beta(&matrix)
        .ok_or_else(|| Flaw::new("L + 1 rows of 2 L + 1 numbers", format!("{rows} rows of {columns} numbers")))
}
