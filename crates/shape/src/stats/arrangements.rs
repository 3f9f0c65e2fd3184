//! Generates the relabellings of a study: all of them if there are few, otherwise random ones.
//!
//! Units, which are single subjects or whole blocks ([`Blocks`](super::Blocks)), are exchanged within sets. Exchanging
//! units with equal rows of the design has no effect, so only arrangements of distinct units are counted. A set of m
//! units in which distinct units occur k_1, k_2, ... times has `m! / (k_1! k_2! ...)` arrangements. For two groups,
//! this is `C(n, n_1)`. The total number of arrangements is the product of the numbers of all sets. u units have `2^u`
//! sign flips. If permutations and sign flips are combined, both numbers are multiplied. Random relabelling b is drawn
//! from stream b of ChaCha8, so it depends only on b and the seed, not on the number of threads.

use ndarray::ArrayView2;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::blocks::{Unit, are_equal};
use super::resampling::Resampling;

/// The relabellings of n subjects that a test uses: all possible ones, or random ones.
#[derive(Debug, Clone)]
pub(crate) struct Arrangements {
    /// Sets of units (observations that stay together) that can be exchanged with each other.
    sets: Vec<Set>,
    /// Number of subjects, n.
    subjects: usize,
    resampling: Resampling,
    seed: u64,
    /// Number of relabellings, including the original labels as the first.
    pub(crate) count: usize,
    /// Whether all possible relabellings are included.
    pub(crate) exact: bool,
}

/// A relabelling, with an index and a sign for each subject. The row of the design at this index replaces the subject's
/// own row.
pub(crate) type Relabelling = Vec<(u32, f64)>;

/// Returns the original labels of n subjects.
pub(crate) fn identity(subjects: usize) -> Relabelling {
    (0..subjects).map(|i| (i as u32, 1.0)).collect()
}

/// Units that can be exchanged with each other.
#[derive(Debug, Clone)]
struct Set {
    units: Vec<Unit>,
    /// For each class of units with equal rows of the design, the index of one unit.
    distinct: Vec<usize>,
    /// Number of units in each class.
    counts: Vec<u64>,
    /// Number of arrangements; `None` if it exceeds a u64.
    arrangements: Option<u64>,
}

impl Set {
    fn new(units: Vec<Unit>, rows: ArrayView2<'_, f64>) -> Self {
        let (mut distinct, mut counts): (Vec<usize>, Vec<u64>) = (Vec::new(), Vec::new());
        for (at, unit) in units.iter().enumerate() {
            match distinct.iter().position(|other| are_equal(unit, &units[*other], rows)) {
                Some(class) => counts[class] += 1,
                None => {
                    distinct.push(at);
                    counts.push(1);
                }
            }
        }
        let arrangements = multinomial(&counts);
        Self { units, distinct, counts, arrangements }
    }

    /// Writes arrangement `index`, counted in lexicographic order, into a relabelling.
    fn arrange(&self, mut index: u64, relabelling: &mut Relabelling) {
        let mut counts = self.counts.clone();
        let mut arrangements = u128::from(self.arrangements.unwrap_or(1));
        for (place, unit) in self.units.iter().enumerate() {
            let remaining = (self.units.len() - place) as u128;
            for (class, count) in counts.iter_mut().enumerate() {
                // Number of arrangements of the remaining units that begin with a unit of this class.
                let here = arrangements * u128::from(*count) / remaining;
                if u128::from(index) < here {
                    put(unit, &self.units[self.distinct[class]], relabelling);
                    *count -= 1;
                    arrangements = here;
                    break;
                }
                index -= here as u64;
            }
        }
    }
}

/// Assigns the rows of the unit `rows_of` to the subjects of `unit`, pairing them in order.
fn put(unit: &Unit, rows_of: &Unit, relabelling: &mut Relabelling) {
    unit.iter().zip(rows_of).for_each(|(subject, from)| relabelling[*subject as usize].0 = *from);
}

impl Arrangements {
    /// Creates all relabellings of the design's rows (n, p) if there are at most `exact_up_to`, otherwise the original
    /// labels and `random` random relabellings. Units are exchanged within their set.
    pub(crate) fn new(
        rows: ArrayView2<'_, f64>,
        sets: Vec<Vec<Unit>>,
        resampling: Resampling,
        random: usize,
        exact_up_to: usize,
        seed: u64,
    ) -> Self {
        let sets: Vec<Set> = sets.into_iter().map(|units| Set::new(units, rows)).collect();
        let exchanges = || sets.iter().try_fold(1u64, |all, set| all.checked_mul(set.arrangements?));
        let flips = || power_of_two(sets.iter().map(|set| set.units.len()).sum());
        let all = match resampling {
            Resampling::Permutations => exchanges(),
            Resampling::SignFlips => flips(),
            Resampling::Both => exchanges().zip(flips()).and_then(|(exchanges, flips)| exchanges.checked_mul(flips)),
        };
        let exact = all.is_some_and(|all| all <= exact_up_to as u64);
        let count = if exact { all.unwrap_or_default() as usize } else { random + 1 };
        Self { sets, subjects: rows.nrows(), resampling, seed, count, exact }
    }

    /// Returns the relabellings with the indices `from..to`.
    pub(crate) fn range(&self, from: usize, to: usize) -> Vec<Relabelling> {
        (from..to).map(|index| if self.exact { self.numbered(index as u64) } else { self.random(index) }).collect()
    }

    /// Returns relabelling `index` of all possible ones. As the index grows, sign flips vary fastest, then the
    /// arrangements of the first set.
    fn numbered(&self, mut index: u64) -> Relabelling {
        let mut relabelling = identity(self.subjects);
        if self.resampling != Resampling::Permutations {
            let units = self.sets.iter().flat_map(|set| &set.units);
            for unit in units {
                let sign = if index & 1 == 1 { -1.0 } else { 1.0 };
                unit.iter().for_each(|i| relabelling[*i as usize].1 = sign);
                index >>= 1;
            }
        }
        if self.resampling != Resampling::SignFlips {
            for set in &self.sets {
                let arrangements = set.arrangements.unwrap_or(1);
                set.arrange(index % arrangements, &mut relabelling);
                index /= arrangements;
            }
        }
        relabelling
    }

    /// Returns the original labels for index 0, otherwise a random relabelling.
    fn random(&self, index: usize) -> Relabelling {
        let mut relabelling = identity(self.subjects);
        if index == 0 {
            return relabelling;
        }
        let mut random = self.stream(index);
        if self.resampling != Resampling::SignFlips {
            for set in &self.sets {
                let mut order: Vec<usize> = (0..set.units.len()).collect();
                for last in (1..order.len()).rev() {
                    order.swap(last, below(&mut random, last as u64 + 1) as usize);
                }
                set.units.iter().zip(order).for_each(|(unit, from)| put(unit, &set.units[from], &mut relabelling));
            }
        }
        if self.resampling != Resampling::Permutations {
            for unit in self.sets.iter().flat_map(|set| &set.units) {
                let sign = if random.next_u32() & 1 == 1 { -1.0 } else { 1.0 };
                unit.iter().for_each(|i| relabelling[*i as usize].1 = sign);
            }
        }
        relabelling
    }

    fn stream(&self, index: usize) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(index as u64);
        random
    }
}

/// Returns a uniformly distributed number below `bound`.
fn below(random: &mut ChaCha8Rng, bound: u64) -> u64 {
    // Numbers in the last, incomplete range of `bound` numbers are redrawn to avoid bias.
    let limit = u64::MAX - u64::MAX % bound;
    loop {
        let drawn = random.next_u64();
        if drawn < limit {
            return drawn % bound;
        }
    }
}

/// Returns `m! / (k_1! k_2! ...)` for counts k with sum m, or `None` if it exceeds a u64.
fn multinomial(counts: &[u64]) -> Option<u64> {
    let mut all = 1u64;
    let mut placed = 0u64;
    for count in counts {
        for among in 1..=*count {
            placed += 1;
            // The result is a product of binomial coefficients, which is an integer after each step.
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
    use super::super::blocks::{Blocks, Exchange, free};
    use super::*;
    use ndarray::Array2;
    use std::collections::HashSet;

    fn rows(classes: &[u32]) -> Array2<f64> {
        Array2::from_shape_fn((classes.len(), 1), |(i, _)| f64::from(classes[i]))
    }

    fn all_of(
        rows: ArrayView2<'_, f64>,
        resampling: Resampling,
        random: usize,
        exact_up_to: usize,
        seed: u64,
    ) -> Arrangements {
        Arrangements::new(rows, free(rows.nrows()), resampling, random, exact_up_to, seed)
    }

    #[test]
    fn all_relabellings_of_groups_are_there_once() {
        for classes in [vec![0, 0, 1, 1, 1], vec![0, 1, 2, 1], vec![1, 0, 1, 0, 2, 2]] {
            let all = all_of(rows(&classes).view(), Resampling::Permutations, 10, 20_000, 0);
            let labels = |relabelling: &Relabelling| -> Vec<u32> {
                relabelling.iter().map(|(i, _)| classes[*i as usize]).collect()
            };
            let found: HashSet<Vec<u32>> = all.range(0, all.count).iter().map(labels).collect();
            assert!(all.exact && found.len() == all.count && found.contains(&classes));
            let parts: Vec<_> = all.range(0, 3).into_iter().chain(all.range(3, all.count)).collect();
            assert_eq!(parts, all.range(0, all.count));
        }
        let ten = all_of(rows(&[0, 0, 0, 0, 0, 1, 1, 1, 1, 1]).view(), Resampling::Permutations, 10, 20_000, 0);
        assert_eq!(ten.count, 252);
    }

    #[test]
    fn random_relabellings_are_even_and_the_same_for_a_seed() {
        let classes: Vec<u32> = (0..40).collect();
        let random = all_of(rows(&classes).view(), Resampling::Permutations, 4_000, 20_000, 7);
        assert!(!random.exact && random.count == 4_001);
        let found = random.range(0, 4_001);
        assert!(found[0].iter().enumerate().all(|(i, (of, _))| i as u32 == *of));
        assert_eq!(found[100..200], random.range(100, 200)[..]);
        // Subject 0 is expected 100 times at each of the 40 positions. The tolerance of 50 is 5 standard deviations.
        let mut places = [0; 40];
        found[1..].iter().for_each(|order| places[order.iter().position(|(of, _)| *of == 0).unwrap()] += 1);
        assert!(places.iter().all(|&count| (50..150).contains(&count)), "{places:?}");
    }

    #[test]
    fn signs_are_all_or_random() {
        let ones = Array2::ones((5, 1));
        let all = all_of(ones.view(), Resampling::SignFlips, 10, 20_000, 0);
        let distinct: HashSet<String> = all.range(0, 32).iter().map(|signs| format!("{signs:?}")).collect();
        assert_eq!((all.count, distinct.len()), (32, 32));
        let many = all_of(Array2::ones((70, 1)).view(), Resampling::SignFlips, 10, 20_000, 0);
        assert!(!many.exact && many.range(0, 1)[0].iter().all(|(_, sign)| *sign == 1.0));
    }

    #[test]
    fn exchanges_and_signs_together_are_all_there_once() {
        let classes = [0, 1, 1, 1];
        let all = all_of(rows(&classes).view(), Resampling::Both, 10, 20_000, 0);
        let labels = |relabelling: &Relabelling| -> Vec<(u32, bool)> {
            relabelling.iter().map(|(from, sign)| (classes[*from as usize], *sign < 0.0)).collect()
        };
        let found: HashSet<_> = all.range(0, all.count).iter().map(labels).collect();
        assert!(all.exact && all.count == 4 * 16 && found.len() == 64);
        let parts: Vec<_> = all.range(0, 21).into_iter().chain(all.range(21, 64)).collect();
        assert_eq!(parts, all.range(0, 64));
        let many = all_of(rows(&[0; 30]).view(), Resampling::Both, 10, 20_000, 0);
        let found = many.range(0, 3);
        assert!(found[0].iter().enumerate().all(|(i, (of, sign))| (i as u32, 1.0) == (*of, *sign)));
        assert!(found[1].iter().any(|(_, sign)| *sign < 0.0) && found[1] != found[2]);
    }

    #[test]
    fn blocks_restrict_exchanges_and_join_signs() {
        let rows = rows(&[0, 1, 0, 1, 2, 2, 0, 1]);
        let names = ["a", "a", "b", "b", "c", "c", "d", "d"];
        let within = Blocks::new(names, Exchange::Within).sets();
        let all = Arrangements::new(rows.view(), within.clone(), Resampling::Permutations, 10, 20_000, 0);
        let found: HashSet<String> = all.range(0, all.count).iter().map(|of| format!("{of:?}")).collect();
        // The two observations of block c have equal rows, so exchanging them isn't counted.
        assert!(all.exact && all.count == 8 && found.len() == 8);
        for of in all.range(0, 8) {
            assert!(of.iter().enumerate().all(|(i, (from, _))| i / 2 == *from as usize / 2));
        }
        let whole = Blocks::new(names, Exchange::Whole).sets();
        let all = Arrangements::new(rows.view(), whole.clone(), Resampling::Permutations, 10, 20_000, 0);
        // Blocks a, b and d have equal rows, so only the four positions of block c are counted.
        assert_eq!(all.count, 4);
        assert!(all.range(0, 4).iter().flat_map(|of| of.chunks(2)).all(|pair| pair[0].0 + 1 == pair[1].0));
        let flips = Arrangements::new(rows.view(), whole, Resampling::SignFlips, 10, 20_000, 0);
        assert_eq!(flips.count, 16);
        assert!(flips.range(0, 16).iter().flat_map(|of| of.chunks(2)).all(|pair| pair[0].1 == pair[1].1));
        let random = Arrangements::new(rows.view(), within, Resampling::Both, 5, 10, 3);
        assert!(!random.exact && random.count == 6);
        for of in random.range(0, 6) {
            assert!(of.iter().enumerate().all(|(i, (from, _))| i / 2 == *from as usize / 2));
        }
    }
}
