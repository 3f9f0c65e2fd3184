//! Reads and writes SPHARM-PDM's `.coef` files. The first line is `{ 169,{x, y, z},`, with the number of rows and the
//! first row of coefficients. Each further line has one row, and `}` ends the file.

use std::io::{self, Write};

use ndarray::Array2;
use spharm_harmonics::Coefficients;

use crate::convert::{from_pdm, to_pdm};
use crate::flaw::Flaw;
use crate::text::{number, quoted, text, write_row};

/// Highest degree that SPHARM-PDM can evaluate. At higher degrees, its factorials of twice the degree overflow.
pub(crate) const HIGHEST_EVALUATED: usize = 85;

pub(crate) fn write(out: &mut dyn Write, a: &Coefficients) -> io::Result<()> {
    let rows = to_pdm(a);
    write!(out, "{{ {},", rows.nrows())?;
    for (i, row) in rows.rows().into_iter().enumerate() {
        write!(out, "{}{{", if i > 0 { ",\n" } else { "" })?;
        write_row(out, row, ", ")?;
        write!(out, "}}")?;
    }
    writeln!(out, "}}")
}

/// Returns whether a file begins like a `.coef` file: with a brace, a number and a comma.
pub(crate) fn is_coef(bytes: &[u8]) -> bool {
    let rest = bytes.trim_ascii_start().strip_prefix(b"{").unwrap_or_default().trim_ascii_start();
    let digits = rest.iter().take_while(|byte| byte.is_ascii_digit()).count();
    digits > 0 && rest.get(digits..).unwrap_or_default().trim_ascii_start().starts_with(b",")
}

pub(crate) fn read(bytes: &[u8]) -> Result<Coefficients, Flaw> {
    let text = text(bytes)?;
    let head = text.trim_start().strip_prefix('{').and_then(|rest| rest.split_once(','));
    let (count, rows) = head.ok_or_else(|| Flaw::new("`{ COUNT,` at the beginning", quoted(text)))?;
    let count: usize = count.trim().parse().map_err(|_| Flaw::new("the number of rows", quoted(count)))?;
    let mut values = Vec::new();
    for (line, text) in rows.lines().enumerate() {
        let separated = text.split(|c: char| c.is_whitespace() || "{},".contains(c));
        for word in separated.filter(|word| !word.is_empty()) {
            values.push(number(word, line + 1)?);
        }
    }
    if count.checked_mul(3) != Some(values.len()) {
        return Err(Flaw::new(format!("{count} rows of 3 numbers"), format!("{} numbers", values.len())));
    }
    let rows = Array2::from_shape_vec((count, 3), values).map_err(|error| Flaw::new("rows of 3 numbers", error))?;
    from_pdm(&rows).map_err(|error| Flaw::new("(L + 1)^2 rows", error))
}
