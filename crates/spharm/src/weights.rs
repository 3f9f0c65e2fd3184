//! Weights of a fit's vertices.

use std::path::Path;

use spharm_store::WeightsHash;
use spharm_surface::Sphere;
use spharm_surface::io::read_signal;

use crate::Error;

/// Weight of each vertex in the least squares. A fit of the surface weighs a sample of a triangle by the harmonic mean
/// of its corners' weights. A vertex of weight 0 is left out, as by a mask: its value is never read and may be NaN, and
/// a fit of the surface leaves out its triangles.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Weights {
    /// One.
    #[default]
    Uniform,
    /// Its share of the sphere's area, in steradians.
    Area,
    /// Given values, (n), finite, not negative and not all zero.
    Values {
        /// Their name in the model's provenance: a file name.
        name: String,
        /// The weights, (n).
        values: Vec<f64>,
    },
}

impl Weights {
    /// Reads weights from a file with one value for each vertex: GIfTI, FreeSurfer curv, CSV.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] if it can't be read, [`Error::WeightCount`] if it has several columns.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, Error> {
        let (signal, name) = (read_signal(&path)?, path.as_ref().to_string_lossy().into_owned());
        if signal.channels != 1 {
            let (expected, found) = (signal.vertices, signal.vertices * signal.channels);
            return Err(Error::WeightCount { name, expected, found });
        }
        Ok(Self::Values { name, values: signal.values })
    }

    /// Returns their name in the provenance: `uniform`, `area`, or the name of the values.
    pub fn name(&self) -> &str {
        match self {
            Self::Uniform => "uniform",
            Self::Area => "area",
            Self::Values { name, .. } => name,
        }
    }

    /// Returns these weights over a sphere, with 0 at the vertices at which `keep`, (n), is false. `name` names the
    /// result in the provenance.
    ///
    /// # Errors
    ///
    /// [`Error::WeightCount`] if the mask, or given values, aren't one per vertex of the sphere; [`Error::Weight`] if
    /// the mask leaves no vertex.
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

    /// Returns a hash of the given values, 64 hexadecimal digits. A store identifies a factor's weights by it.
    pub fn hash(&self) -> Option<String> {
        let Self::Values { values, .. } = self else { return None };
        Some(WeightsHash::of(Some(values)).0.iter().map(|byte| format!("{byte:02x}")).collect())
    }
}
