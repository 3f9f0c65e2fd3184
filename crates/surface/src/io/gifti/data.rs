//! Decodes the numbers of a DataArray from any of GIfTI's encodings.

use std::borrow::Cow;
use std::io::Read;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::super::bytes::Endian;
use super::super::flaw::{Flaw, bounded, shown};
use super::super::text::{number, words};
use crate::room::{Bytes, check_room};

/// The decoded numbers of a DataArray.
///
/// They are stored as f64, which represents GIfTI's types (float32, float64, int32, uint8) exactly.
#[derive(Debug, Default)]
pub(super) struct Array {
    /// The numbers (rows, columns), row-major.
    pub(super) values: Vec<f64>,
    /// Number of rows, which is the first dimension.
    pub(super) rows: usize,
    /// Number of columns, which is the product of the other dimensions.
    pub(super) columns: usize,
}

/// GIfTI's `DataType`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DataType {
    Float32,
    Float64,
    Int32,
    Uint8,
}

impl DataType {
    fn size(self) -> usize {
        match self {
            Self::Uint8 => 1,
            Self::Float32 | Self::Int32 => 4,
            Self::Float64 => 8,
        }
    }
}

/// The attributes of a DataArray that describe its data, as text.
#[derive(Debug, Default)]
pub(super) struct Description {
    pub(super) data_type: String,
    pub(super) order: String,
    pub(super) encoding: String,
    pub(super) endian: String,
    pub(super) dimensionality: String,
    /// The attributes `Dim0`, `Dim1`, ...
    pub(super) dimensions: [Option<String>; 6],
}

/// Decodes the content of a Data element. `left` is the number of bytes that compressed data may still expand to.
pub(super) fn decode(description: &Description, text: &str, left: &mut u64) -> Result<Array, Flaw> {
    let data_type = match description.data_type.as_str() {
        "NIFTI_TYPE_FLOAT32" => DataType::Float32,
        "NIFTI_TYPE_FLOAT64" => DataType::Float64,
        "NIFTI_TYPE_INT32" => DataType::Int32,
        "NIFTI_TYPE_UINT8" => DataType::Uint8,
        other => {
            return Err(Flaw::unsupported(
                format!("DataType {}", shown(other.as_bytes())),
                "convert the arrays to float32, float64, int32 or uint8",
            ));
        }
    };
    let column_major = match description.order.as_str() {
        "RowMajorOrder" => false,
        "ColumnMajorOrder" => true,
        other => {
            return Err(attribute("ArrayIndexingOrder", "RowMajorOrder or ColumnMajorOrder", other));
        }
    };
    let (rows, columns, count) = shape(description)?;
    // Smallest number of bytes that a value takes: two in ASCII, 4/3 of the binary size in base64.
    let values = match description.encoding.as_str() {
        "ASCII" => {
            // One byte is added to the length, because the last value needs no separator after it.
            let n = bounded(count, 2, text.len() + 1, "values")?;
            ascii(text, n, data_type)?
        }
        "Base64Binary" => {
            let n = bounded(count, data_type.size(), text.len() / 4 * 3 + 3, "values")?;
            let raw = base64(text)?;
            binary(&raw, n, data_type, endian(description)?)?
        }
        "GZipBase64Binary" => {
            let n = expanded(count, data_type, text.len(), left)?;
            let raw = inflate(&base64(text)?, n * data_type.size())?;
            binary(&raw, n, data_type, endian(description)?)?
        }
        "ExternalFileBinary" => {
            return Err(Flaw::unsupported(
                "data in an external file",
                "convert the file with wb_command -gifti-convert GZIP_BASE64_BINARY",
            ));
        }
        other => {
            return Err(attribute("Encoding", "ASCII, Base64Binary or GZipBase64Binary", other));
        }
    };
    let values = if column_major && columns > 1 && rows > 1 {
        if description.dimensions.iter().flatten().count() > 2 {
            return Err(Flaw::unsupported(
                "a column-major array of more than two dimensions",
                "convert the array to row-major order",
            ));
        }
        transposed(&values, rows)
    } else {
        values
    };
    Ok(Array { values, rows, columns })
}

/// Checks that compressed text can hold `count` values, and subtracts the size of these values from `left`.
fn expanded(count: u64, data_type: DataType, text: usize, left: &mut u64) -> Result<usize, Flaw> {
    /// Largest number of bytes to which one byte of data compressed by Deflate can expand.
    const DEFLATED: u64 = 1032;
    let bytes = count.saturating_mul(data_type.size() as u64);
    if bytes / DEFLATED > text as u64 {
        return Err(Flaw::new(
            format!("values that fit in {text} bytes of compressed text"),
            format!("{count} values ({})", Bytes(bytes)),
        ));
    }
    match left.checked_sub(bytes) {
        Some(rest) => *left = rest,
        None => {
            let found = format!("{count} values ({}) in {text} bytes of compressed text", Bytes(bytes));
            return Err(Flaw::unsupported(found, "if you trust the file, write it again without compression"));
        }
    }
    // The decompressed bytes and the numbers decoded from them are in memory at the same time.
    check_room(count.saturating_mul(8).saturating_add(bytes))?;
    usize::try_from(count).map_err(|_| Flaw::new("values that fit in memory", count.to_string()))
}

fn attribute(name: &str, expected: &str, found: &str) -> Flaw {
    Flaw::new(format!("{name} {expected}"), shown(found.as_bytes()))
}

fn endian(description: &Description) -> Result<Endian, Flaw> {
    match description.endian.as_str() {
        "LittleEndian" => Ok(Endian::Little),
        "BigEndian" => Ok(Endian::Big),
        other => Err(attribute("Endian", "LittleEndian or BigEndian", other)),
    }
}

/// Returns an array's number of rows, its number of columns, and the product of both.
fn shape(description: &Description) -> Result<(usize, usize, u64), Flaw> {
    let dimensionality: usize = number(description.dimensionality.trim().as_bytes())
        .filter(|d| (1..=6).contains(d))
        .ok_or_else(|| attribute("Dimensionality", "from 1 to 6", &description.dimensionality))?;
    let mut sizes = [1_u64; 6];
    for (i, (size, text)) in sizes.iter_mut().zip(&description.dimensions).take(dimensionality).enumerate() {
        let text = text.as_deref().unwrap_or_default();
        *size = number(text.trim().as_bytes())
            .filter(|&n| n > 0)
            .ok_or_else(|| attribute(&format!("Dim{i}"), "above 0", text))?;
    }
    let [rows, rest @ ..] = sizes;
    let columns = rest.iter().try_fold(1_u64, |product, &n| product.checked_mul(n));
    let shape = columns.and_then(|columns| {
        let count = rows.checked_mul(columns)?;
        Some((usize::try_from(rows).ok()?, usize::try_from(columns).ok()?, count))
    });
    shape.ok_or_else(|| Flaw::new("dimensions of an array that fits in memory", format!("{sizes:?}")))
}

fn ascii(text: &str, count: usize, data_type: DataType) -> Result<Vec<f64>, Flaw> {
    let mut values = Vec::with_capacity(count);
    for word in words(text.as_bytes()) {
        let value = match data_type {
            // Values are rounded to the declared type, so that a text copy and a binary copy of a surface are
            // identical.
            DataType::Float32 => number::<f32>(word).map(f64::from),
            DataType::Float64 => number::<f64>(word),
            DataType::Int32 => number::<i32>(word).map(f64::from),
            DataType::Uint8 => number::<u8>(word).map(f64::from),
        };
        match value {
            Some(value) if values.len() < count => values.push(value),
            Some(_) => {
                return Err(Flaw::new(format!("{count} values, as given by the array's dimensions"), "more"));
            }
            None => return Err(Flaw::new(format!("{data_type:?} values"), shown(word))),
        }
    }
    if values.len() < count {
        let found = values.len().to_string();
        return Err(Flaw::new(format!("{count} values, as given by the array's dimensions"), found));
    }
    Ok(values)
}

fn base64(text: &str) -> Result<Vec<u8>, Flaw> {
    let trimmed = text.trim_ascii();
    // In most files, the base64 text has no white space; some files break it into lines.
    let compact: Cow<'_, [u8]> = if trimmed.bytes().any(|b| b.is_ascii_whitespace()) {
        trimmed.bytes().filter(|b| !b.is_ascii_whitespace()).collect()
    } else {
        trimmed.as_bytes().into()
    };
    STANDARD.decode(compact).map_err(|e| Flaw::new("valid base64 in a Data element", e.to_string()))
}

/// Inflates zlib or gzip data. Stops one byte beyond `size`, so that callers can detect excess data.
fn inflate(packed: &[u8], size: usize) -> Result<Vec<u8>, Flaw> {
    // Numbers seldom compress more than tenfold. Memory for an expansion of up to 64-fold is allocated in advance, and
    // more only as the bytes arrive.
    let likely = packed.len().saturating_mul(64);
    let mut raw = Vec::with_capacity(size.min(likely).saturating_add(1));
    let limit = size as u64 + 1;
    // The standard specifies "GZip", but all programs write data in zlib's format. Data in gzip format are read, too.
    let done = if packed.starts_with(&[0x1f, 0x8b]) {
        flate2::read::GzDecoder::new(packed).take(limit).read_to_end(&mut raw)
    } else {
        flate2::read::ZlibDecoder::new(packed).take(limit).read_to_end(&mut raw)
    };
    done.map_err(|e| Flaw::new("a valid zlib stream in a Data element", e.to_string()))?;
    Ok(raw)
}

fn binary(raw: &[u8], count: usize, data_type: DataType, endian: Endian) -> Result<Vec<f64>, Flaw> {
    if raw.len() != count * data_type.size() {
        let found = match raw.len() > count * data_type.size() {
            true => "more".to_owned(),
            false => raw.len().to_string(),
        };
        return Err(Flaw::new(
            format!("{} bytes of data, as given by the array's dimensions", count * data_type.size()),
            found,
        ));
    }
    fn convert<const N: usize>(raw: &[u8], number: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        raw.as_chunks().0.iter().map(|&bytes| number(bytes)).collect()
    }
    Ok(match (data_type, endian) {
        (DataType::Float32, Endian::Little) => convert(raw, |b| f32::from_le_bytes(b).into()),
        (DataType::Float32, Endian::Big) => convert(raw, |b| f32::from_be_bytes(b).into()),
        (DataType::Float64, Endian::Little) => convert(raw, f64::from_le_bytes),
        (DataType::Float64, Endian::Big) => convert(raw, f64::from_be_bytes),
        (DataType::Int32, Endian::Little) => convert(raw, |b| i32::from_le_bytes(b).into()),
        (DataType::Int32, Endian::Big) => convert(raw, |b| i32::from_be_bytes(b).into()),
        (DataType::Uint8, _) => convert(raw, |[b]: [u8; 1]| b.into()),
    })
}

/// Converts values from column-major order, with columns of length `rows`, to row-major order.
fn transposed(values: &[f64], rows: usize) -> Vec<f64> {
    (0..rows).flat_map(|row| values.iter().skip(row).step_by(rows).copied()).collect()
}
