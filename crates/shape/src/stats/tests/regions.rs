//! Tests TFCE and clusters against their definitions.

use super::spatial::Regions;
use super::*;

/// Returns a grid of squares of side 1, each cut into two triangles.
fn grid(rows: usize, columns: usize) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let vertices = (0..rows * columns).map(|v| [(v / columns) as f64, (v % columns) as f64, 0.0]).collect();
    let corner = |i: usize, j: usize| (i * columns + j) as u32;
    let squares = (0..rows - 1).flat_map(|i| (0..columns - 1).map(move |j| (i, j)));
    let cut = |(i, j)| {
        let (a, b, c, d) = (corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1));
        [[a, b, c], [a, c, d]]
    };
    (vertices, squares.flat_map(cut).collect())
}

/// Returns the connected vertices around `v` whose statistic is at least `height`, and their area, by flood fill.
fn extent(v: usize, height: f64, statistics: &[f64], faces: &[[u32; 3]]) -> (f64, Vec<usize>) {
    let mut seen = vec![false; statistics.len()];
    let (mut stack, mut area, mut members) = (vec![v], 0.0, Vec::new());
    seen[v] = true;
    while let Some(v) = stack.pop() {
        members.push(v);
        for face in faces.iter().filter(|face| face.contains(&(v as u32))) {
            area += 0.5 / 3.0;
            for w in face.map(|w| w as usize) {
                if !seen[w] && statistics[w] >= height {
                    seen[w] = true;
                    stack.push(w);
                }
            }
        }
    }
    (area, members)
}

#[test]
fn tfce_is_its_integral() {
    let (vertices, faces) = grid(7, 9);
    let surface = SurfaceGraph::new(&vertices, &faces).unwrap();
    let statistics: Vec<f64> = noise(1, 63, 7).iter().map(|value| 4.0 * value).collect();
    let found = Regions::new(&surface).tfce(&statistics);
    let mut largest = 0.0_f64;
    for v in 0..63 {
        let sign = statistics[v].signum();
        let signed: Vec<f64> = statistics.iter().map(|value| sign * value).collect();
        // The integral is approximated by the midpoint rule with 4,000 steps.
        let step = signed[v] / 4000.0;
        let slice = |k: usize| {
            let height = (k as f64 + 0.5) * step;
            extent(v, height, &signed, &faces).0 * height * height * step
        };
        let expected: f64 = (0..4000).map(slice).sum();
        assert!((sign * found[v] - expected).abs() < 2e-3 * expected.max(0.1), "{v}: {} {expected}", found[v]);
        largest = largest.max(found[v].abs());
    }
    let most = Regions::new(&surface).largest(&statistics, true, None).tfce;
    assert!((most / largest - 1.0).abs() < 1e-12, "{most} {largest}");
}

#[test]
fn clusters_are_connected_and_of_one_sign() {
    let (vertices, faces) = grid(8, 8);
    let surface = SurfaceGraph::new(&vertices, &faces).unwrap();
    let statistics: Vec<f64> = noise(1, 64, 9).iter().map(|value| 4.0 * value).collect();
    let found = Regions::new(&surface).clusters(&statistics, 1.5);
    assert!(found.clusters.len() > 3);
    let mut largest = 0.0_f64;
    for (number, cluster) in (1..).zip(&found.clusters) {
        let sign = cluster.statistic.signum();
        let signed: Vec<f64> = statistics.iter().map(|value| sign * value).collect();
        let (area, members) = extent(cluster.peak, 1.5, &signed, &faces);
        assert!((cluster.area - area).abs() < 1e-12 && cluster.vertices == members.len());
        assert!(members.iter().all(|v| found.of[*v] == number && signed[*v] <= signed[cluster.peak]));
        largest = largest.max(area);
    }
    let outside = (0..64).filter(|v| found.of[*v] == 0);
    assert!(outside.clone().count() > 0 && outside.map(|v| statistics[v].abs()).all(|value| value < 1.5));
    for tfce in [true, false] {
        let found = Regions::new(&surface).largest(&statistics, tfce, Some(1.5)).area;
        assert!((found - largest).abs() < 1e-12, "{found} {largest}");
    }
    // Masked vertices split regions.
    let kept: Vec<bool> = (0..64).map(|v| v % 8 != 4).collect();
    let inside: Vec<f64> = (0..64).filter(|v| kept[*v]).map(|v| statistics[v]).collect();
    let masked = surface.at(&kept).unwrap();
    let mut without = statistics.clone();
    (0..64).filter(|v| !kept[*v]).for_each(|v| without[v] = 0.0);
    let (a, b) = (Regions::new(&masked).clusters(&inside, 1.5), Regions::new(&surface).clusters(&without, 1.5));
    assert_eq!(a.clusters.len(), b.clusters.len());
    assert!(a.clusters.iter().zip(&b.clusters).all(|(a, b)| (a.area - b.area).abs() < 1e-12));
}

#[test]
fn wide_effects_are_found_by_regions() {
    let (vertices, faces) = grid(12, 12);
    let mut y = noise(16, 144, 71);
    let inside = |v: usize| v / 12 < 5 && v % 12 < 6;
    for v in (0..144).filter(|v| inside(*v)) {
        y.slice_mut(s![..8, v]).mapv_inplace(|value| value + 0.9);
    }
    let surface = SurfaceGraph::new(&vertices, &faces).unwrap();
    let spatial = Some(SpatialParams { surface, tfce: true, cluster: Some(0.05) });
    let permutations = Some(PermutationParams { count: 500, ..PermutationParams::default() });
    let params = TestParams { spatial, permutations, ..TestParams::default() };
    let design = Design::groups(&[8, 8]).unwrap();
    let found = test(y.view(), 1, &design, &Contrast::difference(2, 0, 1), &params, &Silent).unwrap();
    let family_wise = found.family_wise.unwrap();
    let (tfce, clusters) = (family_wise.tfce.unwrap(), family_wise.clusters.unwrap());
    let below = |p: &[f64]| (0..144).filter(|v| inside(*v) && p[*v] <= 0.05).count();
    assert!(
        below(&tfce.p) >= 25 && below(&tfce.p) > 2 * below(&family_wise.p),
        "{} {}",
        below(&tfce.p),
        below(&family_wise.p)
    );
    assert!((0..144).filter(|v| !inside(*v) && tfce.p[*v] <= 0.05).count() < 12);
    assert!(
        clusters.clusters[0].p <= 2.0 / 501.0
            && clusters.clusters[0].vertices > 10
            && inside(clusters.clusters[0].peak)
    );
    assert!(tfce.statistic.iter().zip(&found.statistic).all(|(a, b)| a * b >= 0.0));
    // The threshold of clusters has the requested p value.
    assert!((distributions::p_of_t(clusters.threshold, 14.0) - 0.05).abs() < 1e-12);
}
