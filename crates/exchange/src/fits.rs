//! Reads and writes FITS files as written by healpy's `write_alm`: one binary table per channel. The columns of a table
//! are the index l^2 + l + m + 1, the real part and the imaginary part of each coefficient with m >= 0.
//!
//! Blocks have 2,880 bytes, headers consist of cards of 80 characters, and numbers are big-endian. Source: FITS
//! standard 4.0, sections 3, 4 and 7.3.

use std::io::{self, Write};

use num_complex::Complex64;
use spharm_harmonics::Coefficients;
use spharm_harmonics::index::degree_order;

use crate::convert::{from_orders, to_healpy};
use crate::flaw::Flaw;

const BLOCK: usize = 2880;
const CARD: usize = 80;
/// Size of a written row in bytes: an i64 and two f64.
const ROW: usize = 24;

/// Returns whether bytes begin like a FITS file.
pub(crate) fn is_fits(bytes: &[u8]) -> bool {
    bytes.starts_with(b"SIMPLE  =")
}

pub(crate) fn write(out: &mut dyn Write, a: &Coefficients) -> io::Result<()> {
    let (alm, at) = to_healpy(a);
    header(
        out,
        &[
            ("SIMPLE", "T".to_owned()),
            ("BITPIX", "8".to_owned()),
            ("NAXIS", "0".to_owned()),
            ("EXTEND", "T".to_owned()),
        ],
    )?;
    let text = |text: &str| format!("'{text:<8}'");
    for row in alm.rows() {
        header(
            out,
            &[
                ("XTENSION", text("BINTABLE")),
                ("BITPIX", "8".to_owned()),
                ("NAXIS", "2".to_owned()),
                ("NAXIS1", ROW.to_string()),
                ("NAXIS2", at.len().to_string()),
                ("PCOUNT", "0".to_owned()),
                ("GCOUNT", "1".to_owned()),
                ("TFIELDS", "3".to_owned()),
                ("TTYPE1", text("index")),
                ("TFORM1", text("K")),
                ("TTYPE2", text("real")),
                ("TFORM2", text("D")),
                ("TTYPE3", text("imag")),
                ("TFORM3", text("D")),
                ("MAX-LPOL", a.max_degree().to_string()),
                ("MAX-MPOL", a.max_degree().to_string()),
            ],
        )?;
        for (value, (l, m)) in row.iter().zip(&at) {
            out.write_all(&((l * l + l + m + 1) as i64).to_be_bytes())?;
            out.write_all(&value.re.to_be_bytes())?;
            out.write_all(&value.im.to_be_bytes())?;
        }
        let end = at.len() * ROW;
        out.write_all(&vec![0; end.next_multiple_of(BLOCK) - end])?;
    }
    Ok(())
}

fn header(out: &mut dyn Write, cards: &[(&str, String)]) -> io::Result<()> {
    let mut text = String::new();
    for (key, value) in cards {
        let card =
            if value.starts_with('\'') { format!("{key:<8}= {value}") } else { format!("{key:<8}= {value:>20}") };
        text += &format!("{card:<CARD$}");
    }
    text += &format!("{:<CARD$}", "END");
    let length = text.len().next_multiple_of(BLOCK);
    write!(out, "{text:<length$}")
}

/// The cards of a header, as pairs of a keyword and its value.
struct Header<'a>(Vec<(&'a str, &'a str)>);

impl<'a> Header<'a> {
    /// Reads a header, and advances `bytes` to the first byte after it.
    fn read(bytes: &mut &'a [u8]) -> Result<Self, Flaw> {
        let mut cards = Vec::new();
        let end = loop {
            let at = cards.len() * CARD;
            let card = bytes.get(at..at + CARD).and_then(|card| std::str::from_utf8(card).ok());
            let card = card.ok_or_else(|| {
                Flaw::new(
                    "header cards of 80 characters, ending with END",
                    "the end of the file, or bytes that aren't text",
                )
            })?;
            let key = card.get(..8).unwrap_or_default().trim_end();
            if key == "END" {
                break (at + CARD).next_multiple_of(BLOCK);
            }
            let value = card.get(8..).and_then(|rest| rest.strip_prefix('=')).unwrap_or_default().trim();
            cards.push((key, value));
        };
        *bytes = bytes
            .get(end..)
            .ok_or_else(|| Flaw::new("a header padded to blocks of 2880 bytes", "the end of the file"))?;
        Ok(Self(cards))
    }

    fn value(&self, key: &str) -> Option<&'a str> {
        self.0.iter().find(|(name, _)| *name == key).map(|(_, value)| *value)
    }

    fn text(&self, key: &str) -> Option<&'a str> {
        Some(self.value(key)?.strip_prefix('\'')?.split('\'').next()?.trim_end())
    }

    fn number(&self, key: &str) -> Result<usize, Flaw> {
        let value = self.value(key).and_then(|value| value.split('/').next()).map(str::trim);
        let found = || Flaw::new(format!("a whole number for {key}"), value.unwrap_or("no value"));
        value.and_then(|value| value.parse().ok()).ok_or_else(found)
    }

    /// Returns the size in bytes of the data after the header: `(axes + heap) * bytes`. Here `axes` is the product of
    /// the axis lengths, `heap` is the length of a table's heap (PCOUNT), and `bytes` is the size of a number.
    fn length(&self) -> Result<usize, Flaw> {
        let large = || Flaw::new("data that fit in memory", "larger data");
        let axes = self.number("NAXIS")?;
        let mut length = usize::from(axes > 0);
        for axis in 1..=axes.min(999) {
            length = length.checked_mul(self.number(&format!("NAXIS{axis}"))?).ok_or_else(large)?;
        }
        let bits = self.value("BITPIX").and_then(|value| value.split('/').next()?.trim().parse::<i64>().ok());
        let bytes = bits.map_or(1, |bits| (bits.unsigned_abs() / 8) as usize).max(1);
        let after = self.number("PCOUNT").unwrap_or(0);
        length.checked_add(after).and_then(|length| length.checked_mul(bytes)).ok_or_else(large)
    }
}

/// Type of the numbers in a column.
#[derive(Clone, Copy)]
enum Number {
    I16,
    I32,
    I64,
    F32,
    F64,
}

impl Number {
    fn size(self) -> usize {
        match self {
            Self::I16 => 2,
            Self::I32 | Self::F32 => 4,
            Self::I64 | Self::F64 => 8,
        }
    }

    fn read(self, bytes: &[u8]) -> Option<f64> {
        Some(match self {
            Self::I16 => f64::from(i16::from_be_bytes(*bytes.first_chunk()?)),
            Self::I32 => f64::from(i32::from_be_bytes(*bytes.first_chunk()?)),
            Self::I64 => i64::from_be_bytes(*bytes.first_chunk()?) as f64,
            Self::F32 => f64::from(f32::from_be_bytes(*bytes.first_chunk()?)),
            Self::F64 => f64::from_be_bytes(*bytes.first_chunk()?),
        })
    }
}

/// Reads every table of coefficients in a file. Returns the canonical coefficients, one vector per channel.
pub(crate) fn read(mut bytes: &[u8]) -> Result<Vec<Vec<f64>>, Flaw> {
    let mut channels = Vec::new();
    while !bytes.is_empty() {
        let header = Header::read(&mut bytes)?;
        let length = header.length()?;
        let data = bytes.get(..length);
        let data =
            data.ok_or_else(|| Flaw::new(format!("{length} bytes of data"), format!("{} bytes", bytes.len())))?;
        if header.text("XTENSION") == Some("BINTABLE") {
            channels.push(table(&header, data)?);
        }
        // The padding of the last block may be missing, because some writers omit it.
        bytes = bytes.get(length.next_multiple_of(BLOCK)..).unwrap_or_default();
    }
    if channels.is_empty() { Err(Flaw::new("a binary table", "none")) } else { Ok(channels) }
}

fn table(header: &Header<'_>, data: &[u8]) -> Result<Vec<f64>, Flaw> {
    let (width, rows) = (header.number("NAXIS1")?, header.number("NAXIS2")?);
    let mut columns = Vec::new();
    let mut at = 0;
    for i in 1..=3 {
        let form = header.text(&format!("TFORM{i}")).unwrap_or_default();
        let (number, repeat) =
            (form.trim_start_matches(|c: char| c.is_ascii_digit()), form.trim_end_matches(|c: char| c.is_alphabetic()));
        let number = match number {
            "I" => Number::I16,
            "J" => Number::I32,
            "K" => Number::I64,
            "E" => Number::F32,
            "D" => Number::F64,
            _ => return Err(Flaw::new(format!("numbers in column {i} (type I, J, K, E or D)"), format!("{form:?}"))),
        };
        if !["", "1"].contains(&repeat) || header.value(&format!("TZERO{i}")).is_some() {
            return Err(Flaw::new(format!("one unscaled number per row in column {i}"), format!("{form:?}")));
        }
        columns.push((at, number));
        at += number.size();
    }
    if at > width {
        return Err(Flaw::new(format!("rows of at least {at} bytes"), width));
    }
    // Reject a table without rows or columns, because its declared sizes haven't been checked against any data.
    if rows == 0 || width == 0 {
        return Err(Flaw::new("rows with an index, a real part and an imaginary part", "none"));
    }
    let mut entries = Vec::with_capacity(rows.min(data.len() / width));
    for row in data.chunks_exact(width).take(rows) {
        let mut cells = columns.iter().map(|&(at, number)| number.read(row.get(at..)?));
        let (Some(index), Some(re), Some(im)) =
            (cells.next().flatten(), cells.next().flatten(), cells.next().flatten())
        else {
            return Err(Flaw::new("rows with an index, a real part and an imaginary part", "a shorter row"));
        };
        let place = (index >= 1.0 && index.fract() == 0.0 && index < 1e10).then(|| degree_order(index as usize - 1));
        let place = place.filter(|(_, m)| *m >= 0);
        let (l, m) = place.ok_or_else(|| Flaw::new("indices l^2 + l + m + 1 with m >= 0", index))?;
        if !re.is_finite() || !im.is_finite() {
            return Err(Flaw::new("finite coefficients", format!("{re}, {im} for degree {l}, order {m}")));
        }
        entries.push((l, m.unsigned_abs(), Complex64::new(re, im)));
    }
    let degree = entries.iter().map(|&(l, ..)| l).max().unwrap_or(0);
    // A single index may declare a huge degree, so allocate memory only if the table has more rows than the degree.
    if entries.len() <= degree {
        return Err(Flaw::new(format!("rows up to degree {degree}"), format!("{} rows", entries.len())));
    }
    let triangle = |l: usize, m: usize| l * (l + 1) / 2 + m;
    let mut values = vec![Complex64::ZERO; triangle(degree + 1, 0)];
    for (l, m, value) in entries {
        if let Some(place) = values.get_mut(triangle(l, m)) {
            *place = value;
        }
    }
    Ok(from_orders(degree, |l, m| values.get(triangle(l, m)).copied().unwrap_or_default()))
}
