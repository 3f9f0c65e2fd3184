//! Chooses the degree of a model: the lowest degree with which the model is accurate enough.
//!
//! The error of a model is the root mean square distance between the model and the surface. The error falls roughly as
//! a power of the degree. A few fits therefore suffice to find the degree. The degree is first doubled until the error
//! is small enough. The wanted degree then lies between the last two degrees, and is found by alternating between
//! bisection and predictions with a power law. Bisection is needed for surfaces that are themselves models, whose
//! errors fall abruptly at the model's degree.

use std::f64::consts::PI;
use std::fmt;
use std::str::FromStr;

use spharm_monitor::{Monitor, number};
use spharm_surface::metrics::bounding_box_scale;
use spharm_surface::{Mesh, Sphere, Target};

use crate::parametrize::Input;
use crate::{Error, Fit, FitParams, MappedSurface, fit_target};

/// Largest error that a model may have: the root mean square distance between model and surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Accuracy {
    /// A length in the unit of the surface.
    Length(f64),
    /// A fraction of the surface's size, which is the cube root of the volume of its bounding box.
    Share(f64),
}

impl Default for Accuracy {
    /// Returns 0.2 % of the surface's size.
    fn default() -> Self {
        Self::Share(0.002)
    }
}

impl FromStr for Accuracy {
    type Err = String;

    /// Parses a length such as `0.3`, or a percentage of the surface's size such as `0.2%`.
    fn from_str(text: &str) -> Result<Self, String> {
        let percent = text.strip_suffix('%').map(str::trim_end);
        let value = percent.unwrap_or(text).parse().ok().filter(|value: &f64| *value > 0.0 && value.is_finite());
        match (value, percent) {
            (Some(value), Some(_)) => Ok(Self::Share(value / 100.0)),
            (Some(value), None) => Ok(Self::Length(value)),
            (None, _) => Err("expected a length above 0, or a percentage of the surface size, such as 0.2%".to_owned()),
        }
    }
}

impl fmt::Display for Accuracy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(length) => write!(f, "{length}"),
            Self::Share(share) => write!(f, "{} % of the size", (1e8 * share).round() / 1e6),
        }
    }
}

impl Accuracy {
    fn length(self, vertices: &[[f64; 3]]) -> Result<f64, Error> {
        match self {
            Self::Length(length) => Ok(length),
            Self::Share(share) => Ok(share * bounding_box_scale(vertices)?),
        }
    }
}

/// A degree that was chosen for a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct DegreeChoice {
    /// The lowest degree that is accurate enough. If no degree is accurate enough, this is the degree whose resolution
    /// is one and a half edge lengths of the mesh.
    pub degree: usize,
    /// Root mean square distance between the surface and its model of this degree.
    pub rms: f64,
    /// The wanted accuracy, as a length.
    pub wanted: f64,
    /// The highest degree that could be tried.
    pub most: usize,
}

impl DegreeChoice {
    /// Returns whether the model is as accurate as requested.
    #[must_use]
    pub fn reached(&self) -> bool {
        self.rms <= self.wanted
    }
}

impl fmt::Display for DegreeChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { degree, most, .. } = self;
        let (rms, wanted) = (number(self.rms), number(self.wanted));
        match self.reached() {
            true => {
                write!(f, "degree {degree} is the lowest with an rms error of at most {wanted}; its error is {rms}")
            }
            false => write!(
                f,
                "no degree up to {most} has an rms error of at most {wanted}; degree {degree}, with an error of {rms}, \
                 is used, because higher degrees would follow the facets of the mesh"
            ),
        }
    }
}

/// The highest degree tried. Higher degrees must be chosen explicitly.
const MOST: usize = 256;

/// The first degree tried.
const FIRST: usize = 16;

/// Resolution, in edge lengths of the mesh, of the degree that is chosen if no degree is accurate enough. A finer model
/// would follow the mesh's facets.
const EDGES: f64 = 1.5;

/// Returns the lowest degree with which the model of a surface is as accurate as requested. The surface is mapped to a
/// sphere for each fit. The degree is at most 256, and a model has at most as many functions as the surface has
/// vertices. If no degree is accurate enough, returns the degree whose resolution is one and a half edge lengths of the
/// surface, or the highest possible degree if that is lower.
///
/// Each degree is tried by a fit with the settings `params`, except for their degree. Five to eight fits are usual.
///
/// # Errors
///
/// The errors of [`fit_mesh`](crate::fit_mesh()); [`Error::Setting`] if `params` request a fit of the vertices.
pub fn choose_degree(
    surface: &Input,
    accuracy: Accuracy,
    params: &FitParams,
    monitor: &dyn Monitor,
) -> Result<DegreeChoice, Error> {
    let of_label = surface.label().map(|label| &label.quads.vertices);
    let vertices = surface.mesh().map(|mesh| &mesh.vertices).or(of_label).ok_or(Error::NoArea)?;
    choose(vertices, accuracy, params, monitor, |params| {
        Ok(MappedSurface::new(surface, params, monitor)?.fit(params, monitor)?.0)
    })
}

/// Returns the lowest degree with which the model of a surface over a given sphere is as accurate as requested, like
/// [`choose_degree`].
///
/// # Errors
///
/// The errors of [`fit()`](crate::fit()); [`Error::Setting`] if `params` request a fit of the vertices.
pub fn choose_degree_over(
    sphere: &Sphere,
    surface: &Mesh,
    accuracy: Accuracy,
    params: &FitParams,
    monitor: &dyn Monitor,
) -> Result<DegreeChoice, Error> {
    let target = || Target::from_mesh(surface, sphere);
    choose(&surface.vertices, accuracy, params, monitor, |params| Ok(fit_target(sphere, target()?, params, monitor)?.0))
}

fn choose(
    vertices: &[[f64; 3]],
    accuracy: Accuracy,
    params: &FitParams,
    monitor: &dyn Monitor,
    fit: impl Fn(&FitParams) -> Result<Fit, Error>,
) -> Result<DegreeChoice, Error> {
    let wanted = accuracy.length(vertices)?;
    let most = vertices.len().isqrt().saturating_sub(1).clamp(1, MOST);
    let params = params.clone().with_surface_distance(true).with_standard_errors(false).with_hold_out(None);
    let error = |degree| {
        monitor.check()?;
        let fit = fit(&params.clone().with_max_degree(degree))?;
        fit.report.surface_distance.map(|distances| distances.rms_raw).ok_or_else(|| Error::Setting {
            what: "choosing the degree by accuracy",
            expected: "a fit of the surface",
            found: "a fit of the vertices".to_owned(),
        })
    };
    let (mut degree, mut rms) = search(wanted, most, error)?;
    if rms > wanted {
        // Choose the degree L at which the model resolves `EDGES` edge lengths. On a ball of radius r with n vertices,
        // edges have a length of about `(4 pi r^2 / n)^(1/2)`, and the model resolves `pi r / L`.
        degree = (((PI * vertices.len() as f64).sqrt() / (2.0 * EDGES)) as usize).clamp(1, most);
        rms = error(degree)?;
    }
    Ok(DegreeChoice { degree, rms, wanted, most })
}

/// Returns the lowest degree from 1 to `most` whose error is at most `wanted`, and its error. Returns `most` if no
/// degree suffices. Assumes that errors fall as the degree grows.
fn search<E>(wanted: f64, most: usize, mut error: impl FnMut(usize) -> Result<f64, E>) -> Result<(usize, f64), E> {
    // `fails` is the highest degree known to fail, if any, and `suffices` the lowest degree known to suffice.
    let mut fails: Option<(usize, f64)> = None;
    let mut degree = FIRST.min(most);
    let mut suffices = loop {
        let found = error(degree)?;
        if found <= wanted || degree == most {
            break (degree, found);
        }
        fails = Some((degree, found));
        degree = (2 * degree).min(most);
    };
    if suffices.1 > wanted {
        return Ok(suffices);
    }
    let mut predicted = false;
    loop {
        let below = fails.map_or(0, |(degree, _)| degree);
        if suffices.0 - below <= 1 {
            return Ok(suffices);
        }
        predicted = !predicted;
        let degree = match fails {
            Some(fails) if predicted => expected(wanted, fails, suffices),
            _ => (below + suffices.0) / 2,
        };
        let found = error(degree)?;
        if found <= wanted {
            suffices = (degree, found);
        } else {
            fails = Some((degree, found));
        }
    }
}

/// Returns the degree at which the power law through the errors of two degrees gives the wanted error. The result is
/// strictly between the two degrees.
fn expected(wanted: f64, fails: (usize, f64), suffices: (usize, f64)) -> usize {
    let (low, high) = (fails.0 as f64, suffices.0 as f64);
    let share = (fails.1 / wanted).ln() / (fails.1 / suffices.1).ln();
    let degree = low * (high / low).powf(if share.is_finite() { share } else { 0.5 });
    (degree.round() as usize).clamp(fails.0 + 1, suffices.0 - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(wanted: f64, most: usize, error: impl Fn(usize) -> f64) -> (usize, usize) {
        let mut tried = 0;
        let (degree, _) = search(wanted, most, |degree| {
            tried += 1;
            Ok::<_, ()>(error(degree))
        })
        .unwrap();
        (degree, tried)
    }

    #[test]
    fn the_least_degree_is_found_in_few_fits() {
        for slope in [0.7, 1.5, 3.0] {
            for least in [1, 2, 5, 16, 17, 31, 60, 100, 200] {
                let error = |degree: usize| (degree as f64).powf(-slope);
                let (degree, tried) = found(error(least) * 1.000_001, 256, error);
                assert_eq!(degree, least, "slope {slope}");
                assert!(tried <= 9, "{least}: {tried} fits");
            }
        }
        // The errors of surfaces that are themselves models fall abruptly at the degree `least`.
        for least in [43, 60, 129, 250, 256] {
            for rest in [0.0, 1e-6] {
                let (degree, tried) = found(0.5, 256, |degree| if degree < least { 1.0 } else { rest });
                assert!(degree == least && tried <= 20, "{least}: {degree} after {tried} fits");
            }
        }
    }

    #[test]
    fn the_highest_degree_is_taken_if_none_suffices() {
        assert_eq!(found(1e-3, 20, |degree| 1.0 / degree as f64).0, 20);
        assert_eq!(found(1e-3, 5, |_| 1.0), (5, 1));
        assert_eq!(found(2.0, 5, |_| 1.0).0, 1);
    }

    #[test]
    fn accuracies_are_lengths_or_percentages() {
        assert_eq!("0.3".parse(), Ok(Accuracy::Length(0.3)));
        assert_eq!("0.5%".parse(), Ok(Accuracy::Share(0.005)));
        assert_eq!(Accuracy::Share(0.002).to_string(), "0.2 % of the size");
        for wrong in ["", "0", "-1", "%", "nan", "inf", "1 mm"] {
            assert!(wrong.parse::<Accuracy>().is_err(), "{wrong}");
        }
    }
}
