//! Measures how well the modes of a group represent other shapes of the same kind: generalisation and specificity.
//!
//! Both measures refer to the first k modes, for k = 1 to m, and are in the unit of length. *Generalisation* is the
//! mean distance of a member from its nearest shape in the model of all other members. *Specificity* is the mean
//! distance of a random shape of the model from the nearest member. Smaller values of both are better. Members and
//! random shapes are represented by their coordinates along the modes, which preserve distances. The cost therefore
//! doesn't depend on the degree: `n` decompositions of (n, n) matrices for the generalisation, and `samples n m` flops
//! for the specificity.

use ndarray::{Array2, Axis};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;
use spharm_linalg::{MatRef, ThinSvd};
use spharm_monitor::{Monitor, Stage};

use super::Modes;
use crate::ShapeError;

/// Generalisation and specificity of the first k modes, k = 1 to m.
#[derive(Debug, Clone, PartialEq)]
pub struct Quality {
    /// Mean distance of a member from the model of the other members, for k = 1 to m. Without that member the group has
    /// only n - 2 modes, so the value for n - 1 modes equals the value for n - 2.
    pub generalisation: Vec<f64>,
    /// Mean distance of a random shape from the nearest member, for k = 1 to m.
    pub specificity: Vec<f64>,
}

/// Maximum number of members that are compared with the model of the other members. In a larger group, only about every
/// `n / 200`th member is compared.
const LEFT_OUT: usize = 200;
const STAGE: Stage = Stage::counted("quality", "members");

/// Computes generalisation and specificity. `modes` must contain all n - 1 modes of the group. The specificity uses
/// `samples` random shapes, typically 2,000, determined by the seed.
///
/// # Errors
///
/// [`ShapeError::NoDecomposition`] if a singular value decomposition doesn't converge; [`ShapeError::Interrupted`] if
/// the monitor cancels.
pub fn quality(modes: &Modes, samples: usize, seed: u64, monitor: &dyn Monitor) -> Result<Quality, ShapeError> {
    let (n, m) = modes.scores.dim();
    let step = n.div_ceil(LEFT_OUT);
    monitor.begin(STAGE, n.div_ceil(step) as u64);
    let left: Vec<Vec<f64>> = (0..n)
        .into_par_iter()
        .step_by(step)
        .map(|member| {
            monitor.check()?;
            let left = left_by_others(&modes.scores, member)?;
            monitor.step(1);
            Ok::<_, ShapeError>(left)
        })
        .collect::<Result<_, _>>()?;
    monitor.end();
    let mean = |k: usize| left.iter().map(|left| left[k]).sum::<f64>() / left.len() as f64;
    let generalisation = (0..m).map(mean).collect();

    let tails =
        Array2::from_shape_fn((n, m), |(i, k)| modes.scores.row(i).iter().skip(k + 1).map(|s| s * s).sum::<f64>());
    let nearest: Vec<Vec<f64>> = (0..samples)
        .into_par_iter()
        .map(|sample| {
            let deviations = normal(seed, sample as u64, m);
            let mut least = vec![f64::INFINITY; m];
            for (scores, tails) in modes.scores.rows().into_iter().zip(tails.rows()) {
                let mut square = 0.0;
                for k in 0..m {
                    square += (deviations[k] * modes.variances[k].sqrt() - scores[k]).powi(2);
                    least[k] = least[k].min(square + tails[k]);
                }
            }
            least.into_iter().map(f64::sqrt).collect()
        })
        .collect();
    let specificity =
        (0..m).map(|k| nearest.iter().map(|least| least[k]).sum::<f64>() / samples.max(1) as f64).collect();
    Ok(Quality { generalisation, specificity })
}

/// Returns the distance of a member from its nearest shape in the model of the other members, for each number of modes.
fn left_by_others(scores: &Array2<f64>, member: usize) -> Result<Vec<f64>, ShapeError> {
    let (n, m) = scores.dim();
    let others: Vec<usize> = (0..n).filter(|i| *i != member).collect();
    let others = scores.select(Axis(0), &others);
    let mean = others.mean_axis(Axis(0)).ok_or(ShapeError::TooFewMembers { found: n, least: 3 })?;
    let centred = (&others - &mean).as_standard_layout().into_owned();
    let slice = centred.as_slice().ok_or(ShapeError::NoDecomposition)?;
    let decomposed =
        ThinSvd::new(MatRef::from_column_major_slice(slice, m, n - 1)).map_err(|_| ShapeError::NoDecomposition)?;
    let rest = &scores.row(member) - &mean;
    let mut square = rest.iter().map(|value| value * value).sum::<f64>();
    let (u, available) = (decomposed.u(), (n - 2).min(m));
    let left = (0..m).map(|k| {
        if k < available {
            let along: f64 = u.col(k).iter().zip(&rest).map(|(u, value)| u * value).sum();
            square -= along * along;
        }
        square.max(0.0).sqrt()
    });
    Ok(left.collect())
}

/// Returns `count` normally distributed numbers of mean 0 and variance 1, which depend only on the seed and the index
/// `sample`, by the method of G. E. P. Box and M. E. Muller (1958).
pub fn normal(seed: u64, sample: u64, count: usize) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(sample);
    // Uniform numbers are in (0, 1], so that the logarithm is finite.
    let mut uniform = || ((random.next_u64() >> 11) + 1) as f64 / (1u64 << 53) as f64;
    let mut values = Vec::with_capacity(count + 1);
    while values.len() < count {
        let (radius, angle) = ((-2.0 * uniform().ln()).sqrt(), std::f64::consts::TAU * uniform());
        values.extend([radius * angle.cos(), radius * angle.sin()]);
    }
    values.truncate(count);
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;

    fn group(n: usize) -> Vec<Array2<f64>> {
        (0..n)
            .map(|i| Array2::from_shape_fn((9, 3), |(k, c)| normal(3, i as u64, 27)[3 * k + c] / (1 + k) as f64))
            .collect()
    }

    #[test]
    fn they_are_what_they_are_defined_as() {
        let group = group(8);
        let views: Vec<_> = group.iter().map(|member| member.view()).collect();
        let modes = Modes::new(&views, 7).unwrap();
        let found = quality(&modes, 300, 5, &Silent).unwrap();
        for k in [1, 3, 6] {
            // The expected generalisation is the mean distance of each member from the model of the other members,
            // computed from the coefficients.
            let left: f64 = (0..8)
                .map(|i| {
                    let others: Vec<_> = (0..8).filter(|j| *j != i).map(|j| group[j].view()).collect();
                    Modes::new(&others, k).unwrap().project(group[i].view()).unwrap().1
                })
                .sum();
            assert!((found.generalisation[k - 1] - left / 8.0).abs() < 1e-12, "{k}");
            let nearest: f64 = (0..300)
                .map(|sample| {
                    let shape = modes.shape(&normal(5, sample, 7)[..k]).unwrap();
                    let distance = |other: &Array2<f64>| {
                        let off = &shape.slice(ndarray::s![1.., ..]) - &other.slice(ndarray::s![1.., ..]);
                        (off.iter().map(|value| value * value).sum::<f64>() / (4.0 * std::f64::consts::PI)).sqrt()
                    };
                    group.iter().map(distance).fold(f64::INFINITY, f64::min)
                })
                .sum();
            assert!((found.specificity[k - 1] - nearest / 300.0).abs() < 1e-12, "{k}");
        }
        assert_eq!(found.generalisation[6], found.generalisation[5]);
        assert!(found.generalisation.windows(2).all(|pair| pair[0] >= pair[1]));
    }

    #[test]
    fn normal_numbers_have_mean_and_variance() {
        let values: Vec<f64> = (0..100).flat_map(|sample| normal(1, sample, 1001)).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n;
        assert!(mean.abs() < 5.0 / n.sqrt() && (variance - 1.0).abs() < 5.0 * (2.0 / n).sqrt());
        assert_ne!(normal(1, 0, 3), normal(1, 1, 3));
    }
}
