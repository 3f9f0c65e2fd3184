//! Generates the relabellings of a study: all of them if there are few, otherwise random ones.
//!
//! Exchanging subjects with equal rows of the design has no effect, so that only arrangements of the distinct rows are
//! counted: `n! / (k_1! k_2! ...)` for rows that occur k times, `C(n, n_1)` for two groups. There are `2^n` sign flips;
//! with permutations and sign flips the numbers are multiplied. Random relabelling b is drawn from stream b of ChaCha8
//! with the seed, so that it doesn't depend on the number of threads.

use ndarray::ArrayView2;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::resampling::Resampling;

/// Relabellings of n subjects.
#[derive(Debug, Clone)]
pub(crate) struct Arrangements {
    /// Index of each subject's row among the distinct rows.
    classes: Vec<u32>,
    /// For each distinct row, a subject with this row.
    representatives: Vec<u32>,
    resampling: Resampling,
    seed: u64,
    /// Number of relabellings, including the original labels as the first.
    pub(crate) count: usize,
    /// Whether these are all relabellings.
    pub(crate) exact: bool,
}

/// One relabelling: for each subject, the subject whose row of the design it gets, and the sign.
pub(crate) type Relabelling = Vec<(u32, f64)>;

impl Arrangements {
    /// Returns all relabellings of the rows of (n, p) if there are at most `exact_up_to`, otherwise the original labels
    /// and `random` random relabellings.
    pub(crate) fn new(
        rows: ArrayView2<'_, f64>,
        resampling: Resampling,
        random: usize,
        exact_up_to: usize,
        seed: u64,
    ) -> Self {
        let mut representatives: Vec<u32> = Vec::new();
        let mut classes = Vec::with_capacity(rows.nrows());
        for (i, row) in rows.rows().into_iter().enumerate() {
            let same = |other: &u32| {
                let other = rows.row(*other as usize);
                row.iter().zip(other).all(|(a, b)| (a - b).abs() <= 1e-12)
            };
            let class = representatives.iter().position(same).unwrap_or_else(|| {
                representatives.push(i as u32);
                representatives.len() - 1
            });
            classes.push(class as u32);
        }
        let exchanges = || multinomial(&classes, representatives.len());
        let flips = || power_of_two(rows.nrows());
        let all = match resampling {
            Resampling::Permutations => exchanges(),
            Resampling::SignFlips => flips(),
            Resampling::Both => exchanges().zip(flips()).and_then(|(exchanges, flips)| exchanges.checked_mul(flips)),
        };
        let exact = all.is_some_and(|all| all <= exact_up_to as u64);
        let count = if exact { all.unwrap_or_default() as usize } else { random + 1 };
        Self { classes, representatives, resampling, seed, count, exact }
    }

    /// Returns relabellings `from..to`.
    pub(crate) fn range(&self, from: usize, to: usize) -> Vec<Relabelling> {
        if !self.exact {
            return (from..to).map(|index| self.random(index)).collect();
        }
        match self.resampling {
            Resampling::Permutations => self.exchanges(from, to),
            Resampling::SignFlips => (from..to).map(|index| flipped(self.identity(), index)).collect(),
            Resampling::Both => {
                let flips = 1 << self.classes.len();
                let orders = self.exchanges(from / flips, to.div_ceil(flips));
                (from..to).map(|i| flipped(orders[i / flips - from / flips].clone(), i % flips)).collect()
            }
        }
    }

    fn identity(&self) -> Relabelling {
        (0..self.classes.len()).map(|i| (i as u32, 1.0)).collect()
    }

    /// Returns permutations `from..to` in lexicographic order; all permutations before `from` are generated and
    /// skipped.
    fn exchanges(&self, from: usize, to: usize) -> Vec<Relabelling> {
        let mut classes = self.classes.clone();
        classes.sort_unstable();
        let mut found = Vec::with_capacity(to - from);
        for index in 0..to {
            if index >= from {
                found.push(classes.iter().map(|class| (self.representatives[*class as usize], 1.0)).collect());
            }
            if !next(&mut classes) {
                break;
            }
        }
        found
    }

    /// Returns the original labels for index 0, otherwise a random relabelling.
    fn random(&self, index: usize) -> Relabelling {
        let mut relabelling = self.identity();
        if index == 0 {
            return relabelling;
        }
        let mut random = self.stream(index);
        if self.resampling != Resampling::SignFlips {
            for last in (1..relabelling.len()).rev() {
                relabelling.swap(last, below(&mut random, last as u64 + 1) as usize);
            }
        }
        if self.resampling != Resampling::Permutations {
            relabelling.iter_mut().for_each(|(_, sign)| *sign = if random.next_u32() & 1 == 1 { -1.0 } else { 1.0 });
        }
        relabelling
    }

    fn stream(&self, index: usize) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(index as u64);
        random
    }
}

/// Returns a relabelling with the sign flips of number `index`.
fn flipped(mut relabelling: Relabelling, index: usize) -> Relabelling {
    let flip = |i: usize| i < 64 && index >> i & 1 == 1;
    relabelling.iter_mut().enumerate().filter(|(i, _)| flip(*i)).for_each(|(_, (_, sign))| *sign = -*sign);
    relabelling
}

/// Returns a uniformly distributed number below `bound`.
fn below(random: &mut ChaCha8Rng, bound: u64) -> u64 {
    // Numbers in the last range, which is shorter than `bound`, are redrawn to avoid bias.
    let limit = u64::MAX - u64::MAX % bound;
    loop {
        let drawn = random.next_u64();
        if drawn < limit {
            return drawn % bound;
        }
    }
}

/// Steps to the next arrangement in lexicographic order; returns false after the last one.
fn next(values: &mut [u32]) -> bool {
    let Some(pivot) = (1..values.len()).rev().find(|&i| values[i - 1] < values[i]) else { return false };
    let Some(larger) = (pivot..values.len()).rev().find(|&i| values[i] > values[pivot - 1]) else { return false };
    values.swap(pivot - 1, larger);
    values[pivot..].reverse();
    true
}

/// Returns `n! / (k_1! k_2! ...)` if it fits in a u64.
fn multinomial(classes: &[u32], distinct: usize) -> Option<u64> {
    let mut all = 1u64;
    let mut placed = 0u64;
    for class in 0..distinct as u32 {
        for among in 1..=classes.iter().filter(|of| **of == class).count() as u64 {
            placed += 1;
            // The result is a product of binomial coefficients, and an integer at each step.
            all = u64::try_from(u128::from(all) * u128::from(placed) / u128::from(among)).ok()?;
        }
    }
    Some(all)
}

fn power_of_two(n: usize) -> Option<u64> {
    1u64.checked_shl(n as u32).filter(|_| n < 63)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;
    use std::collections::HashSet;

    fn rows(classes: &[u32]) -> Array2<f64> {
        Array2::from_shape_fn((classes.len(), 1), |(i, _)| f64::from(classes[i]))
    }

    #[test]
    fn all_relabellings_of_groups_are_there_once() {
        for classes in [vec![0, 0, 1, 1, 1], vec![0, 1, 2, 1], vec![1, 0, 1, 0, 2, 2]] {
            let all = Arrangements::new(rows(&classes).view(), Resampling::Permutations, 10, 20_000, 0);
            let labels = |relabelling: &Relabelling| -> Vec<u32> {
                relabelling.iter().map(|(i, _)| classes[*i as usize]).collect()
            };
            let found: HashSet<Vec<u32>> = all.range(0, all.count).iter().map(labels).collect();
            assert!(all.exact && found.len() == all.count && found.contains(&classes));
            let parts: Vec<_> = all.range(0, 3).into_iter().chain(all.range(3, all.count)).collect();
            assert_eq!(parts, all.range(0, all.count));
        }
        let ten =
            Arrangements::new(rows(&[0, 0, 0, 0, 0, 1, 1, 1, 1, 1]).view(), Resampling::Permutations, 10, 20_000, 0);
        assert_eq!(ten.count, 252);
    }

    #[test]
    fn random_relabellings_are_even_and_the_same_for_a_seed() {
        let classes: Vec<u32> = (0..40).collect();
        let random = Arrangements::new(rows(&classes).view(), Resampling::Permutations, 4_000, 20_000, 7);
        assert!(!random.exact && random.count == 4_001);
        let found = random.range(0, 4_001);
        assert!(found[0].iter().enumerate().all(|(i, (of, _))| i as u32 == *of));
        assert_eq!(found[100..200], random.range(100, 200)[..]);
        // Subject 0 is at each of the 40 positions about 100 times; 5 standard deviations are 50.
        let mut places = [0; 40];
        found[1..].iter().for_each(|order| places[order.iter().position(|(of, _)| *of == 0).unwrap()] += 1);
        assert!(places.iter().all(|&count| (50..150).contains(&count)), "{places:?}");
    }

    #[test]
    fn signs_are_all_or_random() {
        let ones = Array2::ones((5, 1));
        let all = Arrangements::new(ones.view(), Resampling::SignFlips, 10, 20_000, 0);
        let distinct: HashSet<String> = all.range(0, 32).iter().map(|signs| format!("{signs:?}")).collect();
        assert_eq!((all.count, distinct.len()), (32, 32));
        let many = Arrangements::new(Array2::ones((70, 1)).view(), Resampling::SignFlips, 10, 20_000, 0);
        assert!(!many.exact && many.range(0, 1)[0].iter().all(|(_, sign)| *sign == 1.0));
    }

    #[test]
    fn exchanges_and_signs_together_are_all_there_once() {
        let classes = [0, 1, 1, 1];
        let all = Arrangements::new(rows(&classes).view(), Resampling::Both, 10, 20_000, 0);
        let labels = |relabelling: &Relabelling| -> Vec<(u32, bool)> {
            relabelling.iter().map(|(from, sign)| (classes[*from as usize], *sign < 0.0)).collect()
        };
        let found: HashSet<_> = all.range(0, all.count).iter().map(labels).collect();
        assert!(all.exact && all.count == 4 * 16 && found.len() == 64);
        let parts: Vec<_> = all.range(0, 21).into_iter().chain(all.range(21, 64)).collect();
        assert_eq!(parts, all.range(0, 64));
        let many = Arrangements::new(rows(&[0; 30]).view(), Resampling::Both, 10, 20_000, 0);
        let found = many.range(0, 3);
        assert!(found[0].iter().enumerate().all(|(i, (of, sign))| (i as u32, 1.0) == (*of, *sign)));
        assert!(found[1].iter().any(|(_, sign)| *sign < 0.0) && found[1] != found[2]);
    }
}
