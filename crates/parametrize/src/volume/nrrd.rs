//! Reads NRRD files (`.nrrd`, or `.nhdr` with the values in another file): a header of lines `field: value` up to an
//! empty line, then the values, raw or gzipped.
//!
//! Positions are converted to RAS+: for a file in left-posterior-superior space, as written by 3D Slicer and ITK, x and
//! y change sign. Lengths in a known unit are converted to mm. Source: <https://teem.sourceforge.net/nrrd/format.html>.

use std::collections::HashMap;
use std::io::Read;
use std::path::{Component, Path};

use spharm_surface::io::MOST_EXPANSION;

use super::affine::Affine;
use super::doubt::VolumeDoubt;
use super::source::{Source, load};
use super::tiff::micrometres;
use super::values::{Layout, Scalar, Volume, cut_short};
use crate::error::ParametrizeError;

/// Largest accepted number of bytes of a header. Real headers are much shorter.
const LONGEST_HEADER: usize = 1 << 20;

/// The fields of a header, by name in lower case.
struct Header<'a>(HashMap<String, &'a str>);

impl<'a> Header<'a> {
    /// Reads a header. Also returns the offset of the values, for files that contain them.
    fn read(bytes: &'a [u8]) -> Option<(Self, usize)> {
        let mut fields = HashMap::new();
        let mut at = 0;
        loop {
            let rest = bytes.get(at..).filter(|_| at < LONGEST_HEADER)?;
            let end = rest.iter().position(|&byte| byte == b'\n');
            let line = std::str::from_utf8(&rest[..end.unwrap_or(rest.len())]).ok()?.trim_end();
            // If the values are in another file, the header may end at the end of the file without an empty line.
            at += end.map_or(rest.len(), |end| end + 1);
            if line.is_empty() || end.is_none() {
                return Some((Self(fields), at));
            }
            if let Some((name, value)) = line.split_once(':').filter(|_| !line.starts_with('#')) {
                fields.insert(name.trim().to_ascii_lowercase().replace(' ', ""), value.trim());
            }
        }
    }

    fn get(&self, name: &str) -> Option<&'a str> {
        self.0.get(name).copied()
    }
}

/// Parses a file.
pub(super) fn parse(source: &Source<'_>, bytes: &[u8]) -> Result<Volume, ParametrizeError> {
    let unreadable = || source.wrong("a text header (NRRD)", "a header that isn't text or is too long".to_owned());
    let (header, start) = Header::read(bytes).ok_or_else(unreadable)?;
    let scalar = scalar(header.get("type").unwrap_or_default())
        .ok_or_else(|| source.wrong("numbers", format!("type {:?}", header.get("type").unwrap_or("none"))))?;
    let sizes: Option<Vec<u16>> = header.get("sizes").and_then(|sizes| words(sizes).map(|n| n.parse().ok()).collect());
    let Some([x, y, z]) = sizes.as_deref().and_then(<[u16]>::as_array) else {
        let found = format!("sizes {:?}; extract one volume", header.get("sizes").unwrap_or("none"));
        return Err(source.wrong("three dimensions", found));
    };
    source.image(1, 1)?;
    source.fixed_axes("an NRRD file")?;
    let size = [*x, *y, *z].map(usize::from);
    for field in ["lineskip", "byteskip"] {
        if let Some(skip) = header.get(field).filter(|&skip| skip != "0") {
            return Err(source.wrong("values directly after the header", format!("{field}: {skip}")));
        }
    }
    let little_endian = match header.get("endian").map(str::to_ascii_lowercase).as_deref() {
        Some("little") => true,
        Some("big") => false,
        None if scalar.size() == 1 => true,
        other => return Err(source.wrong("the field endian: little or big", other.unwrap_or("none").to_owned())),
    };
    let layout = Layout { size, scalar, little_endian, scaling: None };
    let other = header.get("datafile").map(|name| beside(source, name)).transpose()?;
    let values = other.as_deref().or(bytes.get(start..)).unwrap_or_default();
    let too_many = |most: u64| {
        let bits = 8 * scalar.size();
        let found = format!("at most {most} bytes of values for {x} x {y} x {z} voxels of {bits} bits");
        Err(source.wrong("enough values for all voxels given in the header", found))
    };
    let voxels = match header.get("encoding").map(str::to_ascii_lowercase).as_deref() {
        Some("raw") if layout.bytes() > values.len() as u64 => return too_many(values.len() as u64),
        Some("raw") => layout.read(source, values)?,
        Some("gzip" | "gz") => match (values.len() as u64).saturating_mul(MOST_EXPANSION) {
            most if layout.bytes() > most => return too_many(most),
            _ => {
                let mut stream = flate2::bufread::MultiGzDecoder::new(values);
                let voxels = layout.read(source, &mut stream)?;
                // Reads to the end of the compressed data, so that its checksum is verified.
                let rest = std::io::copy(&mut stream.take(1 << 20), &mut std::io::sink());
                rest.map_err(|error| cut_short(source.path, &error.to_string()))?;
                voxels
            }
        },
        other => return Err(source.wrong("encoding: raw or gzip", other.unwrap_or("none").to_owned())),
    };
    let (affine, doubt) = affine(source, &header)?;
    Ok(Volume { size, affine, voxels, doubt })
}

/// Reads the data file that a header names. This file must be in the header's folder or in a subfolder.
fn beside(source: &Source<'_>, name: &str) -> Result<Vec<u8>, ParametrizeError> {
    let path = Path::new(name);
    let plain = path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if !plain || name.starts_with("LIST") || name.contains('%') {
        let expected = "a single data file, in the header's folder or a subfolder";
        return Err(source.wrong(expected, format!("data file {name:?}")));
    }
    load(&source.path.parent().unwrap_or(Path::new("")).join(path))
}

fn scalar(kind: &str) -> Option<Scalar> {
    Some(match kind.to_ascii_lowercase().as_str() {
        "signed char" | "int8" | "int8_t" => Scalar::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Scalar::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Scalar::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Scalar::U16,
        "int" | "signed int" | "int32" | "int32_t" => Scalar::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => Scalar::U32,
        "longlong" | "long long" | "long long int" | "signed long long" | "int64" | "int64_t" => Scalar::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => Scalar::U64,
        "float" => Scalar::F32,
        "double" => Scalar::F64,
        _ => return None,
    })
}

/// Returns, for each axis, the length in mm of the unit given in the field `name`; 1 if the field is missing. If the
/// unit is unknown, also returns a doubt to be reported, unless the caller gave the voxel size.
fn units(source: &Source<'_>, header: &Header<'_>, name: &str) -> ([f64; 3], Option<VolumeDoubt>) {
    let Some(text) = header.get(name) else { return ([1.0; 3], None) };
    let unit = |unit: &str| match unit.trim() {
        "" | "MM" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => Some(1.0),
        unit => micrometres(unit).map(|length| length / 1e3),
    };
    // By the standard, each unit is in quotation marks, but some programs leave these out.
    let found: Option<Vec<f64>> = match text.contains('"') {
        true => text.split('"').skip(1).step_by(2).map(unit).collect(),
        false => text.split_whitespace().map(unit).collect(),
    };
    let found: Option<[f64; 3]> = found.and_then(|found| found.try_into().ok());
    match found {
        Some(units) => (units, None),
        None => ([1.0; 3], source.voxel_size.is_none().then_some(VolumeDoubt::UnknownUnit)),
    }
}

/// Returns the matrix from voxel coordinates to RAS+ mm: from space directions and origin if present, otherwise from
/// spacings. Also returns the doubt about the unit of length, if any.
fn affine(source: &Source<'_>, header: &Header<'_>) -> Result<(Affine, Option<VolumeDoubt>), ParametrizeError> {
    let Some(directions) = header.get("spacedirections") else {
        let spacings: Option<Vec<f64>> =
            header.get("spacings").and_then(|spacings| words(spacings).map(|x| x.parse().ok()).collect());
        let sizes: Option<[f64; 3]> = spacings.and_then(|spacings| spacings.try_into().ok());
        let (units, doubt) = units(source, header, "units");
        let sizes = sizes.map(|sizes| [0, 1, 2].map(|axis| units[axis] * sizes[axis]));
        return Ok((source.affine(sizes.ok_or("an NRRD file without spacings"))?, doubt));
    };
    let signs = match header.get("space").map(str::to_ascii_lowercase).as_deref() {
        None | Some("right-anterior-superior" | "ras" | "3d-right-handed" | "scanner-xyz") => [1.0, 1.0, 1.0],
        Some("left-posterior-superior" | "lps") => [-1.0, -1.0, 1.0],
        Some("left-anterior-superior" | "las") => [-1.0, 1.0, 1.0],
        Some(other) => return Err(source.wrong("space: RAS, LPS or LAS", other.to_owned())),
    };
    let vectors = |text: &str| -> Option<Vec<[f64; 3]>> {
        let vector = |text: &str| {
            let numbers: Option<Vec<f64>> = text.split(',').map(|x| x.trim().parse().ok()).collect();
            numbers?.try_into().ok()
        };
        text.split('(').skip(1).map(|part| vector(part.split(')').next()?)).collect()
    };
    let wrong = || source.wrong("three space directions and a space origin", directions.to_owned());
    let axes = vectors(directions).filter(|axes| axes.len() == 3).ok_or_else(wrong)?;
    let origin = match header.get("spaceorigin") {
        Some(text) => vectors(text).and_then(|found| found.first().copied()).ok_or_else(wrong)?,
        None => [0.0; 3],
    };
    let (units, doubt) = units(source, header, "spaceunits");
    let row = |i: usize| [axes[0][i], axes[1][i], axes[2][i], origin[i]].map(|x| signs[i] * units[i] * x);
    let affine = Affine([row(0), row(1), row(2)]);
    if affine.is_valid() {
        Ok((affine, doubt))
    } else {
        Err(source.wrong("voxels of finite, nonzero volume", format!("the matrix {:?}", affine.0)))
    }
}

fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split_whitespace()
}
