//! Defines the weights of a fit's vertices.

use std::path::Path;

use spharm_store::WeightsHash;
use spharm_surface::Sphere;
use spharm_surface::io::read_signal;

use crate::Error;

/// Weight of each vertex in the least squares. In a fit of the surface, the weight of a sample in a triangle is
/// multiplied by the harmonic mean of the weights at the triangle's corners. Each corner has the same share in this
/// mean as in the sample's value. A vertex of weight 0 is excluded, like a vertex outside of a mask: its value is never
/// read and may be NaN, and a fit of the surface skips the triangles that have this vertex as a corner.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Weights {
    /// The weight of each vertex is 1.
    #[default]
    Uniform,
    /// The weight of each vertex is its share of the sphere's area, in steradians.
    Area,
    /// Given weights, one per vertex: finite, not negative and not all zero.
    Values {
        /// Name of the weights in the model's provenance, such as a file name.
        name: String,
        /// Weights of the n vertices.
        values: Vec<f64>,
    },
}

impl Weights {
    /// Reads weights from a file with one value for each vertex: GIfTI, FreeSurfer curv, CSV.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] if the file can't be read, [`Error::WeightCount`] if it has several columns.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, Error> {
        let (signal, name) = (read_signal(&path)?, path.as_ref().to_string_lossy().into_owned());
        if signal.channels != 1 {
            let (expected, found) = (signal.vertices, signal.vertices * signal.channels);
            return Err(Error::WeightCount { name, expected, found });
        }
        Ok(Self::Values { name, values: signal.values })
    }

    /// Returns the name of the weights in the provenance: `uniform`, `area`, or the name given with the values.
    pub fn name(&self) -> &str {
        match self {
            Self::Uniform => "uniform",
            Self::Area => "area",
            Self::Values { name, .. } => name,
        }
    }

    /// Returns these weights for the vertices of a sphere, with 0 at the vertices for which `keep` is false. `name` is
    /// the name of the result in the provenance.
    ///
    /// # Errors
    ///
    /// [`Error::WeightCount`] if the mask or the given weights don't have one element per vertex; [`Error::Weight`] if
    /// the mask excludes all vertices; [`Error::NeedsTriangles`] if the weights are areas and the sphere has no
    /// triangles.
    pub fn masked(&self, keep: &[bool], name: String, sphere: &Sphere) -> Result<Self, Error> {
        let expected = sphere.directions.len();
        let check = |name: &str, found: usize| match found == expected {
            true => Ok(()),
            false => Err(Error::WeightCount { name: name.to_owned(), expected, found }),
        };
        check(&name, keep.len())?;
        if !keep.contains(&true) {
            return Err(Error::Weight { name, vertex: 0, found: 0.0 });
        }
        let mut values = match self {
            Self::Uniform => vec![1.0; expected],
            Self::Area if sphere.faces.is_empty() => return Err(Error::area_without_triangles(sphere)),
            Self::Area => sphere.areas(),
            Self::Values { name, values } => {
                check(name, values.len())?;
                values.clone()
            }
        };
        values.iter_mut().zip(keep).filter(|(_, keep)| !**keep).for_each(|(weight, _)| *weight = 0.0);
        Ok(Self::Values { name, values })
    }

    /// Returns a hash of given weights, as 64 hexadecimal digits; `None` for other weights. A store identifies the
    /// weights of a factor by this hash.
    pub fn hash(&self) -> Option<String> {
        let Self::Values { values, .. } = self else { return None };
        Some(WeightsHash::of(Some(values)).0.iter().map(|byte| format!("{byte:02x}")).collect())
    }
}
