//! Reads and writes FreeSurfer's binary triangle surfaces (`lh.pial`) and new-format curv files (`lh.thickness`).
//!
//! All numbers are big-endian. A surface file begins with the magic bytes FF FF FE, a comment line and usually an empty
//! line. The numbers of vertices and triangles (i32), the positions (f32) and the triangles (i32) follow. The file ends
//! with a footer that depends on the program. The footer describes the geometry of the volume from which the surface
//! was made; its `c_ras` is the position of the surface's origin. The footer is kept byte for byte. A curv file
//! consists of the magic bytes FF FF FF, three counts, and values (f32).
//!
//! The crate neuroformats isn't used, because it drops the footer, and allocates as much memory as the counts in the
//! header imply, without checking them.

use std::io::{self, Write};

use super::bytes::{Cursor, Endian};
use super::flaw::{Flaw, bounded, shown};
use super::spec::Context;
use crate::mesh::{Mesh, Meta, Signal};
use crate::volume_geometry::VolumeGeometry;

const SURFACE_MAGIC: [u8; 3] = [0xff, 0xff, 0xfe];
const CURV_MAGIC: [u8; 3] = [0xff, 0xff, 0xff];

/// Reads a triangle surface.
pub(super) fn read_surface(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let mut cursor = Cursor::new(bytes);
    magic(&mut cursor, SURFACE_MAGIC)?;
    let stamp = cursor.line().unwrap_or_default();
    if cursor.rest().starts_with(b"\n") {
        cursor.take(1)?;
    }
    let vertices = count(&mut cursor, "vertices")?;
    let faces = count(&mut cursor, "triangles")?;
    let vertices = bounded(vertices, 12, cursor.remaining(), "vertices")?;
    let mut positions = Vec::with_capacity(vertices);
    for _ in 0..vertices {
        let mut position = [0.0; 3];
        for x in &mut position {
            *x = cursor.f32(Endian::Big)?.into();
        }
        positions.push(position);
    }
    let faces = bounded(faces, 12, cursor.remaining(), "triangles")?;
    let mut triangles = Vec::with_capacity(faces);
    for _ in 0..faces {
        let mut triangle = [0; 3];
        for i in &mut triangle {
            // A negative index becomes larger than any vertex index, and is rejected later.
            *i = cursor.i32(Endian::Big)?.cast_unsigned();
        }
        triangles.push(triangle);
    }
    Ok(Mesh {
        vertices: positions,
        faces: triangles,
        meta: Meta {
            freesurfer_stamp: Some(String::from_utf8_lossy(stamp).into_owned()),
            freesurfer_footer: (cursor.remaining() > 0).then(|| cursor.rest().to_vec()),
            ..Meta::default()
        },
    })
}

/// Reads a new-format curv file.
pub(super) fn read_curv(bytes: &[u8]) -> Result<Signal, Flaw> {
    let mut cursor = Cursor::new(bytes);
    magic(&mut cursor, CURV_MAGIC)?;
    let vertices = count(&mut cursor, "vertices")?;
    count(&mut cursor, "triangles")?;
    let channels = count(&mut cursor, "values per vertex")?;
    // The counts are below 2^31 each, so their product doesn't overflow.
    if (vertices * channels).checked_mul(4) != Some(cursor.remaining() as u64) {
        return Err(Flaw::new(
            format!("exactly {vertices} x {channels} values of 4 bytes each after the header"),
            format!(
                "{} bytes (the file may be an old FreeSurfer quadrangle surface, which begins with the same bytes \
                 and isn't supported)",
                cursor.remaining()
            ),
        ));
    }
    let (raw, _) = cursor.rest().as_chunks();
    let values = raw.iter().map(|&b| f32::from_be_bytes(b).into()).collect();
    Ok(Signal { values, vertices: vertices as usize, channels: channels as usize })
}

/// Returns the number of vertices in the header of a surface or a curv file; `None` for other files.
pub(super) fn declared(head: &[u8]) -> Option<u64> {
    let mut cursor = Cursor::new(head);
    let magic: [u8; 3] = cursor.array().ok()?;
    if magic == SURFACE_MAGIC {
        cursor.line()?;
        if cursor.rest().starts_with(b"\n") {
            cursor.take(1).ok()?;
        }
    } else if magic != CURV_MAGIC {
        return None;
    }
    count(&mut cursor, "vertices").ok()
}

fn magic(cursor: &mut Cursor<'_>, expected: [u8; 3]) -> Result<(), Flaw> {
    let found: [u8; 3] = cursor.array()?;
    if found == expected {
        return Ok(());
    }
    Err(Flaw::new(format!("the magic bytes {}", shown(&expected)), shown(&found)))
}

fn count(cursor: &mut Cursor<'_>, what: &str) -> Result<u64, Flaw> {
    let n = cursor.i32(Endian::Big)?;
    u64::try_from(n).map_err(|_| Flaw::new(format!("a number of {what}"), n.to_string()))
}

/// Writes a triangle surface with its original comment and footer. For a surface from a GIfTI file, the footer is made
/// from the volume geometry in the metadata.
pub(super) fn write_surface(out: &mut dyn Write, mesh: &Mesh, _: &Context<'_>) -> io::Result<()> {
    out.write_all(&SURFACE_MAGIC)?;
    let stamp = mesh.meta.freesurfer_stamp.as_deref().unwrap_or("created by spharm");
    // Newlines in the comment are replaced, because a newline would end the header early.
    writeln!(out, "{}\n", stamp.replace('\n', " "))?;
    write_i32(out, mesh.vertices.len())?;
    write_i32(out, mesh.faces.len())?;
    for &x in mesh.vertices.as_flattened() {
        out.write_all(&(x as f32).to_be_bytes())?;
    }
    for &i in mesh.faces.as_flattened() {
        write_i32(out, i as usize)?;
    }
    match &mesh.meta.freesurfer_footer {
        Some(footer) => out.write_all(footer),
        None => out.write_all(&VolumeGeometry::of(&mesh.meta).map(|geometry| geometry.to_footer()).unwrap_or_default()),
    }
}

/// Writes a curv file. The number of triangles in its header, which no reader uses, is set to that of a closed surface
/// of genus zero.
pub(super) fn write_curv(out: &mut dyn Write, signal: &Signal, _: &Context<'_>) -> io::Result<()> {
    out.write_all(&CURV_MAGIC)?;
    write_i32(out, signal.vertices)?;
    write_i32(out, (2 * signal.vertices).saturating_sub(4))?;
    write_i32(out, signal.channels)?;
    for &x in &signal.values {
        out.write_all(&(x as f32).to_be_bytes())?;
    }
    Ok(())
}

fn write_i32(out: &mut dyn Write, n: usize) -> io::Result<()> {
    let n = i32::try_from(n).map_err(|_| {
        io::Error::other(
            "FreeSurfer's formats hold at most 2^31 - 1 vertices or triangles; write surfaces as .ply and values as \
             .func.gii",
        )
    })?;
    out.write_all(&n.to_be_bytes())
}
