//! Reads point clouds in Stanford's PLY format, with one row per vertex and one column per numeric property. Faces are
//! ignored.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use spharm_surface::io::Scalar;

use super::csv;
use super::records::{Field, Kind, Records, Stream};
use super::table::Table;
use crate::MomentsError;
use crate::moments::Shard;

const FORMAT: &str = "PLY";
const LONGEST_HEADER: u64 = 1 << 20;
const BUFFER: usize = 1 << 18;

/// The header's description of the vertex element.
#[derive(Default)]
struct Header {
    encoding: Option<Encoding>,
    names: Vec<String>,
    fields: Vec<Field>,
    row: usize,
    rows: u64,
    /// Number of elements after the vertices, such as faces.
    others: u64,
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Binary { little: bool },
}

/// Opens a PLY file. Returns the shard's rows as a table, and the number of rows if it is known.
pub(super) fn open(
    path: &Path,
    file: File,
    bytes: u64,
    shard: Shard,
) -> Result<(Box<dyn Table>, Option<u64>), MomentsError> {
    let malformed = |expected: String, found: String| MomentsError::Malformed {
        path: path.to_owned(),
        format: FORMAT,
        expected,
        found,
    };
    let mut input = BufReader::new(file);
    let mut text = Vec::new();
    let mut limited = input.by_ref().take(LONGEST_HEADER);
    while !text.ends_with(b"end_header\n") && !text.ends_with(b"end_header\r\n") {
        if limited.read_until(b'\n', &mut text).map_err(MomentsError::io(path, "read"))? == 0 {
            return Err(malformed("a line end_header".to_owned(), "no such line".to_owned()));
        }
    }
    let length = text.len() as u64;
    let header = parse(&String::from_utf8_lossy(&text)).map_err(|(expected, found)| malformed(expected, found))?;
    match header.encoding {
        Some(Encoding::Binary { little }) => {
            let least = header.rows.checked_mul(header.row as u64).and_then(|values| values.checked_add(length));
            if least.is_none_or(|least| least > bytes) {
                let expected = format!("a header and {} vertices of {} bytes", header.rows, header.row);
                return Err(malformed(expected, format!("{bytes} bytes in total")));
            }
            let rows = shard.range(header.rows);
            let mut file = input.into_inner();
            let at = length + rows.start * header.row as u64;
            file.seek(SeekFrom::Start(at)).map_err(MomentsError::io(path, "read"))?;
            let input = Box::new(BufReader::with_capacity(BUFFER, file));
            let fields = header.fields.iter().map(|field| Field { little, ..*field }).collect();
            let stream = Stream { input, row: header.row, fields };
            let count = rows.end - rows.start;
            let table = Records::new(path.to_owned(), FORMAT, header.names, vec![stream], rows);
            Ok((Box::new(table), Some(count)))
        }
        Some(Encoding::Ascii) if header.others == 0 => {
            let table = csv::of_rows(path, input.into_inner(), length..bytes, header.names, shard)?;
            Ok((Box::new(table), None))
        }
        Some(Encoding::Ascii) => {
            let expected = "a text file with vertices only (binary files may also have faces)".to_owned();
            Err(malformed(expected, format!("{} elements of other kinds", header.others)))
        }
        None => Err(malformed("a format line".to_owned(), "none".to_owned())),
    }
}

fn parse(text: &str) -> Result<Header, (String, String)> {
    let mut header = Header::default();
    let mut lines = text.lines();
    if lines.next().map(str::trim) != Some("ply") {
        return Err(("the word ply".to_owned(), text.chars().take(8).collect::<String>().escape_debug().to_string()));
    }
    let mut vertices = None;
    for line in lines {
        let words: Vec<&str> = line.split_whitespace().collect();
        let unclear = |expected: &str| Err((expected.to_owned(), line.escape_debug().to_string()));
        match words[..] {
            ["format", "ascii", _] => header.encoding = Some(Encoding::Ascii),
            ["format", "binary_little_endian", _] => header.encoding = Some(Encoding::Binary { little: true }),
            ["format", "binary_big_endian", _] => header.encoding = Some(Encoding::Binary { little: false }),
            ["element", name, count] => {
                let Ok(count) = count.parse::<u64>() else { return unclear("the number of elements") };
                match (name, vertices) {
                    ("vertex", None) => (header.rows, vertices) = (count, Some(true)),
                    (_, None) => return unclear("vertices before all other elements"),
                    _ => (header.others, vertices) = (header.others.saturating_add(count), Some(false)),
                }
            }
            ["property", kind, name] if vertices == Some(true) => {
                let kind = match kind {
                    "char" | "int8" => Scalar::I8,
                    "uchar" | "uint8" => Scalar::U8,
                    "short" | "int16" => Scalar::I16,
                    "ushort" | "uint16" => Scalar::U16,
                    "int" | "int32" => Scalar::I32,
                    "uint" | "uint32" => Scalar::U32,
                    "float" | "float32" => Scalar::F32,
                    "double" | "float64" => Scalar::F64,
                    _ => return unclear("the type of a number"),
                };
                header.fields.push(Field { at: header.row, kind: Kind::Number(kind), little: true });
                header.names.push(name.to_owned());
                header.row += kind.size();
            }
            ["property", ..] if vertices == Some(true) => {
                return unclear("vertex properties that are numbers, not lists");
            }
            _ => {}
        }
    }
    if header.fields.is_empty() {
        return Err(("vertices with numeric properties".to_owned(), "none".to_owned()));
    }
    Ok(header)
}
