//! Adds the moments of several parts of the samples.

use std::collections::BTreeMap;

use crate::accumulate::Warning;
use crate::moments::{Moments, Shard, Source};
use crate::{MomentsError, Source as PartSource};

/// Adds the moments of several parts of the samples. Except for rounding, the result doesn't depend on the order of the
/// parts. If `partial` is set, shards may be missing.
///
/// If all parts have the same sampling scheme, the sum has the key of that scheme. If the parts have different schemes,
/// or any part has no scheme, the sum has no scheme.
///
/// # Errors
///
/// [`MomentsError::Differ`] if the parts differ in degree or channels, [`MomentsError::Overlap`] if two parts have
/// samples in common, [`MomentsError::Missing`] if shards are missing and `partial` isn't set,
/// [`MomentsError::Versions`] if the numbers of the shards fit together but the shards belong to different tables or to
/// different versions of a table, and [`MomentsError::NoParts`] if the list is empty. Errors identify a part by its
/// number in the list, from 1.
pub fn merge(parts: Vec<Moments>, partial: bool) -> Result<Moments, MomentsError> {
    let names = (1..=parts.len()).map(|number| format!("part {number}")).collect();
    merge_named(parts.into_iter().map(Ok), names, partial)
}

/// Adds the moments of several parts as [`merge()`] does, but reads the parts one after another, so that at most two
/// parts are in memory at a time. Errors identify parts by their names.
///
/// # Errors
///
/// The errors of [`merge()`], and any error that the iterator returns instead of a part.
pub fn merge_named(
    parts: impl IntoIterator<Item = Result<Moments, MomentsError>>,
    names: Vec<String>,
    partial: bool,
) -> Result<Moments, MomentsError> {
    let mut all: Option<Moments> = None;
    let mut held: Vec<(PartSource, usize)> = Vec::new();
    for (number, part) in parts.into_iter().enumerate() {
        let part = part?;
        held.extend(part.sources.iter().map(|source| (source.clone(), number)));
        match &mut all {
            None => all = Some(part),
            Some(all) => {
                same_kind(all, &part, [&names[0], &names[number]])?;
                add(all, part);
            }
        }
    }
    let mut all = all.ok_or(MomentsError::NoParts)?;
    all.sources = joined(held, &names, partial)?;
    Ok(all)
}

/// Returns a warning for each part whose sums equal the sums of an earlier part. `hashes` has the result of
/// [`Moments::sums_hash`] for each part.
pub fn equal_sums(hashes: &[Option<[u8; 32]>], names: &[String]) -> Vec<Warning> {
    let known = |(number, hash): (usize, &Option<[u8; 32]>)| {
        let first = hashes[..number].iter().position(|other| hash.is_some() && other == hash)?;
        Some(Warning::EqualSums { first: names[first].clone(), second: names[number].clone() })
    };
    hashes.iter().enumerate().filter_map(known).collect()
}

fn same_kind(first: &Moments, second: &Moments, [a, b]: [&String; 2]) -> Result<(), MomentsError> {
    let differ = |what, expected: String, found: String| {
        let (first, second) = (a.clone(), b.clone());
        Err(MomentsError::Differ { what, first, second, expected, found })
    };
    if first.sums.max_degree != second.sums.max_degree {
        return differ("degrees", first.sums.max_degree.to_string(), second.sums.max_degree.to_string());
    }
    if first.channels != second.channels {
        return differ("channels", first.channels.join(", "), second.channels.join(", "));
    }
    Ok(())
}

fn add(all: &mut Moments, part: Moments) {
    all.rows += part.rows;
    all.scheme = all.scheme.filter(|_| all.scheme == part.scheme);
    all.occupied.merge(&part.occupied);
    let (all, part) = (&mut all.sums, part.sums);
    for (sum, value) in all.moments.iter_mut().zip(&part.moments) {
        *sum += value;
    }
    all.right_sides += &part.right_sides;
    for (sum, value) in all.squares.iter_mut().zip(&part.squares) {
        *sum += value;
    }
    all.count += part.count;
    all.weight += part.weight;
}

/// Returns the sources of all parts. If all shards of a source are present, they are replaced by one entry for the
/// entire source.
fn joined(held: Vec<(Source, usize)>, names: &[String], partial: bool) -> Result<Vec<Source>, MomentsError> {
    let mut by_key: BTreeMap<[u8; 32], Vec<(Source, usize)>> = BTreeMap::new();
    for (source, part) in held {
        by_key.entry(source.key).or_default().push((source, part));
    }
    let (mut joined, mut missing, mut incomplete) = (Vec::new(), Vec::new(), Vec::new());
    for (key, mut shards) in by_key {
        // Sort the shards by their start, which is a fraction of the source. `cmp_to` compares fractions exactly.
        shards.sort_by(|(a, _), (b, _)| start(a.shard).cmp_to(start(b.shard)));
        for pair in shards.windows(2) {
            let [(a, first), (b, second)] = pair else { continue };
            if end(a.shard).cmp_to(start(b.shard)).is_gt() {
                let (first, second) = (names[*first].clone(), names[*second].clone());
                let what = format!("samples of shard {}", shown(b.shard));
                return Err(MomentsError::Overlap { first, second, what });
            }
        }
        let rows = shards.iter().map(|(source, _)| source.rows).sum();
        let absent = absent(shards.iter().map(|(source, _)| source.shard));
        if absent.is_empty() {
            joined.push(Source { key, shard: Shard::WHOLE, rows });
        } else {
            joined.extend(shards.iter().map(|(source, _)| source.clone()));
            incomplete.extend(shards);
        }
        missing.extend(absent);
    }
    if missing.is_empty() || partial {
        return Ok(joined);
    }
    Err(match of_versions(incomplete) {
        Some([first, second]) => MomentsError::Versions { first: names[first].clone(), second: names[second].clone() },
        None => MomentsError::Missing { missing },
    })
}

/// Finds two adjacent shards with different keys, and returns their parts. Returns `None` unless the numbers of all
/// shards fit together, so that the shards would form one complete source if their keys were equal.
fn of_versions(mut shards: Vec<(Source, usize)>) -> Option<[usize; 2]> {
    shards.sort_by(|(a, _), (b, _)| start(a.shard).cmp_to(start(b.shard)));
    let mut reached = Fraction { above: 0, below: 1 };
    for (source, _) in &shards {
        if reached.cmp_to(start(source.shard)).is_ne() {
            return None;
        }
        reached = end(source.shard);
    }
    let whole = reached.cmp_to(Fraction { above: 1, below: 1 }).is_eq();
    let adjacent = |pair: &[(Source, usize)]| match pair {
        [(a, first), (b, second)] if a.key != b.key => Some([*first, *second]),
        _ => None,
    };
    whole.then(|| shards.windows(2).find_map(adjacent)).flatten()
}

impl Moments {
    /// Returns descriptions of the shards that the moments lack, such as `shard 1/2`. The list is empty if no shard is
    /// missing.
    pub fn missing_shards(&self) -> Vec<String> {
        let mut by_key: BTreeMap<[u8; 32], Vec<Shard>> = BTreeMap::new();
        for source in &self.sources {
            by_key.entry(source.key).or_default().push(source.shard);
        }
        let of_source = |mut shards: Vec<Shard>| {
            shards.sort_by(|a, b| start(*a).cmp_to(start(*b)));
            absent(shards.into_iter())
        };
        by_key.into_values().flat_map(of_source).collect()
    }
}

/// Returns descriptions of the shards of a source that are missing from `shards`. `shards` must be sorted by their
/// start.
fn absent(shards: impl Iterator<Item = Shard>) -> Vec<String> {
    let (mut reached, mut of, mut missing) = (Fraction { above: 0, below: 1 }, 1, Vec::new());
    for shard in shards {
        gap(reached, start(shard), shard.of, &mut missing);
        (reached, of) = (end(shard), shard.of);
    }
    gap(reached, Fraction { above: 1, below: 1 }, of, &mut missing);
    missing
}

/// Adds to `missing` a description of the shards between the fractions `from` and `to` of a source that is divided into
/// `of` shards. Adds nothing if `to` isn't above `from`.
fn gap(from: Fraction, to: Fraction, of: u32, missing: &mut Vec<String>) {
    if !from.cmp_to(to).is_lt() {
        return;
    }
    let first = u64::from(from.above) * u64::from(of) / u64::from(from.below);
    let last = (u64::from(to.above) * u64::from(of)).div_ceil(u64::from(to.below));
    missing.push(match last - first {
        1 => format!("shard {first}/{of}"),
        _ => format!("shards {first}/{of} to {}/{of}", last - 1),
    });
}

fn shown(shard: Shard) -> String {
    format!("{}/{}", shard.index, shard.of)
}

#[derive(Clone, Copy)]
struct Fraction {
    above: u32,
    below: u32,
}

impl Fraction {
    fn cmp_to(self, other: Self) -> std::cmp::Ordering {
        let product = |a: u32, b: u32| u64::from(a) * u64::from(b);
        product(self.above, other.below).cmp(&product(other.above, self.below))
    }
}

fn start(shard: Shard) -> Fraction {
    Fraction { above: shard.index, below: shard.of }
}

fn end(shard: Shard) -> Fraction {
    Fraction { above: shard.index + 1, below: shard.of }
}
