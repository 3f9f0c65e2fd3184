//! Reads and writes SPHARM-MAT's models. A file contains the complex matrix `fvec`, with one row per harmonic and three
//! columns, and, if the model has a sphere, `vertices`, `faces` (vertices numbered from 1) and `sph_verts`.
//!
//! | file | contents |
//! |---|---|
//! | `write` | writes MAT files of level 5, uncompressed |
//! | `read` | reads MAT files of level 5, in either byte order, compressed or not, with numbers of any type |
//!
//! A file consists of a header of 128 bytes and elements. An element consists of its type, its size in bytes, and its
//! contents, padded to a multiple of eight bytes. A matrix is an element whose contents are elements: flags,
//! dimensions, name, real parts, and imaginary parts. The parts are stored column by column.
//!
//! Source: "MAT-File Format", MathWorks.

mod read;
mod write;

use num_complex::Complex64;
use spharm_harmonics::{Coefficients, Directions};
use spharm_surface::Sphere;

use crate::flaw::Flaw;
use read::Matrix;

pub(crate) use read::is_mat;
pub(crate) use write::{Surface, write};

/// Reads the coefficients from `fvec`, and the sphere if the file has one.
pub(crate) fn read(bytes: &[u8]) -> Result<(Coefficients, Option<Sphere>), Flaw> {
    let [fvec, sph_verts, faces] = read::matrices(bytes, ["fvec", "sph_verts", "faces"])?;
    let fvec = fvec.ok_or_else(|| without_coefficients(bytes, sph_verts.is_some()))?;
    let complex = fvec.to_array(Complex64::new);
    let coefficients = Coefficients::from_complex(&complex)
        .map_err(|_| Flaw::new("fvec with (L + 1)^2 rows", format!("{} rows", fvec.rows)))?;
    let sphere = sph_verts.map(|directions| sphere(&directions, faces.as_ref())).transpose()?;
    Ok((coefficients, sphere))
}

/// Returns the error for a file without `fvec`. SPHARM-MAT also writes files that have only a surface, with or without
/// its sphere.
fn without_coefficients(bytes: &[u8], has_sphere: bool) -> Flaw {
    match read::matrices(bytes, ["vertices"]) {
        Ok([Some(_)]) if has_sphere => Flaw::Other {
            found: "a surface and its sphere (vertices and sph_verts), but no coefficients (fvec)",
            remedy: "save `vertices` and `sph_verts`, both with `faces`, as meshes, and run `spharm fit --surface \
                     SURFACE --sphere SPHERE`",
        },
        Ok([Some(_)]) => Flaw::Other {
            found: "a surface (vertices), but no sphere (sph_verts) and no coefficients (fvec)",
            remedy: "save `vertices` and `faces` as a mesh, and run `spharm fit MESH`",
        },
        _ => Flaw::new("a matrix `fvec`", "none"),
    }
}

fn sphere(vertices: &Matrix, faces: Option<&Matrix>) -> Result<Sphere, Flaw> {
    let three = |name: &str, found: &Matrix| match found.columns {
        3 => Ok(()),
        columns => Err(Flaw::new(format!("{name} with 3 columns"), columns)),
    };
    three("sph_verts", vertices)?;
    let vectors: Vec<[f64; 3]> = (0..vertices.rows).map(|row| [0, 1, 2].map(|axis| vertices.real(row, axis))).collect();
    let directions =
        Directions::from_vertices(&vectors).map_err(|error| Flaw::new("valid directions in sph_verts", error))?;
    let mut sphere = Sphere::from_directions(directions);
    if let Some(faces) = faces {
        three("faces", faces)?;
        let corner = |row, axis| {
            let index = faces.real(row, axis);
            let there = index.fract() == 0.0 && index >= 1.0 && index <= vectors.len() as f64;
            there.then(|| index as u32 - 1)
        };
        let triangle = |row| Some([corner(row, 0)?, corner(row, 1)?, corner(row, 2)?]);
        let triangles: Option<Vec<[u32; 3]>> = (0..faces.rows).map(triangle).collect();
        let expected = || format!("vertex numbers from 1 to {} in `faces`", vectors.len());
        sphere.faces = triangles.ok_or_else(|| Flaw::new(expected(), "other numbers"))?;
    }
    Ok(sphere)
}
