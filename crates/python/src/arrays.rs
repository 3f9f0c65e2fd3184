//! Converts between NumPy arrays and the library's types.
//!
//! Arrays may have any strides and are never written to. Shapes are checked here, because arrays of wrong shapes would
//! cause panics; the library checks the values.

use std::borrow::Cow;
use std::path::Path;

use ndarray::{Array2, ArrayView2};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use spharm::io::check_mesh;
use spharm::{Mesh, Seam, Sphere};

use crate::errors::{Failure, exception};
use crate::metadata::Metadata;

/// Positions as passed from Python, (n, 3).
pub(crate) type Positions<'py> = PyReadonlyArray2<'py, f64>;
/// Triangles as passed from Python, (f, 3), with vertices numbered from 0.
pub(crate) type Faces<'py> = PyReadonlyArray2<'py, u32>;
/// Triangles returned to Python.
pub(crate) type FacesOut<'py> = Bound<'py, PyArray2<u32>>;
/// Positions returned to Python.
pub(crate) type PositionsOut<'py> = Bound<'py, PyArray2<f64>>;

/// Returns the rows of an array of shape (n, 3).
///
/// # Errors
///
/// `ValueError` if the array has a different shape.
pub(crate) fn rows<T: Copy>(what: &str, array: ArrayView2<'_, T>) -> PyResult<Vec<[T; 3]>> {
    borrowed_rows(what, array).map(Cow::into_owned)
}

/// Returns the rows of an array of shape (n, 3) as [`rows`] does, without a copy if the array is C-contiguous.
pub(crate) fn borrowed_rows<'a, T: Copy>(what: &str, array: ArrayView2<'a, T>) -> PyResult<Cow<'a, [[T; 3]]>> {
    if array.ncols() != 3 {
        let shape = array.shape();
        return Err(PyValueError::new_err(format!(
            "{what}: expected shape (n, 3), found ({}, {})",
            shape[0], shape[1]
        )));
    }
    Ok(match array.to_slice() {
        Some(values) => Cow::Borrowed(values.as_chunks().0),
        None => array.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect(),
    })
}

/// Returns the mesh of these vertices and triangles. Checks that the triangles refer to existing vertices.
///
/// # Errors
///
/// `ValueError` for wrong shapes, `MeshError` for triangles with nonexistent vertices.
pub(crate) fn mesh(what: &str, vertices: &Positions<'_>, faces: &Faces<'_>) -> PyResult<Mesh> {
    let mesh = Mesh::new(
        rows(&format!("{what}'s vertices"), vertices.as_array())?,
        rows(&format!("{what}'s faces"), faces.as_array())?,
    );
    check_mesh(format!("the {what}").as_ref(), &mesh).map_err(|error| exception(vertices.py(), error.into()))?;
    Ok(mesh)
}

/// A sphere as passed from Python: directions of any length, and possibly triangles.
pub(crate) struct SphereArrays<'a> {
    vertices: Cow<'a, [[f64; 3]]>,
    faces: Vec<[u32; 3]>,
    parametrized: bool,
    seam: Option<Seam>,
    metadata: Option<Metadata>,
}

/// Record of cut handles as passed from Python: the surface's original numbers of vertices and triangles, and the
/// copied vertices.
pub(crate) type SeamIn = (usize, usize, Vec<u32>);
/// The record of cut handles as returned to Python, with the fields of [`SeamIn`].
pub(crate) type SeamOut<'py> = (usize, usize, Bound<'py, PyArray1<u32>>);

/// Converts a record of cut handles for Python.
pub(crate) fn seam_out(py: Python<'_>, seam: Seam) -> SeamOut<'_> {
    (seam.vertices, seam.faces, seam.copies.into_pyarray(py))
}

impl<'a> SphereArrays<'a> {
    /// Wraps the arrays of a sphere, without a record of cut handles and without metadata.
    ///
    /// # Errors
    ///
    /// `ValueError` for wrong shapes.
    pub(crate) fn new(vertices: &'a Positions<'_>, faces: Option<&Faces<'_>>, parametrized: bool) -> PyResult<Self> {
        let vertices = borrowed_rows("sphere", vertices.as_array())?;
        let faces = faces.map(|faces| rows("the sphere's faces", faces.as_array())).transpose()?.unwrap_or_default();
        Ok(Self { vertices, faces, parametrized, seam: None, metadata: None })
    }

    /// Copies the vertices unless they are already a copy. Work that may outlive the call needs a copy.
    pub(crate) fn owned(self) -> SphereArrays<'static> {
        let Self { vertices, faces, parametrized, seam, metadata } = self;
        SphereArrays { vertices: Cow::Owned(vertices.into_owned()), faces, parametrized, seam, metadata }
    }

    /// Adds the record of the handles that were cut.
    pub(crate) fn with_seam(self, seam: Option<SeamIn>) -> Self {
        Self { seam: seam.map(|(vertices, faces, copies)| Seam { vertices, faces, copies }), ..self }
    }

    /// Adds the metadata of the sphere's file.
    pub(crate) fn with_metadata(self, metadata: Option<Metadata>) -> Self {
        Self { metadata, ..self }
    }

    /// Checks the sphere and converts it to the library's type. The check takes a long time for large spheres.
    pub(crate) fn check(self) -> Result<Sphere, Failure> {
        let Self { vertices, faces, parametrized, seam, metadata } = self;
        let fits = |seam: Seam| seam.checked(vertices.len(), faces.len());
        let seam = seam.map(fits).transpose().map_err(|found| Failure::Argument(format!("seam: {found}")))?;
        let sphere = if faces.is_empty() {
            Sphere::from_directions(
                spharm::harmonics::Directions::from_vertices(&vertices).map_err(spharm::Error::from)?,
            )
        } else {
            Sphere::from_mesh(&Mesh::new(vertices.into_owned(), faces))?
        };
        let metadata = metadata.as_ref();
        let path = metadata.and_then(Metadata::path).map(Path::to_owned);
        let anatomical_structure = metadata.and_then(Metadata::structure).map(str::to_owned);
        Ok(Sphere { parametrized, seam, path, anatomical_structure, ..sphere })
    }
}

/// Returns the vertices, (n, 3), and triangles, (f, 3), of a mesh as NumPy arrays. The arrays take over the memory of
/// the mesh.
pub(crate) fn mesh_arrays<'py>(py: Python<'py>, mesh: Mesh) -> (PositionsOut<'py>, FacesOut<'py>) {
    (positions(py, mesh.vertices), triangles(py, mesh.faces))
}

/// Returns positions as a NumPy array, (n, 3).
pub(crate) fn positions(py: Python<'_>, rows: Vec<[f64; 3]>) -> PositionsOut<'_> {
    array(rows).into_pyarray(py)
}

/// Returns triangles as a NumPy array, (f, 3).
pub(crate) fn triangles(py: Python<'_>, rows: Vec<[u32; 3]>) -> FacesOut<'_> {
    array(rows).into_pyarray(py)
}

fn array<T: Copy>(rows: Vec<[T; 3]>) -> Array2<T> {
    let count = rows.len();
    Array2::from_shape_vec((count, 3), rows.into_flattened()).expect("each row has three values")
}
