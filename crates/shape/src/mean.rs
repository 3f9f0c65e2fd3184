//! Truncates a group of models to one common degree, and computes their mean.

use std::fmt;

use ndarray::Array2;
use spharm_harmonics::Coefficients;

use crate::error::ShapeError;

/// Coefficients of a group, truncated to a common degree.
#[derive(Debug, Clone)]
pub struct CommonDegree {
    /// Canonical coefficients (K, c) of each member.
    pub members: Vec<Coefficients>,
    /// The common degree L.
    pub degree: usize,
    /// Warning that higher degrees were dropped because no degree was requested.
    pub warning: Option<DegreesDiffer>,
}

/// Warning that models have different degrees, and that only the degrees up to the lowest of these are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DegreesDiffer {
    /// Lowest degree of the models, to which all are truncated.
    pub lowest: usize,
    /// Highest degree of the models.
    pub highest: usize,
}

impl fmt::Display for DegreesDiffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { lowest, highest } = self;
        write!(f, "the models have degrees from {lowest} to {highest}; the degrees up to {lowest} are used")
    }
}

/// Truncates models to the degree `asked`, or to the lowest of their degrees if `asked` is `None`.
///
/// # Errors
///
/// [`ShapeError::TooFewMembers`] if the group is empty; [`ShapeError::DegreeAbove`] if a model's degree is below
/// `asked`.
pub fn to_common_degree(group: &[Coefficients], asked: Option<usize>) -> Result<CommonDegree, ShapeError> {
    let degrees = group.iter().map(Coefficients::max_degree);
    let (Some(lowest), Some(highest)) = (degrees.clone().min(), degrees.max()) else {
        return Err(ShapeError::TooFewMembers { found: 0, least: 1 });
    };
    if let Some(asked) = asked.filter(|asked| *asked > lowest) {
        return Err(ShapeError::DegreeAbove { lowest, highest, asked });
    }
    let degree = asked.unwrap_or(lowest);
    let members = group.iter().map(|member| Coefficients::new(member.up_to(degree).to_owned()));
    let members = members.collect::<Result<_, _>>()?;
    let warning = (asked.is_none() && highest > lowest).then_some(DegreesDiffer { lowest, highest });
    Ok(CommonDegree { members, degree, warning })
}

/// Returns the mean (K, c) of models, up to the degree of the first model.
///
/// # Errors
///
/// [`ShapeError::TooFewMembers`] if the group is empty; [`ShapeError::Differ`] if a model's number of channels differs
/// from the first model's, or its degree is lower.
pub fn mean(group: &[Coefficients]) -> Result<Coefficients, ShapeError> {
    let Some(first) = group.first() else { return Err(ShapeError::TooFewMembers { found: 0, least: 1 }) };
    let degree = first.max_degree();
    let mut mean = Array2::zeros(first.values().dim());
    for member in group {
        let (expected, found) = (first.channels(), member.channels());
        if found != expected {
            return Err(ShapeError::Differ { what: "channels", expected, found });
        }
        if member.max_degree() < degree {
            return Err(ShapeError::Differ { what: "degree", expected: degree, found: member.max_degree() });
        }
        mean += &member.up_to(degree);
    }
    mean /= group.len() as f64;
    Ok(Coefficients::new(mean)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(degree: usize, channels: usize, value: f64) -> Coefficients {
        Coefficients::new(Array2::from_elem(((degree + 1) * (degree + 1), channels), value)).unwrap()
    }

    #[test]
    fn a_group_goes_to_its_lowest_degree_and_says_so() {
        let group = [filled(3, 3, 1.0), filled(2, 3, 4.0)];
        let found = to_common_degree(&group, None).unwrap();
        assert_eq!((found.degree, found.warning), (2, Some(DegreesDiffer { lowest: 2, highest: 3 })));
        assert!(found.members.iter().all(|member| member.max_degree() == 2));
        assert!(mean(&found.members).unwrap().values().iter().all(|value| *value == 2.5));
        let asked = to_common_degree(&group, Some(1)).unwrap();
        assert_eq!((asked.degree, asked.warning), (1, None));
        let above = to_common_degree(&group, Some(3)).unwrap_err();
        assert!(matches!(above, ShapeError::DegreeAbove { lowest: 2, highest: 3, asked: 3 }));
    }

    #[test]
    fn groups_without_a_mean_are_refused() {
        assert!(to_common_degree(&[], None).is_err() && mean(&[]).is_err());
        let lower = mean(&[filled(3, 3, 1.0), filled(2, 3, 4.0)]).unwrap_err();
        assert!(matches!(lower, ShapeError::Differ { what: "degree", expected: 3, found: 2 }));
        let signal = mean(&[filled(3, 3, 1.0), filled(3, 1, 4.0)]).unwrap_err();
        assert!(matches!(signal, ShapeError::Differ { what: "channels", expected: 3, found: 1 }));
    }
}
