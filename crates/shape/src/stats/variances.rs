//! Detects groups of unequal size and variance, for which pooled variances give wrong p values.

use ndarray::ArrayView2;

use super::TestWarning;
use super::design::{Contrast, Design, orthonormalise};
use super::projection::without;

/// Ratio above which the sizes and the variances of two groups must differ for a warning.
const RATIO: f64 = 1.5;

/// Compares the total residual variances of two groups in values (n, V d). Returns a warning if both sizes and
/// variances differ by more than the factor [`RATIO`]. Returns `None` if the contrast isn't a difference of two groups.
pub(crate) fn unequal(values: ArrayView2<'_, f64>, design: &Design, contrast: &Contrast) -> Option<TestWarning> {
    let columns = two_groups(design, contrast)?;
    let x = design.matrix();
    let members = columns.map(|column| (0..x.nrows()).filter(|i| x[[*i, column]] == 1.0).collect::<Vec<_>>());
    let sizes = [members[0].len(), members[1].len()];
    let more = |a: f64, b: f64| a.max(b) > RATIO * a.min(b);
    if !more(sizes[0] as f64, sizes[1] as f64) {
        return None;
    }
    let (basis, _) = orthonormalise(x);
    let residuals = without(basis.view(), values.to_owned());
    let variances = [0, 1].map(|group| {
        let (mut squares, mut freedom) = (0.0, 0.0);
        for &i in &members[group] {
            squares += residuals.row(i).iter().map(|value| value * value).sum::<f64>();
            freedom += 1.0 - basis.row(i).iter().map(|value| value * value).sum::<f64>();
        }
        if freedom > 1e-9 { squares / freedom } else { f64::NAN }
    });
    // The variance of a group without degrees of freedom is NaN.
    if !more(variances[0], variances[1]) || variances.iter().any(|variance| variance.is_nan()) {
        return None;
    }
    let (wide, narrow) = if variances[0] > variances[1] { (0, 1) } else { (1, 0) };
    let name = |group: usize| design.names()[columns[group]].clone();
    Some(TestWarning::UnequalVariances {
        wide: name(wide),
        wide_subjects: sizes[wide],
        narrow: name(narrow),
        narrow_subjects: sizes[narrow],
        ratio: variances[wide] / variances[narrow],
        covariates: x.ncols() > 2,
    })
}

/// Returns the columns of the two groups if the contrast is their difference and each subject is in one of them,
/// otherwise `None`. The errors of subjects outside both groups would be part of the pooled variance.
fn two_groups(design: &Design, contrast: &Contrast) -> Option<[usize; 2]> {
    let (x, weights) = (design.matrix(), &contrast.weights);
    if weights.nrows() != 1 {
        return None;
    }
    let columns: Vec<usize> = (0..x.ncols()).filter(|column| weights[[0, *column]] != 0.0).collect();
    let &[a, b] = &columns[..] else { return None };
    let indicate = x.rows().into_iter().all(|row| matches!((row[a], row[b]), (1.0, 0.0) | (0.0, 1.0)));
    (indicate && weights[[0, a]] == -weights[[0, b]]).then_some([a, b])
}
