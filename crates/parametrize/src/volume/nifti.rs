//! Reads NIfTI-1 files (`.nii`, `.nii.gz`).
//!
//! The header is parsed by the crate `nifti`. The values are read here, because their number must be compared with the
//! file's size before memory is allocated for them.

use std::io::Read;

use nifti::{Endianness, NiftiHeader, NiftiType};

use super::affine::Affine;
use super::doubt::VolumeDoubt;
use super::source::Source;
use super::values::{Layout, Scalar, Volume, cut_short, skip};
use crate::error::ParametrizeError;
use crate::geometry::{Vec3, norm, sub};

/// Number of bytes of a NIfTI-1 header.
const HEADER: usize = 348;
/// If the positions given by sform and qform differ by at most this share of the volume's diagonal, the difference is
/// attributed to rounding in the header. A quaternion of 32-bit numbers determines the angle of a half turn only to
/// within 7e-4 rad.
const ROUNDING: f64 = 1e-3;

/// Parses a file, given as a stream of at most `most` bytes.
pub(super) fn parse(source: &Source<'_>, mut stream: impl Read, most: u64) -> Result<Volume, ParametrizeError> {
    let (path, wrong) = (source.path, |expected, found| source.wrong(expected, found));
    let not_nifti = |what: &str| wrong("a NIfTI-1 volume (.nii, .nii.gz)", what.to_owned());
    let mut header = [0; HEADER];
    stream.read_exact(&mut header).map_err(|_| not_nifti("a file that is shorter than its header"))?;
    if !matches!(&header[344..348], b"n+1\0") {
        let pair = header[344..348] == *b"ni1\0";
        return Err(not_nifti(if pair {
            "a header with its values in an .img file; merge both files"
        } else {
            "another format"
        }));
    }
    let header = NiftiHeader::from_reader(&header[..]).map_err(|error| not_nifti(&error.to_string()))?;
    let dim = header.dim().map_err(|error| not_nifti(&error.to_string()))?;
    let dimensions: Vec<i64> = dim.iter().map(|&n| n.into()).collect();
    let image = image(source, &dimensions)?;
    let size = [dim[0], dim[1], dim[2]].map(usize::from);
    let kind = header.data_type().map_err(|error| not_nifti(&error.to_string()))?;
    let Some(scalar) = scalar(kind) else {
        return Err(wrong("numbers", format!("values of type {kind:?}")));
    };
    let unit = millimetres(source, header.xyzt_units.into())?;
    let (slope, intercept) = (f64::from(header.scl_slope), f64::from(header.scl_inter));
    // According to the standard, a slope of 0 means that the values aren't scaled.
    let scaled = slope != 0.0 && slope.is_finite() && intercept.is_finite() && (slope, intercept) != (1.0, 0.0);
    let layout = Layout {
        size,
        scalar,
        little_endian: header.endianness == Endianness::Little,
        scaling: scaled.then_some((slope, intercept)),
    };
    let offset = (f64::from(header.vox_offset).max(352.0) as u64).saturating_add(layout.bytes().saturating_mul(image));
    if layout.bytes() > most || offset > most {
        let [x, y, z] = size;
        let bits = 8 * scalar.size();
        let found = format!("a file too short for the {x} x {y} x {z} voxels of {bits} bits stated in its header");
        return Err(not_nifti(&found));
    }
    let broken = |error: std::io::Error| cut_short(path, &error.to_string());
    // Skips extensions between the header and the values.
    skip(source, &mut stream, offset - HEADER as u64)?;
    let voxels = layout.read(source, &mut stream)?;
    // Reads to the end of the compressed stream, so that its checksum is verified. Other data may follow the voxels'
    // values.
    std::io::copy(&mut (&mut stream).take(1 << 20), &mut std::io::sink()).map_err(broken)?;
    let forms = Forms::of(&header);
    let (affine, doubt) = (forms.affine().scaled(unit), forms.doubt(size, unit));
    if !affine.is_valid() {
        return Err(wrong("voxels of finite, nonzero volume", format!("the matrix {:?}", affine.0)));
    }
    Ok(Volume { size, affine, voxels, doubt })
}

/// Returns the number of images that precede the image to be read in the file. `dimensions` contains the number of
/// values along each axis: x, y, z, time, channel.
pub(super) fn image(source: &Source<'_>, dimensions: &[i64]) -> Result<u64, ParametrizeError> {
    let count =
        |axis: usize| usize::try_from(dimensions.get(axis).copied().unwrap_or(1)).ok().filter(|count| *count > 0);
    let (Some(times), Some(channels)) = (count(3), count(4)) else {
        return Err(source.wrong("dimensions above 0", format!("dimensions {dimensions:?}")));
    };
    if dimensions.len() < 3 || dimensions.iter().skip(5).any(|&n| n != 1) {
        return Err(source.wrong("three to five dimensions", format!("dimensions {dimensions:?}; extract one volume")));
    }
    source.fixed_axes("a NIfTI file")?;
    let [channel, time] = source.image(channels, times)?;
    Ok((channel as u64).saturating_mul(times as u64).saturating_add(time as u64))
}

/// Returns the length in mm of the header's unit of length, which is stored in bits 0 to 2 of the field `xyzt_units`.
pub(super) fn millimetres(source: &Source<'_>, xyzt_units: i32) -> Result<f64, ParametrizeError> {
    match xyzt_units & 7 {
        // Most files without a unit are in mm.
        0 | 2 => Ok(1.0),
        1 => Ok(1e3),
        3 => Ok(1e-3),
        code => Err(source.wrong(
            "xyzt_units with the length unit 0 (unknown, read as mm), 1 (m), 2 (mm) or 3 (micron)",
            format!("xyzt_units {xyzt_units}, with the length unit {code}; correct the header"),
        )),
    }
}

/// The fields of a header that describe the positions of voxels.
pub(super) struct Forms {
    /// Rows of the sform matrix, if the sform code is above 0.
    pub(super) sform: Option<[[f64; 4]; 3]>,
    /// Quaternion (b, c, d) and offset of the qform, if the qform code is above 0.
    pub(super) qform: Option<([f64; 3], [f64; 3])>,
    /// Codes of the sform and the qform, which state the coordinate systems of the positions: 1 for scanner
    /// coordinates, 4 for MNI coordinates, and so on.
    pub(super) codes: [i32; 2],
    /// Sizes of a voxel along the three axes.
    pub(super) sizes: [f64; 3],
    /// Whether the qform reverses the third axis.
    pub(super) mirrored: bool,
}

impl Forms {
    fn of(header: &NiftiHeader) -> Self {
        let row = |row: [f32; 4]| row.map(f64::from);
        let sform = [header.srow_x, header.srow_y, header.srow_z].map(row);
        let quaternion = [header.quatern_b, header.quatern_c, header.quatern_d].map(f64::from);
        let offset = [header.quatern_x, header.quatern_y, header.quatern_z].map(f64::from);
        Self {
            sform: (header.sform_code > 0).then_some(sform),
            qform: (header.qform_code > 0).then_some((quaternion, offset)),
            codes: [header.sform_code, header.qform_code].map(i32::from),
            sizes: [1, 2, 3].map(|k| f64::from(header.pixdim[k])),
            mirrored: header.pixdim[0] < 0.0,
        }
    }

    /// Returns the matrix from voxel coordinates to positions in the header's unit: the sform if present, otherwise the
    /// qform if present, otherwise the voxel sizes alone (methods 3, 2, 1 of the NIfTI standard).
    pub(super) fn affine(&self) -> Affine {
        let of_sizes = || Affine::of_voxel_size(self.sizes.map(f64::abs));
        self.sform.map(Affine).or_else(|| self.of_qform()).unwrap_or_else(of_sizes)
    }

    /// Returns a doubt about the positions in a volume of `size` voxels, whose unit is `unit` mm: the header has
    /// neither an sform nor a qform, or its sform and qform are for the same space but disagree. `None` if there is no
    /// doubt.
    pub(super) fn doubt(&self, size: [usize; 3], unit: f64) -> Option<VolumeDoubt> {
        let Some(rows) = self.sform else {
            return self.qform.is_none().then_some(VolumeDoubt::NoForm);
        };
        let [of_sform, of_qform] = self.codes;
        if of_sform != of_qform {
            return None;
        }
        let (sform, qform) = (Affine(rows).scaled(unit), self.of_qform()?.scaled(unit));
        let size = size.map(|voxels| voxels as f64);
        let corner = |bits: usize| [0, 1, 2].map(|axis: usize| if (bits >> axis) & 1 == 1 { size[axis] } else { 0.0 });
        let apart = (0..8).map(corner).map(|at| norm(sub(sform.apply(at), qform.apply(at)))).fold(0.0, f64::max);
        let diagonal = norm(sub(sform.apply(size), sform.apply([0.0; 3])));
        (apart > ROUNDING * diagonal).then_some(VolumeDoubt::Apart { distance: apart })
    }

    /// Returns the matrix of the qform in the header's unit; `None` without a qform.
    fn of_qform(&self) -> Option<Affine> {
        let ([b, c, d], offset) = self.qform?;
        let sizes = self.sizes.map(f64::abs);
        let a = (1.0 - (b * b + c * c + d * d)).max(0.0).sqrt();
        let turn = [
            [a * a + b * b - c * c - d * d, 2.0 * (b * c - a * d), 2.0 * (b * d + a * c)],
            [2.0 * (b * c + a * d), a * a + c * c - b * b - d * d, 2.0 * (c * d - a * b)],
            [2.0 * (b * d - a * c), 2.0 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ];
        let mirror = if self.mirrored { -1.0 } else { 1.0 };
        let row = |i: usize| {
            let [x, y, z]: Vec3 = turn[i];
            [x * sizes[0], y * sizes[1], z * sizes[2] * mirror, offset[i]]
        };
        Some(Affine([row(0), row(1), row(2)]))
    }
}

/// Returns the type of a voxel's value; `None` for a type that can't hold a label.
fn scalar(kind: NiftiType) -> Option<Scalar> {
    Some(match kind {
        NiftiType::Uint8 => Scalar::U8,
        NiftiType::Int8 => Scalar::I8,
        NiftiType::Uint16 => Scalar::U16,
        NiftiType::Int16 => Scalar::I16,
        NiftiType::Uint32 => Scalar::U32,
        NiftiType::Int32 => Scalar::I32,
        NiftiType::Uint64 => Scalar::U64,
        NiftiType::Int64 => Scalar::I64,
        NiftiType::Float32 => Scalar::F32,
        NiftiType::Float64 => Scalar::F64,
        _ => return None,
    })
}
