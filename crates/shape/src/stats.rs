//! Tests groups and covariates at every vertex, with control of the family-wise error rate and of the false-discovery
//! rate.
//!
//! A study has n subjects and a measurement of d components at each of V vertices of a common sampling. Examples are a
//! displacement along the mean's normal (d = 1), a displacement in space (d = 3), and a thickness (d = 1). At each
//! vertex the linear model
//!
//! ```text
//! Y = X B + E,   X (n, p), B (p, d),   H0: c^T B = 0
//! ```
//!
//! is tested. The statistic is t for d = 1, Hotelling's `T^2` for d > 1, and F for several contrasts at once. To
//! compare two groups by the pooled t test, use a design with one column for each group and the contrast (1, -1). Rows
//! must be independent subjects, unless [`Blocks`] define which rows depend on each other.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`design`] | [`Design`], [`Contrast`]: the model and the hypothesis |
//! | [`study`], [`terms`] | designs from tables of subjects |
//! | `contrasts` | parsing of contrasts |
//! | `nested` | removal of main effects that a covariate already contains |
//! | [`linear`] | statistics, p values, effects and their confidence intervals at each vertex |
//! | [`welch`] | two groups of unequal variance |
//! | `variances` | warning about unequal variances |
//! | `aspin_welch` | groups of observations with unequal variances, in any design |
//! | [`blocks`] | observations that depend on each other |
//! | `own_effects` | effects that differ between blocks |
//! | [`spatial`] | TFCE and clusters |
//! | [`permutation`] | family-wise p values, from the largest statistics of relabelled studies |
//! | `resampling` | the choice between permutations of subjects and sign flips |
//! | [`arrangements`] | relabellings, exhaustive or random |
//! | `explained`, `welch_flips` | statistics of relabelled studies |
//! | [`fdr`] | false-discovery rate |
//! | [`distributions`] | tail probabilities of t and F |
//!
//! # Example
//!
//! ```
//! use ndarray::Array2;
//! use spharm_monitor::Silent;
//! use spharm_shape::stats::{Contrast, Design, PermutationParams, TestParams, test};
//!
//! // Two groups of five subjects, measured at two vertices. The groups differ at the second vertex.
//! let values = Array2::from_shape_fn((10, 2), |(i, v)| (i as f64 * 1.7).sin() + if v == 1 && i < 5 { 9.0 } else { 0.0 });
//! let design = Design::groups(&[5, 5])?;
//! let found = test(values.view(), 1, &design, &Contrast::difference(2, 0, 1), &TestParams::default(), &Silent)?;
//! let family_wise = found.family_wise.as_ref().unwrap();
//! assert_eq!(family_wise.relabellings, 252);
//! assert!(family_wise.p[0] > 0.3 && (family_wise.p[1] - 2.0 / 252.0).abs() < 1e-12);
//! # Ok::<(), spharm_shape::ShapeError>(())
//! ```

pub mod arrangements;
mod aspin_welch;
pub mod blocks;
mod contrasts;
pub mod design;
pub mod distributions;
mod explained;
pub mod fdr;
pub mod linear;
mod nested;
mod own_effects;
pub mod permutation;
mod projection;
mod resampling;
pub mod spatial;
pub mod study;
pub mod terms;
#[cfg(test)]
mod tests;
mod variances;
pub mod welch;
mod welch_flips;

use ndarray::ArrayView2;
use spharm_monitor::Monitor;

use crate::ShapeError;

pub use blocks::{Blocks, Exchange, numbered};
pub use design::{Contrast, Design};
pub use linear::{Effect, Statistic};
pub use permutation::{FamilyWise, MAX_RELABELLINGS, PermutationParams};
pub use resampling::Resampling;
pub use spatial::{Cluster, Clusters, SpatialParams, SurfaceGraph, Tfce};
pub use study::{Question, mean_question, question};
pub use terms::{Column, Term};

/// Settings of a test.
#[derive(Debug, Clone)]
pub struct TestParams {
    /// Relabellings for family-wise p values; `None` omits these p values. Default: 10,000 relabellings with seed 0.
    pub permutations: Option<PermutationParams>,
    /// Whether two groups are tested by Welch's t or Welch's `T^2` instead of the pooled statistic. Default: no.
    pub welch: bool,
    /// Variance group of each subject (n), numbered from 0. With variance groups, the statistic is Aspin and Welch's v,
    /// or its generalisation G if the contrast has several rows. Default: one group, with the pooled statistic.
    pub variance_groups: Option<Vec<usize>>,
    /// Kind of relabelling, which implies an assumption about the errors. By default subjects are permuted, with two
    /// exceptions. Signs are flipped for tests of means, because permutations don't change a mean, and for tests with
    /// unequal variances.
    pub errors: Option<Resampling>,
    /// Exchangeability blocks, which restrict relabellings. Default: all subjects are exchangeable.
    pub blocks: Option<Blocks>,
    /// Settings of TFCE and clusters; `None` omits both. Default: `None`.
    pub spatial: Option<SpatialParams>,
    /// Coverage of the effect's confidence intervals, in (0, 1). Default: 0.95.
    pub confidence: f64,
    /// Level of significance of a vertex, in (0, 1), which only affects warnings. Default: 0.05.
    pub level: f64,
}

impl Default for TestParams {
    fn default() -> Self {
        Self {
            permutations: Some(PermutationParams::default()),
            welch: false,
            variance_groups: None,
            errors: None,
            blocks: None,
            spatial: None,
            confidence: 0.95,
            level: 0.05,
        }
    }
}

/// Result of a test at each of V vertices.
#[derive(Debug, Clone)]
pub struct Test {
    /// Kind of the statistic, with its degrees of freedom.
    pub kind: Statistic,
    /// Statistic at each vertex (V): signed t, F or `T^2`.
    pub statistic: Vec<f64>,
    /// Uncorrected two-sided p values (V), computed from the statistic's distribution.
    pub p: Vec<f64>,
    /// Adjusted p values or "q values" (V) by the method of Benjamini and Hochberg, computed from `p`.
    pub q: Vec<f64>,
    /// Family-wise p values, if relabellings were requested and change the statistics.
    pub family_wise: Option<FamilyWise>,
    /// Estimate, standard error and effect size of the contrast, if it has one row.
    pub effect: Option<Effect>,
    /// Warnings about the test.
    pub warnings: Vec<TestWarning>,
}

/// A test to use instead, which allows unequal variances.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Remedy {
    /// Welch's test of two groups without covariates.
    Welch,
    /// A test with variance groups, in any design, for values of one component.
    VarianceGroups,
}

/// Warnings about a test.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TestWarning {
    /// At some vertices all subjects have equal values, the effect explains all differences, or the components of the
    /// values are linearly dependent.
    #[error(
        "the errors of the linear model have no variance at {vertices} of {of} vertices, because the values are equal \
         or the effect explains all differences: at these vertices, the statistic is set to 0 and p to 1"
    )]
    NoVariance {
        /// Number of vertices at which the errors have no variance.
        vertices: usize,
        /// Total number of vertices.
        of: usize,
    },
    /// Neither permutations of subjects nor sign flips change the statistics.
    #[error(
        "family-wise p values are omitted: neither permutations of subjects nor sign flips change the statistics of \
         this contrast"
    )]
    NoRelabelling,
    /// Two groups differ in size and in variance.
    #[error(
        "the variance of {wide} ({wide_subjects} subjects) is {ratio:.1} times that of {narrow} \
         ({narrow_subjects} subjects): p values assume equal variances and are {}{}",
        if *.wide_subjects < *.narrow_subjects { "too small" } else { "too large" },
        match .remedy {
            Some(Remedy::Welch) => "; use Welch's test, which allows unequal variances",
            Some(Remedy::VarianceGroups) => "; use variance groups, which allow unequal variances",
            None => "",
        }
    )]
    UnequalVariances {
        /// Name of the group with the larger variance.
        wide: String,
        /// Number of subjects in the group with the larger variance.
        wide_subjects: usize,
        /// Name of the group with the smaller variance.
        narrow: String,
        /// Number of subjects in the group with the smaller variance.
        narrow_subjects: usize,
        /// Larger variance divided by the smaller one, both summed over all vertices.
        ratio: f64,
        /// Test that allows unequal variances. `None` if there is no such test, because the values have several
        /// components and the design doesn't consist of two groups.
        remedy: Option<Remedy>,
    },
    /// Two levels of a column differ only in case or in surrounding spaces.
    #[error(
        "{column}: the levels {:?} and {:?} differ only in case or in surrounding spaces, and are treated as different \
         levels; if they mean the same, write both in the same way",
        .levels[0], .levels[1]
    )]
    SimilarLevels {
        /// Name of the column.
        column: String,
        /// The two levels.
        levels: [String; 2],
    },
    /// A number is so far from the other numbers of its column that it may be a code for a missing value.
    #[error(
        "{column}: the number {value:?} in row {row} (counted from 1) is far from the other numbers, whose median is \
         {median}; if it is a code for a missing value, leave out the row"
    )]
    FarValue {
        /// Name of the column.
        column: String,
        /// Row of the number, counted from 1.
        row: usize,
        /// The number.
        value: f64,
        /// Median of the column.
        median: f64,
    },
    /// An effect differs between blocks, but relabellings within blocks assume equal effects.
    #[error(
        "the effect differs between blocks (F = {f:.1}, p = {p:.2e}), but relabellings within blocks assume that it is equal \
         in all blocks: p values are probably too small; compute one slope or difference for each block, and test \
         these values"
    )]
    UnequalEffects {
        /// Variance of the effect between blocks, divided by the variance of the errors.
        f: f64,
        /// P value of the F statistic `f`.
        p: f64,
    },
    /// Whole blocks are exchanged, but the columns that vary within blocks don't determine which rows of two blocks
    /// correspond.
    #[error(
        "the rows of different blocks are matched by their order, because several columns vary within blocks and have \
         different values in each block: p values from relabellings depend on the order of the rows; sort the rows of \
         each block by visit or age, or give the visit as a covariate"
    )]
    RowsByOrder,
    /// Rows of a block depend on each other, and the design doesn't account for this dependence.
    #[error(
        "p, q and margins assume independent rows, but the rows of a block depend on each other: use the p values from \
         relabellings"
    )]
    DependentRows,
    /// There are too few relabellings for any result to be significant.
    #[error(
        "the smallest p value that {relabellings} relabellings can give is {floor:.2e}, above the level {level}: no \
         vertex can be significant; {}",
        if *.exact { "more subjects are needed" } else { "more relabellings are needed" }
    )]
    Floor {
        /// The smallest possible p value.
        floor: f64,
        /// Number of relabellings.
        relabellings: usize,
        /// Level of significance.
        level: f64,
        /// Whether all relabellings were used.
        exact: bool,
    },
}

/// A test returns a warning if the p value of the hypothesis that all blocks have equal effects is below this value.
const UNEQUAL_EFFECTS: f64 = 0.01;

/// Checks the design and the settings of a test before its values are available. `components` is the number of
/// components per vertex, d.
///
/// # Errors
///
/// The errors of [`test`](fn@test) that depend neither on the values nor on the relabellings.
pub fn check(components: usize, design: &Design, contrast: &Contrast, params: &TestParams) -> Result<(), ShapeError> {
    linear::check_design(components, design, contrast, params)?;
    projection::Projection::new(design, contrast)?;
    if params.welch {
        welch::groups(design, contrast, components)?;
    }
    Ok(())
}

/// Tests a contrast at each vertex. `values` is (n, V d): each of the n rows has the values of one subject, with the d
/// components of a vertex in adjacent columns.
///
/// # Errors
///
/// - [`ShapeError::Subjects`] if the number of subjects differs between values, design, blocks and variance groups, or
///   is too small for the statistic.
/// - [`ShapeError::Components`] if the number of columns of `values` isn't a multiple of `components`.
/// - [`ShapeError::NotFiniteValue`] if a value is NaN or infinite.
/// - [`ShapeError::Contrast`] if the contrast doesn't match the design's columns, has weights that aren't finite or
///   rows that are linearly dependent, or has several rows for values of several components.
/// - [`ShapeError::NotTwoGroups`] if Welch's test is requested and the contrast isn't the difference between the two
///   groups of a design without other columns.
/// - [`ShapeError::VarianceGroup`] if the design leaves no degrees of freedom for the errors of a variance group.
/// - [`ShapeError::FlippedRows`] and [`ShapeError::NoRelabelling`] if the requested relabellings aren't valid for the
///   blocks, or leave the statistics unchanged.
/// - [`ShapeError::Setting`] and [`ShapeError::Share`] if a setting is out of its range or contradicts another one.
/// - [`ShapeError::Interrupted`] if the monitor cancels the test.
pub fn test(
    values: ArrayView2<'_, f64>,
    components: usize,
    design: &Design,
    contrast: &Contrast,
    params: &TestParams,
    monitor: &dyn Monitor,
) -> Result<Test, ShapeError> {
    linear::check(values, components, design, contrast, params)?;
    let model = projection::Projection::new(design, contrast)?;
    let groups = params.welch.then(|| welch::groups(design, contrast, components)).transpose()?;
    let prepared = params.variance_groups.as_ref();
    let prepared = prepared
        .map(|of| Ok::<_, ShapeError>((aspin_welch::AspinWelch::new(values, design, contrast, &model, of)?, of)));
    let prepared = prepared.transpose()?;
    let (kind, statistic, p, effect) = match (&groups, &prepared) {
        (Some((groups, weight)), _) => welch::statistics(values, components, (groups, *weight), params.confidence),
        (None, Some((prepared, _))) => prepared.statistics(params.confidence),
        (None, None) => linear::statistics(values, components, contrast, &model, params.confidence)?,
    };
    let mut warnings = Vec::new();
    let of = statistic.len();
    let flat: Vec<usize> = (0..of).filter(|v| statistic[*v].is_nan()).collect();
    let known = |values: Vec<f64>, other: f64| -> Vec<f64> {
        values.into_iter().map(|value| if value.is_nan() { other } else { value }).collect()
    };
    let (statistic, p) = (known(statistic, 0.0), known(p, 1.0));
    if !flat.is_empty() {
        warnings.push(TestWarning::NoVariance { vertices: flat.len(), of });
    }
    if !params.welch && prepared.is_none() {
        warnings.extend(variances::unequal(values, components, design, contrast));
    }
    if params.blocks.as_ref().is_some_and(|blocks| !blocks.are_in(design)) {
        warnings.push(TestWarning::DependentRows);
    }
    let within = params.blocks.as_ref().filter(|blocks| blocks.exchange() == Exchange::Within);
    if let (Some(blocks), Some(_)) = (within, &params.permutations) {
        let differ = own_effects::differ(values, design, &model, blocks);
        let unequal = differ.filter(|[_, p]| *p < UNEQUAL_EFFECTS);
        warnings.extend(unequal.map(|[f, p]| TestWarning::UnequalEffects { f, p }));
    }
    let mut family_wise = None;
    if let Some(asked) = &params.permutations {
        let compared = match (&groups, &prepared) {
            (Some((groups, _)), _) => permutation::Compared::Welch(groups),
            (None, Some((prepared, of))) => permutation::Compared::VarianceGroups(prepared, of),
            (None, None) => permutation::Compared::Pooled,
        };
        let tested = (design, &model, &compared, &kind);
        let found = permutation::family_wise(values, components, tested, (asked, params), monitor)?;
        let by_order = found.as_ref().is_some_and(|(_, by_order)| *by_order);
        warnings.extend(by_order.then_some(TestWarning::RowsByOrder));
        family_wise = found.map(|(found, _)| found);
        if let Some(clusters) = family_wise.as_mut().and_then(|found| found.clusters.as_mut()) {
            // Each cluster's statistic is replaced by the map's value at the cluster's peak, so that the two are equal.
            // They are computed in different ways and would otherwise differ in the last bits.
            clusters.clusters.iter_mut().for_each(|cluster| cluster.statistic = statistic[cluster.peak]);
        }
        if let Some(found) = &mut family_wise {
            flat.iter().for_each(|v| (found.p[*v], found.pointwise[*v]) = (1.0, 1.0));
        }
        match &family_wise {
            Some(FamilyWise { floor, relabellings, exact, .. }) if *floor > params.level => {
                let (floor, relabellings, exact) = (*floor, *relabellings, *exact);
                warnings.push(TestWarning::Floor { floor, relabellings, level: params.level, exact });
            }
            Some(_) => {}
            None => warnings.push(TestWarning::NoRelabelling),
        }
    }
    let q = fdr::benjamini_hochberg(&p);
    Ok(Test { kind, statistic, p, q, family_wise, effect, warnings })
}
