//! Adds signals on the surfaces, such as thickness, to the positions and normals that the refinement matches.
//!
//! The value of a signal at a corresponding point is interpolated at the nearest point of the member's surface. The
//! interpolated values are scaled, and fitted over the group's sphere. After scaling, a signal's standard deviation
//! over the area of all members is its weight times the square root of the members' mean area. Differences in a signal
//! are then comparable with distances.

use std::fmt;
use std::sync::Arc;

use ndarray::{Array2, Axis, concatenate};
use rayon::prelude::*;
use spharm_harmonics::Coefficients;
use spharm_monitor::Monitor;
use spharm_surface::geometry::Vec3;
use spharm_surface::nearest::TriangleTree;
use spharm_surface::topology::area;
use spharm_surface::{Mesh, Signal, Similarity, Sphere, Target};

use super::subjects::Subjects;
use super::together::{mesh_of, weights};
use crate::{Error, Fit, FitParams, fit_many};

/// A function that reads the signals of the surface with the given index: for each signal, one value per vertex.
type Read = dyn Fn(usize) -> Result<Vec<Vec<f64>>, Error> + Send + Sync;

/// Signals that determine the correspondence together with positions.
#[derive(Clone)]
pub struct Signals {
    /// Weight of each signal: its standard deviation after scaling, divided by the square root of the members' mean
    /// area. Normals have weight 0.12.
    pub weights: Vec<f64>,
    /// The function that reads the signals of a surface.
    pub read: Arc<Read>,
}

impl fmt::Debug for Signals {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Signals").field("weights", &self.weights).finish_non_exhaustive()
    }
}

impl Signals {
    pub(super) fn check(&self) -> Result<(), Error> {
        let refused = |what, expected, found: String| Err(Error::Setting { what, expected, found });
        match self.weights.iter().find(|weight| !(**weight > 0.0 && weight.is_finite())) {
            Some(weight) => refused("each signal", "a weight above 0", weight.to_string()),
            None if self.weights.is_empty() => refused("the list of signals", "at least 1 signal", "none".to_owned()),
            None => Ok(()),
        }
    }

    /// Returns the coefficients of each member's signals, one column per signal, scaled to units of length. Masked
    /// directions don't contribute to the standard deviations.
    pub(super) fn fitted(
        &self,
        subjects: &Subjects<'_>,
        similarities: &[Similarity],
        (sphere, places, masked): (&Sphere, &[Vec<Vec3>], &[bool]),
        settings: &FitParams,
        monitor: &dyn Monitor,
    ) -> Result<Vec<Coefficients>, Error> {
        let at_places = |index: usize, mesh: Mesh| {
            monitor.check()?;
            let values = (self.read)(index)?;
            self.check_values(&values, mesh.vertices.len())?;
            // Values are interpolated on the moved triangles. A reflection reorders the corners of triangles, and the
            // barycentric coordinates refer to the new order.
            let moved = similarities[index].apply_mesh(&mesh);
            let tree = TriangleTree::new(&moved);
            let of = |place: &Vec3| -> Vec<f64> {
                let found = tree.nearest(*place);
                let value = |values: &Vec<f64>| {
                    let corners = found.map(|found| (moved.faces[found.triangle as usize], found.barycentric));
                    corners.map_or(0.0, |(corners, shares)| {
                        corners.iter().zip(shares).map(|(v, share)| share * values[*v as usize]).sum()
                    })
                };
                values.iter().map(value).collect()
            };
            Ok(places[index].iter().map(of).collect::<Vec<_>>().concat())
        };
        let mut values: Vec<Vec<f64>> = subjects.each(at_places)?;
        self.scale(&mut values, (sphere, places, masked))?;
        let channels = self.weights.len();
        let vertices = sphere.directions.len();
        let read = |index: usize| {
            let signal = Signal { values: values[index].clone(), vertices, channels };
            Ok::<_, Error>(Target::from_signal(signal, sphere)?)
        };
        let done = |_: usize, fit: Fit| Ok(fit.coefficients);
        let (fits, _) = fit_many(sphere, values.len(), &read, settings, &done, monitor)?;
        Ok(fits)
    }

    fn check_values(&self, values: &[Vec<f64>], vertices: usize) -> Result<(), Error> {
        let refused = |what, expected, found: String| Err(Error::Setting { what, expected, found });
        if values.len() != self.weights.len() {
            let found = format!("{} signals instead of {}", values.len(), self.weights.len());
            return refused("the list of signals", "the same number of signals for each surface", found);
        }
        if let Some(values) = values.iter().find(|values| values.len() != vertices) {
            let found = format!("{} values for {vertices} vertices", values.len());
            return refused("each signal", "one value per vertex", found);
        }
        match values.iter().flatten().find(|value| !value.is_finite()) {
            Some(value) => refused("each signal", "finite values", value.to_string()),
            None => Ok(()),
        }
    }

    /// Subtracts from each signal its mean over all members, and scales it to the standard deviation given by its
    /// weight. `values` contains an array for each member, with one row per direction and one column per signal.
    fn scale(
        &self,
        values: &mut [Vec<f64>],
        (sphere, places, masked): (&Sphere, &[Vec<Vec3>], &[bool]),
    ) -> Result<(), Error> {
        let shares = weights(places, &sphere.faces, masked);
        let areas = places.par_iter().map(|places| area(&mesh_of(places.clone(), &sphere.faces)));
        let length = (areas.collect::<Vec<_>>().iter().sum::<f64>() / places.len() as f64).sqrt();
        let (channels, members) = (self.weights.len(), values.len() as f64);
        for (channel, weight) in self.weights.iter().enumerate() {
            let sum = |of: &dyn Fn(f64) -> f64| {
                let own = |values: &Vec<f64>| {
                    let terms = values.chunks_exact(channels).zip(&shares).map(|(row, share)| share * of(row[channel]));
                    terms.sum::<f64>()
                };
                values.iter().map(own).sum::<f64>() / members
            };
            let mean = sum(&|value| value);
            let deviation = sum(&|value| (value - mean).powi(2)).sqrt();
            if deviation <= 1e-12 * mean.abs() {
                let (expected, found) = ("values that differ from vertex to vertex", format!("{mean} everywhere"));
                return Err(Error::Setting { what: "each signal", expected, found });
            }
            for row in values.iter_mut().flat_map(|values| values.chunks_exact_mut(channels)) {
                row[channel] = (row[channel] - mean) * weight * length / deviation;
            }
        }
        Ok(())
    }
}

/// Appends the coefficients of signals to those of positions. Returns an array with one row per basis function: three
/// columns for positions, then one column per signal.
pub(super) fn beside(positions: &Coefficients, signals: &Coefficients) -> Result<Array2<f64>, Error> {
    let joined = concatenate(Axis(1), &[positions.values().view(), signals.values().view()]);
    joined.map_err(|_| Error::Setting {
        what: "each signal",
        expected: "as many coefficients as the positions have",
        found: signals.values().nrows().to_string(),
    })
}
