//! Moves a template near a subject by coherent point drift. Points of the template are the centres of Gaussians of
//! equal width. Each point of the subject is divided among the centres in shares (responsibilities), and a smooth
//! displacement moves the centres towards the points assigned to them.
//!
//! The method is from A. Myronenko and X. Song, "Point set registration: coherent point drift", IEEE Trans. Pattern
//! Anal. Mach. Intell. 32 (2010). Two things differ from the paper: a low-rank factor of the kernel (`v = F a`,
//! [`crate::low_rank`]) replaces the kernel's eigenvectors, and responsibilities are multiplied by
//! `exp(kappa (n_x . n_y - 1))`:
//!
//! ```text
//! p_ij = exp(-|x_j - y_i - v_i|^2 / (2 sigma^2) + kappa (n_j . n_i - 1)) / (sum_i ... + c)
//! (F^T diag(P 1) F + lambda (sigma / scale)^2 I) a = F^T (P x - diag(P 1) y)
//! ```
//!
//! x_j are the subject's points and y_i the template's points, with the unit normals n_j and n_i and the displacements
//! v_i. P is the matrix of the responsibilities p_ij, and c is the term for outliers. F (n, r) is the factor of the
//! kernel, and lambda the stiffness. The square root of the template's area, `scale`, is the unit of lengths, so that
//! results don't depend on the unit of the coordinates.
//!
//! The subject's points are samples of its surface: they show where the surface is, but not which of its points
//! correspond to points of the template. Therefore only the component of the pull along the template's normal acts with
//! full strength. The component within the surface is multiplied by `(sigma / (2 sigma_0))^2`, limited to at most 1,
//! where sigma_0 is the first width. With a full pull within the surface, points would scatter along surfaces that
//! coincide: the variance of five registered boxes with a growing bump would be ten times as large.
//!
//! An iteration costs 25 flops for each pair of points within `CUT_OFF` sigma, and `n r^2` flops for the matrix of the
//! normal equations.

use rayon::prelude::*;
use spharm_linalg::{Accum, Cholesky, Mat, MatRef, matmul};
use spharm_monitor::Monitor;
use spharm_surface::geometry::{Vec3, add, bounds, dot, scale, sub};
use spharm_surface::{Mesh, SpreadPoints};

use crate::cells::Cells;
use crate::error::RegisterError;
use crate::exponential::{Probe, exponentials};
use crate::guide::Guide;
use crate::low_rank::LowRank;
use crate::params::RegisterParams;
use crate::subject::Subject;
use crate::template::{Stage, Template};

/// Cut-off in units of sigma. Pairs farther apart are ignored; their Gaussian factor is below 4e-6.
const CUT_OFF: f64 = 5.0;
/// Number of parts into which sums are divided. It is fixed, so that the result doesn't depend on the number of
/// threads.
const RUNS: usize = 16;
/// Number of iterations after which the template's normals are recomputed.
const NORMALS: usize = 5;
/// The component of the pull within the surface is multiplied by `(sigma / (ALONG sigma_0))^2`, limited to at most 1.
/// The component along the normal is unchanged. sigma is the present width of the Gaussians, and sigma_0 their initial
/// width.
const ALONG: f64 = 2.0;
/// Factor by which sigma is increased when one kernel has converged and the next, narrower kernel takes over.
const AGAIN: f64 = 1.3;

/// Moves the template's vertices close to the subject, in all stages of the drift, and returns the moved vertices.
/// `free` (n) marks vertices that aren't pulled; they follow the other vertices.
///
/// # Errors
///
/// [`RegisterError::Singular`] if the equations have no finite solution, and [`RegisterError::Interrupted`] if
/// `monitor` cancels the registration.
pub fn drift(
    template: &Template,
    free: &[bool],
    subject: &Subject,
    guides: &[Guide],
    params: &RegisterParams,
    monitor: &dyn Monitor,
) -> Result<Vec<Vec3>, RegisterError> {
    let mut mesh = template.mesh.clone();
    let first = params.sigma * template.scale;
    let mut sigma = first;
    for (index, stage) in template.stages.iter().enumerate() {
        let targets = subject.spread(stage.spread.points.len(), 104_729 * (index + 1));
        let (moved, last) =
            run_stage(stage, &mesh, free, (&targets, guides), (sigma, first, template.scale), params, monitor)?;
        mesh.vertices = moved;
        sigma = AGAIN * last;
    }
    Ok(mesh.vertices)
}

/// Sums over the subject's points x. For each template point, `shares` is the sum of responsibilities, and `weighted`
/// is the sum of x weighted by responsibilities. `squares` is the sum of |x|^2 weighted by responsibilities, over all
/// template points.
struct Sums {
    shares: Vec<f64>,
    weighted: Vec<Vec3>,
    squares: f64,
}

fn run_stage(
    stage: &Stage,
    mesh: &Mesh,
    free: &[bool],
    (targets, guides): (&SpreadPoints, &[Guide]),
    (mut sigma, first, scale): (f64, f64, f64),
    params: &RegisterParams,
    monitor: &dyn Monitor,
) -> Result<(Vec<Vec3>, f64), RegisterError> {
    let kernel = &stage.kernel;
    let start = stage.spread.moved(mesh);
    let is_free = |triangle: &u32| mesh.faces[*triangle as usize].iter().any(|v| free[*v as usize]);
    let kept: Vec<u32> =
        (0..).zip(&stage.spread.triangles).filter(|(_, triangle)| !is_free(triangle)).map(|(i, _)| i).collect();
    if kept.is_empty() {
        return Ok((mesh.vertices.clone(), sigma));
    }
    let n = start.points.len();
    let (low, high) = bounds(targets.points.iter().copied());
    let volume: f64 = (0..3).map(|k| high[k] - low[k]).product();
    let odds = params.outliers / (1.0 - params.outliers) * n as f64 / volume.max(f64::MIN_POSITIVE);
    let held = Held::new(guides, kernel, &mesh.vertices, params.landmark);
    let (mut points, mut normals) = (start.points.clone(), start.normals);
    let mut coefficients = vec![[0.0; 3]; kernel.rank];
    for round in 0..params.drift_rounds {
        monitor.check()?;
        if round > 0 && round % NORMALS == 0 {
            normals = stage.spread.moved(&mesh.with_vertices(moved(kernel, mesh, &coefficients))).normals;
        }
        let outlier = odds * (std::f64::consts::TAU * sigma * sigma).powf(1.5);
        let sums = expectation(&points, &normals, &kept, targets, sigma, params.kappa, outlier);
        let along = (sigma / (ALONG * first)).powi(2).min(1.0);
        let pulled = pulled(&sums, &points, &normals, along);
        let stiffness = stage.stiffness * (sigma / scale).powi(2);
        coefficients = maximisation(kernel, &start.points, &sums.shares, &pulled, &held, stiffness)?;
        let displacements = LowRank::displacements(kernel.rank, &kernel.points, &coefficients);
        points = start.points.iter().zip(displacements).map(|(y, v)| add(*y, v)).collect();
        let all: f64 = sums.shares.iter().sum();
        let crossed: f64 = sums.weighted.iter().zip(&points).map(|(x, y)| dot(*x, *y)).sum();
        let own: f64 = sums.shares.iter().zip(&points).map(|(p, y)| p * dot(*y, *y)).sum();
        let next = ((sums.squares - 2.0 * crossed + own) / (3.0 * all)).max(0.0).sqrt();
        if !next.is_finite() {
            return Err(RegisterError::Singular);
        }
        // Sigma is bounded below, because at a smaller sigma no pair would be within the cut-off. At the bound, the
        // points are on the surface.
        let next = next.max(1e-4 * params.sigma * start_extent(low, high));
        let done = (next - sigma).abs() < params.drift_tolerance * sigma;
        sigma = next;
        if done {
            break;
        }
    }
    Ok((moved(kernel, mesh, &coefficients), sigma))
}

fn start_extent(low: Vec3, high: Vec3) -> f64 {
    (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max)
}

/// Landmarks that pull points of the template to points of the subject. `rows` (count, r) has the rows of the kernel's
/// factor F at the landmarks' positions on the template, and `off` (count, 3) has the vectors from these positions to
/// the corresponding points of the subject.
struct Held {
    rows: Mat<f64>,
    off: Mat<f64>,
    weight: f64,
}

impl Held {
    fn new(guides: &[Guide], kernel: &LowRank, vertices: &[Vec3], weight: f64) -> Self {
        let rows: Vec<Vec<f64>> = guides.iter().map(|guide| guide.place.row(&kernel.places, kernel.rank)).collect();
        let off: Vec<Vec3> = guides.iter().map(|guide| sub(guide.point, guide.place.of(vertices))).collect();
        let rows = Mat::from_fn(guides.len(), kernel.rank, |i, k| rows[i][k]);
        Self { rows, off: Mat::from_fn(guides.len(), 3, |i, k| off[i][k]), weight }
    }

    /// Adds the landmarks' terms to the normal equations.
    fn add(&self, matrix: &mut Mat<f64>, right: &mut Mat<f64>) {
        matmul(matrix.as_mut(), Accum::Add, self.rows.transpose(), self.rows.as_ref(), self.weight);
        matmul(right.as_mut(), Accum::Add, self.rows.transpose(), self.off.as_ref(), self.weight);
    }
}

/// Returns the template's displaced vertices.
fn moved(kernel: &LowRank, mesh: &Mesh, coefficients: &[Vec3]) -> Vec<Vec3> {
    let displacements = LowRank::displacements(kernel.rank, &kernel.places, coefficients);
    mesh.vertices.iter().zip(displacements).map(|(y, v)| add(*y, v)).collect()
}

fn expectation(
    points: &[Vec3],
    normals: &[Vec3],
    kept: &[u32],
    targets: &SpreadPoints,
    sigma: f64,
    kappa: f64,
    outlier: f64,
) -> Sums {
    let of = |all: &[Vec3]| kept.iter().map(|i| all[*i as usize]).collect::<Vec<Vec3>>();
    let cells = Cells::new(&of(points), &of(normals), CUT_OFF * sigma);
    let n = points.len();
    let length = targets.points.len().div_ceil(RUNS).max(1);
    let runs = targets.points.par_chunks(length).zip(targets.normals.par_chunks(length)).map(|(xs, ns)| {
        // For each template point, in the order of the cells: the sum of its responsibilities, then the sum of the
        // subject's points x weighted by these responsibilities.
        let mut sums = vec![[0.0; 4]; kept.len()];
        let (mut squares, mut values, mut ranges) = (0.0, vec![0.0; kept.len()], Vec::new());
        for (x, normal) in xs.iter().zip(ns) {
            let probe = Probe { x: *x, n: *normal, sharpness: 0.5 / (sigma * sigma), kappa };
            let (mut total, mut filled) = (outlier, 0);
            ranges.clear();
            cells.near(*x, |range| {
                let out = &mut values[filled..filled + range.len()];
                total += exponentials(&probe, &cells.columns, range.start, out);
                filled += range.len();
                ranges.push(range);
            });
            let (square, mut at) = (dot(*x, *x), 0);
            for range in ranges.drain(..) {
                for i in range {
                    let share = values[at] / total;
                    at += 1;
                    let sum = &mut sums[i];
                    *sum = [sum[0] + share, sum[1] + share * x[0], sum[2] + share * x[1], sum[3] + share * x[2]];
                    squares += share * square;
                }
            }
        }
        (sums, squares)
    });
    let runs: Vec<(Vec<[f64; 4]>, f64)> = runs.collect();
    let mut found = Sums { shares: vec![0.0; n], weighted: vec![[0.0; 3]; n], squares: 0.0 };
    for (sums, squares) in runs {
        found.squares += squares;
        for (sum, index) in sums.iter().zip(&cells.index) {
            let index = kept[*index as usize] as usize;
            found.shares[index] += sum[0];
            (0..3).for_each(|k| found.weighted[index][k] += sum[k + 1]);
        }
    }
    found
}

/// Returns `P x`, the sums of the subject's points weighted by responsibilities, after weakening the pull within the
/// surface. The pull on a template point is its row of `P x` minus the product of the point and its sum of
/// responsibilities. The component of the pull perpendicular to the point's normal is multiplied by `along`.
fn pulled(sums: &Sums, points: &[Vec3], normals: &[Vec3], along: f64) -> Vec<Vec3> {
    let of = |(((weighted, share), point), normal): (((&Vec3, &f64), &Vec3), &Vec3)| {
        let here = scale(*point, *share);
        let pull = sub(*weighted, here);
        let across = scale(*normal, dot(pull, *normal));
        add(here, add(across, scale(sub(pull, across), along)))
    };
    sums.weighted.iter().zip(&sums.shares).zip(points).zip(normals).map(of).collect()
}

/// Solves the normal equations, and returns the coefficients a (r, 3) of the displacement `F a`.
fn maximisation(
    kernel: &LowRank,
    start: &[Vec3],
    shares: &[f64],
    pulled: &[Vec3],
    held: &Held,
    stiffness: f64,
) -> Result<Vec<Vec3>, RegisterError> {
    let (n, r) = (start.len(), kernel.rank);
    let length = n.div_ceil(RUNS).max(1);
    let partial = (0..n.div_ceil(length)).into_par_iter().map(|run| {
        let rows = run * length..((run + 1) * length).min(n);
        let factor = MatRef::from_row_major_slice(&kernel.points[rows.start * r..rows.end * r], rows.len(), r);
        let shares = &shares[rows.clone()];
        let weighted = Mat::from_fn(rows.len(), r, |i, j| shares[i] * factor[(i, j)]);
        let pulls =
            Mat::from_fn(rows.len(), 3, |i, k| pulled[rows.start + i][k] - shares[i] * start[rows.start + i][k]);
        let (mut matrix, mut right) = (Mat::zeros(r, r), Mat::zeros(r, 3));
        matmul(matrix.as_mut(), Accum::Replace, factor.transpose(), weighted.as_ref(), 1.0);
        matmul(right.as_mut(), Accum::Replace, factor.transpose(), pulls.as_ref(), 1.0);
        (matrix, right)
    });
    let partial: Vec<(Mat<f64>, Mat<f64>)> = partial.collect();
    let (mut matrix, mut right) = (Mat::<f64>::zeros(r, r), Mat::<f64>::zeros(r, 3));
    for (of_matrix, of_right) in partial {
        matrix += of_matrix;
        right += of_right;
    }
    held.add(&mut matrix, &mut right);
    (0..r).for_each(|i| matrix[(i, i)] += stiffness);
    let solved = Cholesky::new(matrix.as_ref()).map_err(|_| RegisterError::Singular)?.solve(right.as_ref());
    Ok((0..r).map(|i| std::array::from_fn(|k| solved[(i, k)])).collect())
}
