//! Reads and generates the surfaces of the experiments.

use std::path::Path;

use anyhow::{Context, Result, bail};
use spharm_harmonics::Directions;
use spharm_monitor::{Level, Monitor};
use spharm_surface::generate::{Cortex, cortex, subdivide, subdivide_sphere};
use spharm_surface::metrics::bounding_box_scale;
use spharm_surface::{Mesh, read_sphere, read_target};

use crate::published::Kind;

/// A surface with its spherical parametrization.
pub(crate) struct Surface {
    /// Short name of the surface, for file names and tables.
    pub(crate) name: String,
    /// The paper's surface with which this surface is compared.
    pub(crate) kind: Kind,
    /// Vertices of the sphere, one for each vertex of the surface.
    pub(crate) directions: Directions,
    /// Positions of the surface's vertices.
    pub(crate) vertices: Vec<[f64; 3]>,
    /// Triangles of the surface and of the sphere.
    pub(crate) faces: Vec<[u32; 3]>,
    /// Cube root of the volume of the surface's bounding box.
    pub(crate) scale: f64,
}

impl Surface {
    fn new(name: &str, kind: Kind, surface: Mesh, directions: Directions) -> Result<Self> {
        let scale = bounding_box_scale(&surface.vertices).with_context(|| name.to_owned())?;
        let Mesh { vertices, faces, .. } = surface;
        Ok(Self { name: name.to_owned(), kind, directions, vertices, faces, scale })
    }

    /// Returns the sphere after one subdivision, with about four times as many vertices.
    pub(crate) fn denser_sphere(&self) -> Mesh {
        subdivide_sphere(&Mesh::new(self.directions.as_slice().to_vec(), self.faces.clone()))
    }

    /// Returns the memory that the surface occupies, in bytes.
    pub(crate) fn bytes(&self) -> usize {
        2 * 24 * self.vertices.len() + 12 * self.faces.len()
    }
}

/// A surface that the data folder may contain: its name, the files of the surface and of its sphere, the corresponding
/// surface in the paper, and whether to subdivide it.
type Known = (&'static str, &'static str, &'static str, Kind, bool);

/// Surfaces that the data folder may contain. Hippocampi are subdivided, because their files have about 2,400 vertices,
/// whereas the paper's hippocampus has 10,082 vertices.
const KNOWN: [Known; 5] = [
    ("cort40962", "cort40962.surf.gii", "cort40962.sphere.surf.gii", Kind::Cortex, false),
    ("head27618", "head27618.surf.gii", "head27618.sphere.surf.gii", Kind::Head, false),
    ("hippo_a01_l", "hippo_a01_l.obj", "hippo_a01_l.sphere.obj", Kind::Hippocampus, true),
    ("hippo_a02_l", "hippo_a02_l.obj", "hippo_a02_l.sphere.obj", Kind::Hippocampus, true),
    ("hippo_a03_l", "hippo_a03_l.obj", "hippo_a03_l.sphere.obj", Kind::Hippocampus, true),
];

/// Generates an artificial cortex whose sphere is an icosphere.
pub(crate) fn generated(subdivisions: u32) -> Result<Surface> {
    let (surface, sphere) = cortex(&Cortex { subdivisions, variant: 0 });
    let directions = Directions::from_vertices(&sphere.vertices)?;
    Surface::new("generated", Kind::Cortex, surface, directions)
}

/// Reads the known surfaces in a data folder. Surfaces whose files are missing are skipped, with a note to the monitor.
pub(crate) fn among(data: &Path, monitor: &dyn Monitor) -> Result<Vec<Surface>> {
    std::fs::read_dir(data).with_context(|| format!("{}: cannot open the folder of the surfaces", data.display()))?;
    let mut found = Vec::new();
    for (name, surface, sphere, kind, subdivided) in KNOWN {
        let (surface, sphere) = (data.join(surface), data.join(sphere));
        match [&surface, &sphere].into_iter().find(|path| !path.exists()) {
            Some(missing) => {
                monitor.note(Level::Info, format_args!("{name} is skipped: {} doesn't exist", missing.display()))
            }
            None => found.push(read(name, kind, &surface, &sphere, subdivided)?),
        }
    }
    Ok(found)
}

fn read(name: &str, kind: Kind, surface: &Path, sphere: &Path, subdivided: bool) -> Result<Surface> {
    let sphere = read_sphere(sphere)?;
    let target = read_target(surface, &sphere)?;
    if let Some(warning) = target.warnings.first() {
        bail!("{}: {warning}", surface.display());
    }
    let vertices = target.values.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect();
    let surface = Mesh::new(vertices, sphere.faces.clone());
    if !subdivided {
        return Surface::new(name, kind, surface, sphere.directions);
    }
    let sphere = Mesh::new(sphere.directions.as_slice().to_vec(), sphere.faces);
    let directions = Directions::from_vertices(&subdivide_sphere(&sphere).vertices).with_context(|| name.to_owned())?;
    Surface::new(name, kind, subdivide(&surface), directions)
}
