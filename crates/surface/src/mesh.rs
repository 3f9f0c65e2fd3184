//! Triangle meshes and values on their vertices.

/// A triangle mesh.
///
/// The order of the vertices (which a study's subjects share) and the winding of the triangles (by convention
/// counter-clockwise seen from outside) are never changed by this crate.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Positions, in the file's units: mm, and RAS+, for brains.
    pub vertices: Vec<[f64; 3]>,
    /// Triangles, as indices into `vertices` counted from 0.
    pub faces: Vec<[u32; 3]>,
    /// Metadata of the file.
    pub meta: Meta,
}

impl Mesh {
    /// Returns a mesh without metadata.
    #[must_use]
    pub fn new(vertices: Vec<[f64; 3]>, faces: Vec<[u32; 3]>) -> Self {
        Self { vertices, faces, meta: Meta::default() }
    }

    /// Returns a mesh with these positions, and the triangles and metadata of this one.
    ///
    /// # Panics
    ///
    /// When the number of vertices differs.
    #[must_use]
    pub fn with_vertices(&self, vertices: Vec<[f64; 3]>) -> Self {
        assert_eq!(
            vertices.len(),
            self.vertices.len(),
            "a mesh of {} vertices got {} positions",
            self.vertices.len(),
            vertices.len()
        );
        Self { vertices, faces: self.faces.clone(), meta: self.meta.clone() }
    }
}

/// Metadata of a mesh's file, kept from reading to writing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Meta {
    /// GIfTI's `AnatomicalStructurePrimary`, such as `CortexLeft`; Workbench requires it.
    pub anatomical_structure_primary: Option<String>,
    /// GIfTI metadata of the file as a whole: (name, value).
    pub file_metadata: Vec<(String, String)>,
    /// GIfTI metadata of the point set, without `AnatomicalStructurePrimary`: (name, value).
    pub surface_metadata: Vec<(String, String)>,
    /// GIfTI's coordinate system. It is kept and not applied: positions are as stored, as in other readers.
    pub coordinate_system: Option<CoordinateSystem>,
    /// The comment that opens a FreeSurfer file ("created by ...").
    pub freesurfer_stamp: Option<String>,
    /// The bytes after a FreeSurfer file's triangles: the volume's geometry with its centre (`cras`); see
    /// [`VolumeGeometry`](crate::VolumeGeometry).
    pub freesurfer_footer: Option<Vec<u8>>,
}

/// GIfTI's `CoordinateSystemTransformMatrix`.
#[derive(Clone, Debug, PartialEq)]
pub struct CoordinateSystem {
    /// The space of the positions as stored.
    pub data_space: String,
    /// The space that `matrix` leads to.
    pub transformed_space: String,
    /// Row-major 4 x 4.
    pub matrix: [f64; 16],
}

/// Values on the vertices of a mesh: thickness, curvature, a time series.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Signal {
    /// (vertices, channels), row-major.
    pub values: Vec<f64>,
    /// Number of vertices.
    pub vertices: usize,
    /// Number of values per vertex.
    pub channels: usize,
}

impl Signal {
    /// Returns a signal with these values, (vertices, channels) row-major.
    ///
    /// # Panics
    ///
    /// When `values` is not `vertices * channels` long.
    #[must_use]
    pub fn new(values: Vec<f64>, vertices: usize, channels: usize) -> Self {
        assert_eq!(
            Some(values.len()),
            vertices.checked_mul(channels),
            "{} values for {vertices} vertices of {channels} channels",
            values.len()
        );
        Self { values, vertices, channels }
    }
}

/// The meaning of the channels at each vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// Positions: the three channels are x, y and z.
    #[default]
    Surface,
    /// Anything else, such as thickness.
    Signal,
}

/// The contents of a file.
#[derive(Clone, Debug, PartialEq)]
// One value per file read: boxing would save nothing.
#[expect(clippy::large_enum_variant)]
pub enum Input {
    /// A surface.
    Mesh(Mesh),
    /// Values on vertices.
    Signal(Signal),
}
