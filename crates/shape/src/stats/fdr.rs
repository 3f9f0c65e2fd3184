//! Controls the false-discovery rate by the method of Y. Benjamini and Y. Hochberg, "Controlling the false discovery
//! rate", J. R. Stat. Soc. B 57 (1995).

/// Returns the adjusted p values ("q values") of p values in [0, 1]. Among vertices with q at most alpha, the
/// expected fraction of false positives is at most alpha if tests are independent or positively dependent.
///
/// ```
/// use spharm_shape::stats::fdr::benjamini_hochberg;
/// assert_eq!(benjamini_hochberg(&[0.01, 0.04, 0.03]), [0.03, 0.04, 0.04]);
/// ```
pub fn benjamini_hochberg(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|&a, &b| p[b].total_cmp(&p[a]));
    let (count, mut least) = (p.len() as f64, 1.0_f64);
    let mut q = vec![0.0; p.len()];
    for (above, at) in order.into_iter().enumerate() {
        least = least.min(p[at] * count / (count - above as f64));
        q[at] = least;
    }
    q
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_step_up_procedure() {
        // For every alpha, the procedure rejects the hypotheses up to the last rank k with p_(k) <= k alpha / n.
        let p: Vec<f64> = (0..50).map(|i| (f64::from(i) * 12.9898).sin().abs().powi(3)).collect();
        let q = benjamini_hochberg(&p);
        let mut sorted = p.clone();
        sorted.sort_by(f64::total_cmp);
        for alpha in [0.01, 0.05, 0.2, 0.5] {
            let last = (0..50).rev().find(|&k| sorted[k] <= (k as f64 + 1.0) * alpha / 50.0);
            let limit = last.map_or(-1.0, |k| sorted[k]);
            for (p, q) in p.iter().zip(&q) {
                assert_eq!(*q <= alpha, *p <= limit, "{alpha} {p} {q}");
            }
        }
        assert!(benjamini_hochberg(&[]).is_empty());
    }
}
