//! Formats the results of threshold-free cluster enhancement (TFCE) and of the search for clusters, as maps, as the
//! table of clusters and as summaries.

use serde_json::{Value, json};
use spharm::shape::stats::{Cluster, Clusters, FamilyWise, Test};

use super::super::outputs::{csv, short};
use super::places::Places;

/// Returns the maps of TFCE and of clusters at the tested vertices.
pub(super) fn maps(found: &FamilyWise) -> Vec<(&'static str, Vec<f64>)> {
    let mut maps = Vec::new();
    if let Some(tfce) = &found.tfce {
        maps.extend([("tfce", tfce.statistic.clone()), ("p-tfce", tfce.p.clone())]);
    }
    if let Some(clusters) = &found.clusters {
        let p = |number: &u32| number.checked_sub(1).map_or(1.0, |at| clusters.clusters[at as usize].p);
        maps.push(("cluster", clusters.of.iter().map(|number| f64::from(*number)).collect()));
        maps.push(("p-cluster", clusters.of.iter().map(p).collect()));
    }
    maps
}

/// Returns the table of the clusters; `None` if no clusters were requested. The columns are the cluster's number,
/// vertices, area and family-wise p; the peak's vertex, direction, position on the mean surface (in that surface's
/// frame), statistic, effect and region; and the unit of the area. This unit is the square of the models' unit of
/// length, or 1 for a signal's clusters on the unit sphere.
pub(super) fn clusters(test: &Test, places: &Places<'_>) -> Option<String> {
    let found = test.family_wise.as_ref()?.clusters.as_ref()?;
    let mut header = vec!["cluster", "vertices", "area", "p_fwe", "peak", "ux", "uy", "uz"];
    header.extend(places.has_positions().then_some(["x", "y", "z"]).into_iter().flatten());
    header.push("statistic");
    let effect = test.effect.as_ref().filter(|effect| effect.estimate.ncols() == 1);
    header.extend(effect.map(|_| "effect"));
    header.extend(places.has_regions().then_some("region"));
    header.push("unit");
    let unit = if places.has_positions() { "length^2" } else { "1" };
    let row = |(at, cluster): (usize, &Cluster)| {
        let peak = cluster.peak;
        let mut row = vec![(at + 1).to_string(), cluster.vertices.to_string(), short(cluster.area), short(cluster.p)];
        row.push(places.vertex(peak).to_string());
        row.extend(places.direction(peak).map(short));
        row.extend(places.position(peak).into_iter().flatten().map(short));
        row.push(short(cluster.statistic));
        row.extend(effect.map(|effect| short(effect.estimate[[peak, 0]])));
        row.extend(places.region(peak).map(str::to_owned));
        row.push(unit.to_owned());
        row
    };
    let rows: Vec<Vec<String>> = found.clusters.iter().enumerate().map(row).collect();
    Some(csv(&header, rows.iter().map(Vec::as_slice)))
}

/// Returns the number of clusters and the number of clusters significant at a level; `None` if clusters weren't
/// requested.
pub(super) fn summary(found: &FamilyWise, level: f64) -> Option<Value> {
    let clusters = found.clusters.as_ref()?;
    let significant = significant(clusters, level);
    let count = clusters.clusters.len();
    Some(json!({ "threshold": clusters.threshold, "clusters": count, "significant": significant }))
}

/// Returns the number of clusters whose family-wise p is at most a level.
fn significant(clusters: &Clusters, level: f64) -> usize {
    clusters.clusters.iter().filter(|cluster| cluster.p <= level).count()
}

/// Returns the rows of the printed table. `count` takes the p values of the tested vertices, and returns a text with
/// the smallest p value and the number of vertices whose p values are at most `level`.
pub(super) fn lines(found: &FamilyWise, level: f64, count: impl Fn(&[f64]) -> String) -> Vec<Vec<String>> {
    let pair = |name: &str, value: String| vec![name.to_owned(), value];
    let mut lines = Vec::new();
    if let Some(tfce) = &found.tfce {
        lines.push(pair("least family-wise p of TFCE", count(&tfce.p)));
    }
    if let Some(clusters) = &found.clusters {
        let significant = significant(clusters, level);
        let text = format!(
            "{}, of vertices with a statistic above {:.3}; {significant} have a family-wise p of at most {level}",
            clusters.clusters.len(),
            clusters.threshold
        );
        lines.push(pair("clusters", text));
    }
    lines
}
