//! Reads the numbers, points, cells and fields of a VTK file, in text or big-endian binary.

use super::super::bytes::{Cursor, Endian};
use super::super::flaw::{Flaw, bounded, shown};
use super::super::scalar::Scalar;
use super::super::text::number;

/// Returns the number type with the given VTK name.
fn scalar(word: &[u8]) -> Result<Scalar, Flaw> {
    Ok(match word {
        b"char" | b"signed_char" => Scalar::I8,
        b"unsigned_char" => Scalar::U8,
        b"short" => Scalar::I16,
        b"unsigned_short" => Scalar::U16,
        b"int" | b"vtktypeint32" => Scalar::I32,
        b"unsigned_int" | b"vtktypeuint32" => Scalar::U32,
        // VTK writes these types with 64 bits on current systems.
        b"long" | b"vtkIdType" | b"vtktypeint64" | b"long_long" => Scalar::I64,
        b"unsigned_long" | b"vtktypeuint64" => Scalar::U64,
        b"float" => Scalar::F32,
        b"double" => Scalar::F64,
        other => {
            return Err(Flaw::unsupported(
                format!("the type {}", shown(other)),
                "save the surface with float or double points and without text fields",
            ));
        }
    })
}

/// Reads the data in a file number by number.
pub(super) struct Values<'a> {
    pub(super) cursor: Cursor<'a>,
    pub(super) ascii: bool,
}

impl Values<'_> {
    fn header<T: std::str::FromStr>(&mut self, what: &str) -> Result<T, Flaw> {
        let word = self.cursor.token();
        number(word).ok_or_else(|| Flaw::new(what, shown(word)))
    }

    /// Moves to the start of the data. Binary data start after the end of the line that announces them.
    fn begin(&mut self) {
        if !self.ascii {
            self.cursor.line();
        }
    }

    /// Returns the smallest number of bytes that a number can take in the file. `size` is its size in binary files.
    fn least(&self, size: usize) -> usize {
        if self.ascii { 2 } else { size }
    }

    fn bounded(&self, count: u64, size: usize, what: &str) -> Result<usize, Flaw> {
        bounded(count, self.least(size), self.cursor.remaining() + 1, what)
    }

    fn float(&mut self, kind: Scalar) -> Result<f64, Flaw> {
        if self.ascii {
            let word = self.cursor.token();
            return number(word).ok_or_else(|| Flaw::new("a number", shown(word)));
        }
        kind.read(&mut self.cursor, Endian::Big)
    }

    fn integer(&mut self, kind: Scalar) -> Result<u64, Flaw> {
        let found = if self.ascii {
            self.header::<i64>("a whole number")?
        } else {
            match kind {
                Scalar::I64 => self.cursor.i64(Endian::Big)?,
                Scalar::I32 => self.cursor.i32(Endian::Big)?.into(),
                // Other types aren't used for indices in practice. Their values are converted through f64, which is
                // exact for small values.
                other => self.float(other)? as i64,
            }
        };
        u64::try_from(found).map_err(|_| Flaw::new("a non-negative whole number", found.to_string()))
    }

    pub(super) fn points(&mut self) -> Result<Vec<[f64; 3]>, Flaw> {
        let count: u64 = self.header("the number of points")?;
        let kind = scalar(self.cursor.token())?;
        self.begin();
        let count = bounded(count, 3 * self.least(kind.size()), self.cursor.remaining() + 1, "points")?;
        let mut points = Vec::with_capacity(count);
        for _ in 0..count {
            let mut point = [0.0; 3];
            for x in &mut point {
                *x = self.float(kind)?;
            }
            points.push(point);
        }
        Ok(points)
    }

    /// Reads cells, and passes the corners of each cell to `cell`.
    pub(super) fn cells(&mut self, mut cell: impl FnMut(&[u32]) -> Result<(), Flaw>) -> Result<(), Flaw> {
        let first: u64 = self.header("the number of cells")?;
        let second: u64 = self.header("the size of the cell list")?;
        let mut ahead = self.cursor;
        if ahead.token() == b"OFFSETS" {
            self.cursor = ahead;
            return self.cells_by_offset(first, second, cell);
        }
        self.begin();
        let count = self.bounded(first, 4, "cells")?;
        let mut left = self.bounded(second, 4, "numbers in the cell list")?;
        let mut corners = Vec::new();
        for _ in 0..count {
            let n = self.integer(Scalar::I32)?;
            let n = usize::try_from(n).ok().filter(|&n| n < left).ok_or_else(|| {
                Flaw::new(
                    "cells that fill the cell list exactly",
                    format!("a cell of {n} corners that extends beyond the list"),
                )
            })?;
            left -= n + 1;
            corners.clear();
            for _ in 0..n {
                corners.push(self.corner(Scalar::I32)?);
            }
            cell(&corners)?;
        }
        if left > 0 {
            return Err(Flaw::new("cells that fill the cell list exactly", format!("{left} unused numbers")));
        }
        Ok(())
    }

    /// Reads cells of version 5. The file has `offsets` numbers, which are the start of each cell and the end of the
    /// last cell. The corners of all cells follow.
    fn cells_by_offset(
        &mut self,
        offsets: u64,
        corners: u64,
        mut cell: impl FnMut(&[u32]) -> Result<(), Flaw>,
    ) -> Result<(), Flaw> {
        let kind = scalar(self.cursor.token())?;
        self.begin();
        let offset_count = self.bounded(offsets, kind.size(), "offsets")?;
        let mut starts = Vec::with_capacity(offset_count);
        for _ in 0..offset_count {
            starts.push(self.integer(kind)?);
        }
        let word = self.cursor.token();
        if word != b"CONNECTIVITY" {
            return Err(Flaw::new("CONNECTIVITY", shown(word)));
        }
        let kind = scalar(self.cursor.token())?;
        self.begin();
        let corner_count = self.bounded(corners, kind.size(), "corners")?;
        let mut all = Vec::with_capacity(corner_count);
        for _ in 0..corner_count {
            all.push(self.corner(kind)?);
        }
        for pair in starts.windows(2) {
            let &[start, end] = pair else { continue };
            let range = usize::try_from(start).ok().zip(usize::try_from(end).ok());
            let corners = range.and_then(|(start, end)| all.get(start..end)).ok_or_else(|| {
                Flaw::new(format!("increasing offsets of at most {corner_count}"), format!("{end} after {start}"))
            })?;
            cell(corners)?;
        }
        Ok(())
    }

    fn corner(&mut self, kind: Scalar) -> Result<u32, Flaw> {
        let i = self.integer(kind)?;
        u32::try_from(i).map_err(|_| Flaw::new("a point's index", i.to_string()))
    }

    /// Reads the types of `cells` cells.
    pub(super) fn cell_types(&mut self, cells: usize) -> Result<Vec<u64>, Flaw> {
        let count: u64 = self.header("the number of cell types")?;
        if count != cells as u64 {
            return Err(Flaw::new(format!("{cells} cell types, one per cell"), count.to_string()));
        }
        self.begin();
        let count = self.bounded(count, 4, "cell types")?;
        (0..count).map(|_| self.integer(Scalar::I32)).collect()
    }

    /// Skips a field: `FIELD name arrays`, then for each array `name components tuples type` and its data.
    pub(super) fn skip_field(&mut self) -> Result<(), Flaw> {
        self.cursor.token();
        let arrays: u64 = self.header("the number of arrays in a field")?;
        for _ in 0..arrays {
            self.cursor.token();
            let components: u64 = self.header("a field's components")?;
            let tuples: u64 = self.header("a field's tuples")?;
            let kind = scalar(self.cursor.token())?;
            self.begin();
            let count = components.saturating_mul(tuples);
            let count = self.bounded(count, kind.size(), "field values")?;
            if self.ascii {
                for _ in 0..count {
                    self.float(kind)?;
                }
            } else {
                self.cursor.take(count.saturating_mul(kind.size()))?;
            }
        }
        Ok(())
    }
}
