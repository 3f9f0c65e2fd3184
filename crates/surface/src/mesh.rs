//! Defines triangle meshes, and values on their vertices.

/// A triangle mesh.
///
/// This crate keeps the triangles' winding and the order of the vertices, since corresponding vertices of a study's
/// subjects have the same index. The exceptions are repairs, reflections, and formats that store a vertex several
/// times. By convention, triangles are counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Positions, in the file's unit and axes: mm and RAS+ for brains.
    pub vertices: Vec<[f64; 3]>,
    /// Triangles, as indices into `vertices` counted from 0.
    pub faces: Vec<[u32; 3]>,
    /// Metadata from the mesh's file.
    pub meta: Meta,
}

impl Mesh {
    /// Returns a mesh without metadata.
    #[must_use]
    pub fn new(vertices: Vec<[f64; 3]>, faces: Vec<[u32; 3]>) -> Self {
        Self { vertices, faces, meta: Meta::default() }
    }

    /// Returns a mesh with the given positions, and the triangles and metadata of this one.
    ///
    /// # Panics
    ///
    /// Panics if the number of positions isn't the number of vertices.
    #[must_use]
    pub fn with_vertices(&self, vertices: Vec<[f64; 3]>) -> Self {
        assert_eq!(
            vertices.len(),
            self.vertices.len(),
            "expected {} positions, one per vertex, found {}",
            self.vertices.len(),
            vertices.len()
        );
        Self { vertices, faces: self.faces.clone(), meta: self.meta.clone() }
    }
}

/// Metadata of a mesh's file, which are kept when the mesh is read and written again.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Meta {
    /// GIfTI's `AnatomicalStructurePrimary`, such as `CortexLeft`. Workbench requires this entry.
    pub anatomical_structure_primary: Option<String>,
    /// GIfTI metadata of the file, as pairs (name, value). If a VTK, PLY, STL or OBJ file states its axes, as the files
    /// of 3D Slicer do, the list has the pair (`SPACE`, `LPS`) or (`SPACE`, `RAS`).
    pub file_metadata: Vec<(String, String)>,
    /// GIfTI metadata of the point set, without `AnatomicalStructurePrimary`, as pairs (name, value).
    pub surface_metadata: Vec<(String, String)>,
    /// GIfTI's coordinate system. It is preserved but not applied: positions are returned as stored, as in other
    /// readers.
    pub coordinate_system: Option<CoordinateSystem>,
    /// The comment at the beginning of a FreeSurfer file ("created by ...").
    pub freesurfer_stamp: Option<String>,
    /// The bytes after a FreeSurfer file's triangles: the volume's geometry with its centre (`cras`); see
    /// [`VolumeGeometry`](crate::VolumeGeometry).
    pub freesurfer_footer: Option<Vec<u8>>,
}

/// GIfTI's `CoordinateSystemTransformMatrix`.
#[derive(Clone, Debug, PartialEq)]
pub struct CoordinateSystem {
    /// Name of the coordinate space of the positions as stored.
    pub data_space: String,
    /// Name of the coordinate space of the positions after the transform by `matrix`.
    pub transformed_space: String,
    /// The transform from `data_space` to `transformed_space`: 4 x 4, row-major.
    pub matrix: [f64; 16],
}

/// Values on the vertices of a mesh, such as thickness, curvature or a time series.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Signal {
    /// The values as a row-major array of shape (vertices, channels).
    pub values: Vec<f64>,
    /// Number of vertices.
    pub vertices: usize,
    /// Number of values per vertex.
    pub channels: usize,
}

impl Signal {
    /// Returns a signal with the given values, a row-major array of shape (vertices, channels).
    ///
    /// # Panics
    ///
    /// Panics if the number of values isn't `vertices * channels`.
    #[must_use]
    pub fn new(values: Vec<f64>, vertices: usize, channels: usize) -> Self {
        assert_eq!(
            Some(values.len()),
            vertices.checked_mul(channels),
            "found {} values for {vertices} vertices with {channels} channels each",
            values.len()
        );
        Self { values, vertices, channels }
    }
}

/// The meaning of the channels of a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// Positions: the three channels are x, y and z.
    #[default]
    Surface,
    /// Any other values, such as thickness.
    Signal,
}

/// The contents of a file: a surface or values on vertices.
#[derive(Clone, Debug, PartialEq)]
// Boxing the larger variant would save nothing, since there is only one value per file.
#[expect(clippy::large_enum_variant)]
pub enum Input {
    /// A surface.
    Mesh(Mesh),
    /// Values on vertices.
    Signal(Signal),
}
