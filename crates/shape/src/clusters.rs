//! Groups models by their shapes: hierarchical clustering with Ward's linkage.
//!
//! Ward's linkage repeatedly merges two clusters, each time the pair whose merge least increases the sum of squared
//! distances from the clusters' means (J. H. Ward, "Hierarchical grouping to optimize an objective function", JASA 58,
//! 1963). The crate kodama computes the linkage. If no number of clusters is given, the number with the largest mean
//! silhouette is chosen (P. J. Rousseeuw, "Silhouettes", Journal of Computational and Applied Mathematics 20, 1987).
//! The result is deterministic.
//!
//! Cost for n models: O(n^2) time, and 8 n^2 bytes for two copies of the distances between all pairs.

use crate::error::ShapeError;

/// Largest number of clusters that is tried if the caller gives no number.
const MOST: usize = 10;

/// A partition of models into clusters.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Clusters {
    /// Number of each model's cluster, from 0. Clusters are numbered in order of decreasing size, and clusters of equal
    /// size in the order of their first models.
    pub of: Vec<usize>,
    /// Silhouette of each model, from -1 to 1. It is near 1 if the model is much nearer to its own cluster than to any
    /// other cluster, and 0 if it is equally near to its own and the nearest other cluster. A model that is alone in
    /// its cluster has silhouette 0.
    pub silhouettes: Vec<f64>,
    /// Most typical model of each cluster: the model with the smallest sum of squared distances from the other models
    /// in the cluster.
    pub typical: Vec<usize>,
    /// Mean silhouette of all models.
    pub mean: f64,
    /// Numbers of clusters that were tried, each with its mean silhouette; empty if the caller gave the number.
    pub tried: Vec<(usize, f64)>,
}

/// Distances between all pairs of n models.
#[derive(Debug, Clone, PartialEq)]
pub struct PairDistances {
    count: usize,
    /// Distances from model 0 to the models 1, 2, ..., then from model 1 to the models 2, 3, ..., and so on.
    values: Vec<f64>,
}

impl PairDistances {
    /// Computes the distances between all pairs of `count` models; `distance` returns the distance between two of them.
    pub fn new(count: usize, distance: impl Fn(usize, usize) -> f64) -> Self {
        let pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b)));
        Self { count, values: pairs.map(|(a, b)| distance(a, b)).collect() }
    }

    /// Returns the distance between two models.
    #[must_use]
    pub fn between(&self, a: usize, b: usize) -> f64 {
        let (first, second) = (a.min(b), a.max(b));
        if first == second { 0.0 } else { self.values[first * (2 * self.count - first - 1) / 2 + second - first - 1] }
    }

    /// Groups the models into `clusters` clusters. If `clusters` is `None`, the number of clusters is the number from 2
    /// to 10 with the largest mean silhouette.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Setting`] if there are fewer than three models, if fewer than two clusters or more clusters than
    /// models are requested, or if a distance isn't finite.
    pub fn clusters(&self, clusters: Option<usize>) -> Result<Clusters, ShapeError> {
        let setting = |name, expected, found: String| Err(ShapeError::Setting { name, expected, found });
        if self.count < 3 {
            return setting("the number of models to cluster", "it must be at least 3", self.count.to_string());
        }
        if let Some(wanted) = clusters.filter(|wanted| !(2..=self.count).contains(wanted)) {
            return setting("the number of clusters", "it must be from 2 to the number of models", wanted.to_string());
        }
        if let Some(value) = self.values.iter().find(|value| !value.is_finite()) {
            return setting("a distance between models", "all distances must be finite", value.to_string());
        }
        let tree = kodama::linkage(&mut self.values.clone(), self.count, kodama::Method::Ward);
        let partition = |clusters: usize| {
            let of = cut(&tree, self.count, clusters);
            let silhouettes = self.silhouettes(&of, clusters);
            let mean = silhouettes.iter().sum::<f64>() / self.count as f64;
            (of, silhouettes, mean)
        };
        let mut tried = Vec::new();
        let ((of, silhouettes, mean), count) = match clusters {
            Some(count) => (partition(count), count),
            None => {
                let mut best = (partition(2), 2);
                tried.push((2, best.0.2));
                for count in 3..=MOST.min(self.count - 1) {
                    let found = partition(count);
                    tried.push((count, found.2));
                    if found.2 > best.0.2 {
                        best = (found, count);
                    }
                }
                best
            }
        };
        let typical = (0..count).map(|cluster| self.most_typical(&of, cluster)).collect();
        Ok(Clusters { of, silhouettes, typical, mean, tried })
    }

    fn silhouettes(&self, of: &[usize], clusters: usize) -> Vec<f64> {
        let mut sizes = vec![0_usize; clusters];
        of.iter().for_each(|cluster| sizes[*cluster] += 1);
        let one = |model: usize| {
            let own = of[model];
            if sizes[own] == 1 {
                return 0.0;
            }
            let mut sums = vec![0.0; clusters];
            (0..self.count).for_each(|other| sums[of[other]] += self.between(model, other));
            let within = sums[own] / (sizes[own] - 1) as f64;
            let others =
                (0..clusters).filter(|cluster| *cluster != own).map(|cluster| sums[cluster] / sizes[cluster] as f64);
            let nearest = others.fold(f64::INFINITY, f64::min);
            let larger = within.max(nearest);
            if larger > 0.0 { (nearest - within) / larger } else { 0.0 }
        };
        (0..self.count).map(one).collect()
    }

    fn most_typical(&self, of: &[usize], cluster: usize) -> usize {
        let members: Vec<usize> = (0..self.count).filter(|model| of[*model] == cluster).collect();
        let sum = |model: usize| members.iter().map(|other| self.between(model, *other).powi(2)).sum::<f64>();
        let sums = members.iter().map(|model| (sum(*model), *model));
        sums.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0, |(_, model)| model)
    }
}

/// Cuts a tree of merges into `clusters` clusters by undoing the last merges, and returns the cluster of each model.
fn cut(tree: &kodama::Dendrogram<f64>, count: usize, clusters: usize) -> Vec<usize> {
    // Nodes with an index below `count` are the models. The other nodes are the merges, in order.
    let mut parents: Vec<usize> = (0..2 * count).collect();
    for (step, merger) in tree.steps().iter().enumerate().take(count - clusters) {
        parents[merger.cluster1] = count + step;
        parents[merger.cluster2] = count + step;
    }
    let root = |mut node: usize| {
        while parents[node] != node {
            node = parents[node];
        }
        node
    };
    let roots: Vec<usize> = (0..count).map(root).collect();
    let mut firsts: Vec<(usize, usize)> = Vec::new();
    for (model, root) in roots.iter().enumerate() {
        if !firsts.iter().any(|(known, _)| known == root) {
            firsts.push((*root, model));
        }
    }
    let size = |root: usize| roots.iter().filter(|other| **other == root).count();
    firsts.sort_by_key(|(root, first)| (std::cmp::Reverse(size(*root)), *first));
    let place = |root: &usize| firsts.iter().position(|(known, _)| known == root).unwrap_or(0);
    roots.iter().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a line, in three groups of 3, 2 and 4 points.
    const POINTS: [f64; 9] = [0.0, 10.0, 0.2, 30.0, 30.1, 0.1, 10.4, 30.3, 30.2];

    fn distances() -> PairDistances {
        PairDistances::new(POINTS.len(), |a, b| (POINTS[a] - POINTS[b]).abs())
    }

    #[test]
    fn groups_are_found_and_their_number_chosen() {
        let found = distances().clusters(None).unwrap();
        assert_eq!(found.of, [1, 2, 1, 0, 0, 1, 2, 0, 0]);
        assert_eq!(found.tried.len(), 7);
        assert!(found.tried.iter().all(|(count, mean)| *count == 3 || *mean < found.mean));
        // On a line, the typical model of a cluster is the point in the middle, or the first point if the cluster has
        // only two.
        assert_eq!(found.typical, [4, 5, 1]);
        // The distance of point 1 from the other point of its cluster is 0.4, and its mean distance from the nearest
        // other cluster is 9.9.
        assert!((found.silhouettes[1] - (1.0 - 0.4 / 9.9)).abs() < 1e-12);
        assert_eq!(distances().clusters(Some(2)).unwrap().of, [0, 0, 0, 1, 1, 0, 0, 1, 1]);
    }

    #[test]
    fn clusters_of_single_models_have_no_silhouette() {
        let found = distances().clusters(Some(9)).unwrap();
        assert_eq!((found.of, found.mean), ((0..9).collect(), 0.0));
        let equal = PairDistances::new(4, |_, _| 0.0).clusters(Some(2)).unwrap();
        assert_eq!(equal.mean, 0.0);
    }

    #[test]
    fn what_cannot_be_clustered_is_refused() {
        for (distances, clusters) in [
            (PairDistances::new(2, |_, _| 1.0), None),
            (distances(), Some(1)),
            (distances(), Some(10)),
            (PairDistances::new(4, |_, _| f64::NAN), None),
        ] {
            assert!(matches!(distances.clusters(clusters), Err(ShapeError::Setting { .. })));
        }
    }
}
