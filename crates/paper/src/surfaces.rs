//! The surfaces of the experiments.

use std::path::Path;

use anyhow::{Context, Result, bail};
use spharm_harmonics::Directions;
use spharm_monitor::{Level, Monitor};
use spharm_surface::generate::{Cortex, cortex, subdivide, subdivide_sphere};
use spharm_surface::metrics::bounding_box_scale;
use spharm_surface::{Mesh, read_sphere, read_target};

use crate::published::Kind;

/// A surface and its sphere.
pub(crate) struct Surface {
    /// Short name, for files and tables.
    pub(crate) name: String,
    /// The paper's surface with which it is compared.
    pub(crate) kind: Kind,
    /// The sphere's vertices.
    pub(crate) directions: Directions,
    /// Positions.
    pub(crate) vertices: Vec<[f64; 3]>,
    /// Triangles, of the surface and of the sphere.
    pub(crate) faces: Vec<[u32; 3]>,
    /// Cube root of the bounding box's volume.
    pub(crate) scale: f64,
}

impl Surface {
    fn new(name: &str, kind: Kind, surface: Mesh, directions: Directions) -> Result<Self> {
        let scale = bounding_box_scale(&surface.vertices).with_context(|| name.to_owned())?;
        let Mesh { vertices, faces, .. } = surface;
        Ok(Self { name: name.to_owned(), kind, directions, vertices, faces, scale })
    }

    /// Returns the sphere at four times the number of vertices.
    pub(crate) fn denser_sphere(&self) -> Mesh {
        subdivide_sphere(&Mesh::new(self.directions.as_slice().to_vec(), self.faces.clone()))
    }

    /// Returns the memory used, in bytes.
    pub(crate) fn bytes(&self) -> usize {
        2 * 24 * self.vertices.len() + 12 * self.faces.len()
    }
}

/// A known surface in the data: name, files of surface and sphere, and whether to subdivide it.
type Known = (&'static str, &'static str, &'static str, Kind, bool);

/// The paper's hippocampus has 10,082 vertices; these have about 2,400 before subdivision.
const KNOWN: [Known; 5] = [
    ("cort40962", "cort40962.surf.gii", "cort40962.sphere.surf.gii", Kind::Cortex, false),
    ("head27618", "head27618.surf.gii", "head27618.sphere.surf.gii", Kind::Head, false),
    ("hippo_a01_l", "hippo_a01_l.obj", "hippo_a01_l.sphere.obj", Kind::Hippocampus, true),
    ("hippo_a02_l", "hippo_a02_l.obj", "hippo_a02_l.sphere.obj", Kind::Hippocampus, true),
    ("hippo_a03_l", "hippo_a03_l.obj", "hippo_a03_l.sphere.obj", Kind::Hippocampus, true),
];

/// Generates the cortex, whose sphere is an icosphere.
pub(crate) fn generated(subdivisions: u32) -> Result<Surface> {
    let (surface, sphere) = cortex(&Cortex { subdivisions, variant: 0 });
    let directions = Directions::from_vertices(&sphere.vertices)?;
    Surface::new("generated", Kind::Cortex, surface, directions)
}

/// Reads the known surfaces in a data folder. Missing ones are skipped, with a note.
pub(crate) fn among(data: &Path, monitor: &dyn Monitor) -> Result<Vec<Surface>> {
    std::fs::read_dir(data).with_context(|| format!("{}: cannot open the folder of the surfaces", data.display()))?;
    let mut found = Vec::new();
    for (name, surface, sphere, kind, subdivided) in KNOWN {
        let (surface, sphere) = (data.join(surface), data.join(sphere));
        match [&surface, &sphere].into_iter().find(|path| !path.exists()) {
            Some(missing) => monitor.note(Level::Info, format_args!("{name} is left out: no {}", missing.display())),
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
