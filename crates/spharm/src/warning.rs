//! Warnings about fits.

use std::fmt;

use serde::{Serialize, Serializer};
use spharm_solver::LsqReport;
use spharm_solver::irf::{BlockReport, PassReport};
use spharm_solver::lsq::LsqWarning;

/// A warning is given if the expected error of the most poorly determined combination of coefficients exceeds this
/// share of the norm of all coefficients.
const LARGEST_AMPLIFIED: f64 = 0.25;
/// Noise in the coefficients is attributed to the sampling only if the condition number exceeds this value.
const POOR: f64 = 3.0;
/// A warning is given for a denoised fit if the power of the noise in degree 1 exceeds this multiple of its power on an
/// even sampling.
const LARGEST_NOISE: f64 = 10.0;
/// The signal of degree 1 is clearly above the noise if denoising multiplies it by at least this gain.
const CLEAR_GAIN: f64 = 0.9;
/// A warning is given if the largest weight exceeds this multiple of the sum of all weights except the K - 1 largest,
/// with K the number of coefficients of a channel. At such a ratio the fit loses more than half of its digits.
const LARGEST_WEIGHT: f64 = 1e8;
/// A warning is given if the last pass removes more than this share of the residual's rms.
const STILL_FALLING: f64 = 0.1;
/// Residuals below this share of the rms of the values about their mean cause no warning.
const NEGLIGIBLE: f64 = 1e-4;
/// A warning is given if the rms of the unresolved detail exceeds this multiple of the noise. The multiple is well
/// below 1, because the detail is estimated at held-out vertices, which reveal only part of it.
const DETAIL: f64 = 0.3;

/// A possible problem with a fit. A warning is serialised as its message.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum FitWarning {
    /// The model is far from the surface between the vertices, because the vertices don't determine it there.
    Oscillation {
        /// Rms distance at centres of triangles, relative to the rms distance at the vertices.
        ratio: f64,
    },
    /// The normal equations are singular on this sampling, so a solution of small norm was used.
    Singular {
        /// Highest degree of the fit.
        max_degree: usize,
        /// Column and degree at which the factorisation of the Gram matrix broke down, if it did.
        breaks_at: Option<[usize; 2]>,
        /// The largest norm of a column of coefficients.
        norm: f64,
        /// Optimality reached.
        optimality: f64,
    },
    /// There are fewer vertices than coefficients, so the default smoothness penalty determined the solution.
    FewVertices {
        /// Number of vertices.
        vertices: usize,
        /// Number of coefficients of a channel.
        functions: usize,
        /// A degree that the vertices determine well.
        suitable_degree: usize,
    },
    /// The iteration ended before the tolerance was met.
    NotConverged {
        /// Optimality reached.
        optimality: f64,
        /// Requested optimality.
        tolerance: f64,
        /// Number of iterations and refinements.
        steps: usize,
    },
    /// The residual was still falling when iterative residual fitting ended.
    StillFalling {
        /// Number of passes.
        passes: usize,
        /// Share of the residual's rms that the last pass removed, or the last pair of passes if they are accelerated.
        share: f64,
    },
    /// The sampling doesn't determine a block of degrees, so the minimum-norm solution of this block was used.
    RankDeficient {
        /// First degree of the block.
        first_degree: usize,
        /// Last degree of the block.
        last_degree: usize,
        /// Numerical rank.
        rank: usize,
        /// Number of columns of the block.
        columns: usize,
    },
    /// A factor in the store doesn't match this fit or can't be read.
    FactorUnusable {
        /// Reason why the factor isn't used.
        reason: String,
    },
    /// The samples don't determine a fit of the degree: there are too few of them, or none in a part of the sphere.
    Gap {
        /// Highest degree of the fit.
        max_degree: usize,
        /// Number of samples with nonzero weight.
        samples: u64,
        /// Number of coefficients of a channel.
        functions: usize,
        /// Diameter of the largest cap without samples, in degrees.
        largest_gap: f64,
        /// Resolution at the highest degree, `pi / L`, in degrees.
        resolved: f64,
    },
    /// The sampling determines some combinations of coefficients so poorly that noise dominates them.
    Amplified {
        /// Highest degree of the fit.
        max_degree: usize,
        /// Condition number of the basis at the samples.
        condition: f64,
        /// Expected error of the most poorly determined combination of coefficients, relative to the norm of the
        /// coefficients.
        share: f64,
    },
    /// Detail beyond the degree of a denoised fit was treated as noise.
    Detail {
        /// Highest degree of the fit.
        max_degree: usize,
        /// Root mean square of the detail that was treated as noise, in the target's unit.
        left_out: f64,
        /// Standard deviation of the estimated noise, which includes the detail.
        sigma: f64,
    },
    /// Denoising may have removed signal, because poorly sampled places raise the noise of the coefficients of all
    /// degrees.
    NoiseOfGaps {
        /// Highest degree of the fit.
        max_degree: usize,
        /// Power of the noise in degree 1, divided by the power that the same noise would have if the sampling were
        /// even.
        noise: f64,
        /// Gain by which denoising multiplied the coefficients of degree 1.
        gain: f64,
    },
    /// A few vertices have nearly all of the weight, so rounding errors hide the values of the other vertices.
    UnevenWeights {
        /// Number of coefficients of a channel.
        functions: usize,
        /// Largest weight, relative to the sum of all weights except the `functions - 1` largest.
        ratio: f64,
    },
    /// Rounding errors of moments hide the residual of channels whose mean is large.
    LostResidual {
        /// Names of the channels.
        channels: Vec<String>,
    },
    /// The fitted moments lack some shards of the samples.
    MissingShards {
        /// Descriptions of the missing shards.
        missing: Vec<String>,
    },
    /// Standard errors were computed for a fit weighted by areas.
    AreaErrors,
    /// A channel of a signal has zeros that may mark missing values, since all its other values are far from 0.
    Zeros {
        /// Index of the channel.
        channel: usize,
        /// Number of zeros.
        zeros: usize,
        /// Number of vertices that are read.
        vertices: usize,
    },
    /// A warning of the solver.
    Solver(LsqWarning),
}

impl fmt::Display for FitWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Oscillation { ratio } => write!(
                f,
                "the error of the model between the vertices is {ratio:.0} times the error at the vertices: the \
                 vertices don't determine the model between them"
            ),
            Self::Singular { max_degree, breaks_at, norm, optimality } => {
                write!(f, "degree {max_degree} isn't determined by this sampling")?;
                if let Some([column, degree]) = breaks_at {
                    write!(
                        f,
                        "; the factorisation of the Gram matrix breaks down at column {column} (degree {degree})"
                    )?;
                }
                write!(f, "; a solution of small norm was used (norm {norm:.3e}, optimality {optimality:.1e})")
            }
            Self::FewVertices { vertices, functions, suitable_degree } => write!(
                f,
                "{vertices} vertices don't determine {functions} coefficients, so the smoothness penalty determines \
                 the rest; use degrees up to {suitable_degree} for this mesh"
            ),
            Self::NotConverged { optimality, tolerance, steps } => write!(
                f,
                "the solver did not converge: optimality {optimality:.1e} after {steps} steps, expected \
                 {tolerance:.1e}; the best solution so far was used"
            ),
            Self::StillFalling { passes, share } => write!(
                f,
                "the residual is still falling after {passes} passes: the last step (one pass, or two if accelerated) \
                 reduced its rms by {:.0} %; give more passes (--passes, --accelerate), or use the method lsq",
                100.0 * share
            ),
            Self::RankDeficient { first_degree, last_degree, rank, columns } => write!(
                f,
                "the sampling doesn't determine all coefficients of degrees {first_degree} to {last_degree} (rank {rank} \
                 of {columns} columns); the solution of minimum norm was used"
            ),
            Self::FactorUnusable { reason } => write!(f, "{reason}; solving without this factor"),
            Self::Gap { max_degree, samples, functions, largest_gap, resolved }
                if largest_gap <= resolved && *samples >= *functions as u64 =>
            {
                write!(
                    f,
                    "degree {max_degree} isn't determined by the samples: the positions of the {samples} samples don't \
                     suffice for {functions} coefficients, or a few positions have nearly all of the weight; use a \
                     lower degree, samples at more positions, or more even weights"
                )
            }
            Self::Gap { max_degree, samples, functions, largest_gap, resolved } => write!(
                f,
                "degree {max_degree} isn't determined by the samples: {samples} samples for {functions} coefficients, \
                 and the largest gap between samples is {largest_gap:.1} degrees wide, but this degree resolves angles \
                 of {resolved:.1} degrees"
            ),
            Self::Amplified { max_degree, condition, share } => write!(
                f,
                "degree {max_degree} is poorly determined by this sampling (condition number {condition:.1e}): noise \
                 and detail beyond the degree change the coefficients by about {:.0} % of their norm; use a smoothness \
                 penalty or a lower degree",
                100.0 * share.min(1.0)
            ),
            Self::Detail { max_degree, left_out, sigma } => write!(
                f,
                "the data have detail of {left_out:.2e} rms beyond degree {max_degree}, and the removed noise of \
                 {sigma:.2e} includes this detail: the model may be worse than without denoising; a higher degree \
                 would separate detail from noise"
            ),
            Self::NoiseOfGaps { max_degree, noise, gain } => write!(
                f,
                "denoising may have removed signal: at degree {max_degree}, poorly sampled places raise the power of \
                 the noise in the coefficients of degree 1 to {noise:.1e} times that of an even sampling, and denoising \
                 multiplied these coefficients by a gain of only {gain:.2}; use a lower degree, or a smoothness penalty \
                 instead of denoising"
            ),
            Self::UnevenWeights { functions, ratio } => write!(
                f,
                "the weights are too uneven: the largest weight is {ratio:.1e} times the sum of all weights except the \
                 {} largest; {functions} coefficients also need the values of small weight, but rounding errors hide \
                 these values; use more even weights, with a ratio below {LARGEST_WEIGHT:.0e}",
                functions - 1
            ),
            Self::LostResidual { channels } => write!(
                f,
                "the rms residual and explained share of {} {} are unknown, because the mean of the values is so large \
                 that rounding errors of the moments hide the residual; subtract a constant, such as the mean, from \
                 the values and compute the moments again",
                if channels.len() == 1 { "channel" } else { "channels" },
                channels.join(", ")
            ),
            Self::MissingShards { missing } => write!(
                f,
                "the moments cover only a part of the samples (missing: {}); merge the moments of all shards",
                missing.join(", ")
            ),
            Self::AreaErrors => f.write_str(
                "standard errors assume that weights are inverse variances, but the weights are areas: for equally \
                 accurate vertices on an uneven sphere the standard errors are too small; use uniform weights for \
                 standard errors",
            ),
            Self::Zeros { channel, zeros, vertices } => write!(
                f,
                "{zeros} of {vertices} values of channel {} are exactly 0 and all others are far from 0: if these zeros \
                 stand for missing values, as on the medial wall, leave their vertices out with a mask (--mask)",
                channel + 1
            ),
            Self::Solver(warning) => warning.fmt(f),
        }
    }
}

impl Serialize for FitWarning {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl FitWarning {
    /// Returns the warnings that follow from a solver's report. `by_default` is the number of vertices with nonzero
    /// weight if the smoothness is the default of a parametrised sphere, else `None`.
    pub(crate) fn of_lsq(report: &LsqReport, tolerance: f64, by_default: Option<usize>) -> Vec<Self> {
        let mut warnings = Vec::new();
        let singular = report.shift > 0.0;
        if singular {
            let &LsqReport { max_degree, breaks_at, norm, optimality, .. } = report;
            warnings.push(Self::Singular { max_degree, breaks_at, norm, optimality });
        }
        let functions = spharm_harmonics::basis_size(report.max_degree);
        if let Some(vertices) = by_default.filter(|vertices| *vertices < functions) {
            let suitable_degree = ((vertices as f64 / 1.5).sqrt() as usize).saturating_sub(1);
            warnings.push(Self::FewVertices { vertices, functions, suitable_degree });
        }
        warnings.extend(report.warnings.iter().cloned().map(Self::Solver));
        let mean_square = report.residuals.iter().map(|residual| residual.mean_square).reduce(f64::max);
        let amplified = mean_square.and_then(|mean_square| Self::of_amplified(report, mean_square));
        warnings.extend(amplified.filter(|_| !singular));
        if report.stop != spharm_solver::lsq::Stop::Converged && !singular {
            let steps = report.iterations + report.refinements;
            warnings.push(Self::NotConverged { optimality: report.optimality, tolerance, steps });
        }
        warnings
    }

    /// Returns a warning if a large part of the coefficients may be amplified noise. Let n samples have independent
    /// noise of standard deviation s. The combination of coefficients that the samples determine worst then has the
    /// standard deviation `s condition sqrt(4 pi / n)`, up to a factor that depends on how evenly the samples are
    /// distributed. `mean_square` is the mean square of the residual, weighted if the weights are inverse variances.
    pub(crate) fn of_amplified(report: &LsqReport, mean_square: f64) -> Option<Self> {
        let functions = spharm_harmonics::basis_size(report.max_degree);
        let free = report.rows.checked_sub(functions).filter(|&free| free > 0 && report.smoothness == 0.0)?;
        let deviation = (mean_square * report.rows as f64 / free as f64).sqrt();
        let amplified = deviation * report.condition * (4.0 * std::f64::consts::PI / report.rows as f64).sqrt();
        let (max_degree, condition, share) = (report.max_degree, report.condition, amplified / report.norm);
        let poor = condition > POOR && condition.is_finite();
        (poor && share > LARGEST_AMPLIFIED).then_some(Self::Amplified { max_degree, condition, share })
    }

    /// Returns a warning if the noise of poorly sampled places hides the signal, or if a large part of the removed
    /// noise is detail. `sigma` is the noise in the unit of the detail.
    pub(crate) fn of_denoised(
        (noise, gain): (f64, &[f64]),
        left_out: Option<f64>,
        sigma: f64,
        max_degree: usize,
    ) -> Option<Self> {
        let hidden = Self::of_noise(noise, gain, max_degree);
        let left_out = left_out.unwrap_or(0.0);
        let detail = || (left_out > DETAIL * sigma).then_some(Self::Detail { max_degree, left_out, sigma });
        hidden.or_else(detail)
    }

    /// Returns a warning if the noise of poorly sampled places hides the signal. The signal is hidden if `noise`, the
    /// power of the noise in degree 1 relative to an even sampling, is large and the signal of degree 1 isn't clearly
    /// above the noise.
    pub(crate) fn of_noise(noise: f64, gain: &[f64], max_degree: usize) -> Option<Self> {
        let gain = *gain.get(1)?;
        (noise > LARGEST_NOISE && gain < CLEAR_GAIN).then_some(Self::NoiseOfGaps { max_degree, noise, gain })
    }

    /// Returns a warning if the weights are so uneven that a fit of the vertices loses the values at vertices of small
    /// weight. Some function of the model's degree is zero at the K - 1 vertices of largest weight, with K the number
    /// of coefficients. The normal matrix's condition number is therefore at least the ratio of the largest weight to
    /// the sum of the other weights. Iterations that begin at zero don't reveal such functions.
    pub(crate) fn of_weights(weights: &[f64], max_degree: usize) -> Option<Self> {
        let functions = spharm_harmonics::basis_size(max_degree);
        if functions > weights.len() {
            return None;
        }
        let mut weights = weights.to_vec();
        let (larger, nth, smaller) = weights.select_nth_unstable_by(functions - 1, |a, b| b.total_cmp(a));
        let ratio = larger.iter().copied().fold(*nth, f64::max) / (*nth + smaller.iter().sum::<f64>());
        (ratio.is_finite() && ratio > LARGEST_WEIGHT).then_some(Self::UnevenWeights { functions, ratio })
    }

    /// Returns a warning if the last pass of a fit still reduced the residual of a target. `spread` is the rms of the
    /// target's values about their mean.
    pub(crate) fn of_passes(history: &[PassReport], target: usize, spread: f64) -> Option<Self> {
        let [.., before, last] = history else { return None };
        let rms = |pass: &PassReport| pass.residuals.get(target).map(|residual| residual.mean_square.sqrt());
        let (before, after) = (rms(before)?, rms(last)?);
        let share = 1.0 - after / before;
        let falls = share > STILL_FALLING && before > NEGLIGIBLE * spread && !last.refinement;
        falls.then_some(Self::StillFalling { passes: last.pass, share })
    }

    /// Returns a warning for each block that the sampling doesn't determine.
    pub(crate) fn of_blocks(blocks: &[BlockReport]) -> Vec<Self> {
        let deficient = blocks.iter().filter(|block| block.rank < block.columns);
        let warning = |block: &BlockReport| {
            let &BlockReport { first_degree, last_degree, rank, columns, .. } = block;
            Self::RankDeficient { first_degree, last_degree, rank, columns }
        };
        deficient.map(warning).collect()
    }
}
