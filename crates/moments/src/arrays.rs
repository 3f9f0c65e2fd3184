//! Computes the moments of samples in memory. These samples may be one chunk of a larger set that the caller manages.
//!
//! Arrays are identified by a name that the caller gives to the larger set or, without a name, by all their bytes.
//! Tables are identified by their names, sizes, and first and last bytes. By this identification,
//! [`merge`](mod@crate::merge) detects missing and repeated chunks, as it does for shards of tables. The computation
//! needs memory for an [`Accumulator`] and one chunk of converted samples.

use ndarray::{ArrayView1, ArrayView2, Axis, s};
use rayon::prelude::*;
use spharm_harmonics::directions::normalise;
use spharm_monitor::{Monitor, Stage};
use spharm_transform::{Accumulated as Found, Accumulator};

use crate::MomentsError;
use crate::moments::{Moments, Shard, Source};

const KEY_CONTEXT: &str = "spharm-rs 2026-11 samples in memory v1";
/// Number of samples converted at a time.
const CHUNK: usize = 1 << 18;

/// Samples in memory. The arrays may have any strides.
#[derive(Debug, Clone, Copy)]
pub struct Samples<'a> {
    /// n vectors of any nonzero length, an array of shape (n, 3).
    pub directions: ArrayView2<'a, f64>,
    /// Values of the n samples in c channels, an array of shape (n, c), all finite.
    pub values: ArrayView2<'a, f64>,
    /// Weights of the n samples, finite and nonnegative; `None` if all weights are 1.
    pub weights: Option<ArrayView1<'a, f64>>,
}

/// Identifies the samples in memory as a part of a larger set.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    /// Name of the larger set. With `None` (default), the samples aren't a part of a named set, and are identified by a
    /// hash of their own bytes.
    pub whole: Option<String>,
    /// The shard of the larger set that consists of these samples.
    pub shard: Shard,
}

impl Default for Part {
    fn default() -> Self {
        Self { whole: None, shard: Shard::WHOLE }
    }
}

/// Computes the moments of samples in memory, for fits of degrees up to `max_degree`. `channels` lists the names of the
/// c channels.
///
/// Reports the stage `moments`, counted in samples, to the monitor. A part without samples is valid, so a set may be
/// divided into more parts than it has samples.
///
/// # Errors
///
/// [`MomentsError::Arrays`] if the sizes of the arrays don't match, [`MomentsError::Sample`] if a sample is invalid,
/// [`MomentsError::Shard`] if the shard is invalid, [`MomentsError::Transform`] if the degree is too high,
/// [`MomentsError::Range`] if a sum is outside the range of f64, and [`MomentsError::Interrupted`] if `monitor` cancels
/// the computation.
pub fn accumulate_samples(
    samples: &Samples<'_>,
    channels: Vec<String>,
    max_degree: usize,
    part: &Part,
    monitor: &dyn Monitor,
) -> Result<Moments, MomentsError> {
    part.shard.check()?;
    samples.check(channels.len())?;
    let mut sums = Accumulator::new(max_degree, channels.len())?;
    let n = samples.directions.nrows();
    monitor.begin(Stage::counted("moments", "rows"), n as u64);
    for start in (0..n).step_by(CHUNK) {
        monitor.check()?;
        let rows = start..n.min(start + CHUNK);
        let directions = samples.directions.slice(s![rows.clone(), ..]);
        let values = samples.values.slice(s![rows.clone(), ..]);
        let weights = samples.weights.map(|weights| weights.slice_move(s![rows.clone()]));
        let directions = units(directions, start)?;
        let weights = weights.map(|weights| checked_weights(weights, start)).transpose()?;
        check_values(values, start)?;
        sums.add(&directions, weights.as_deref(), values)?;
        monitor.step(rows.len() as u64);
    }
    monitor.end();
    let Found { sums, rows, occupied } = sums.finish()?;
    let sources = vec![Source { key: samples.key(part), shard: part.shard, rows }];
    let moments = Moments { channels, sums, rows, occupied, scheme: None, sources };
    match moments.out_of_range() {
        Some(channel) => Err(MomentsError::Range { channel: channel.to_owned() }),
        None => Ok(moments),
    }
}

fn units(directions: ArrayView2<'_, f64>, start: usize) -> Result<Vec<[f64; 3]>, MomentsError> {
    let vector = |row: usize| [0, 1, 2].map(|i| directions[[row, i]]);
    let mut units = vec![[0.0; 3]; directions.nrows()];
    let bad = units.par_iter_mut().enumerate().filter_map(|(row, unit)| match normalise(vector(row), row) {
        Ok((found, _)) => {
            *unit = found;
            None
        }
        Err(_) => Some(row),
    });
    // Report the invalid sample with the lowest index, so that the error doesn't depend on the timing of the threads.
    match bad.min() {
        None => Ok(units),
        Some(row) => Err(MomentsError::Sample {
            row: start + row,
            what: "direction",
            expected: "a finite vector that isn't zero",
            found: format!("{:?}", vector(row)),
        }),
    }
}

fn checked_weights(weights: ArrayView1<'_, f64>, start: usize) -> Result<Vec<f64>, MomentsError> {
    match weights.iter().position(|weight| !(weight.is_finite() && *weight >= 0.0)) {
        None => Ok(weights.to_vec()),
        Some(row) => Err(MomentsError::Sample {
            row: start + row,
            what: "weight",
            expected: "a finite number, at least 0",
            found: weights[row].to_string(),
        }),
    }
}

fn check_values(values: ArrayView2<'_, f64>, start: usize) -> Result<(), MomentsError> {
    match values.indexed_iter().find(|(_, value)| !value.is_finite()) {
        None => Ok(()),
        Some(((row, _), value)) => Err(MomentsError::Sample {
            row: start + row,
            what: "value",
            expected: "a finite number",
            found: value.to_string(),
        }),
    }
}

impl Samples<'_> {
    fn check(&self, channels: usize) -> Result<(), MomentsError> {
        let n = self.directions.nrows();
        for (what, expected, found) in [
            ("columns of the directions", 3, self.directions.ncols()),
            ("values", n, self.values.nrows()),
            ("weights", n, self.weights.map_or(n, |weights| weights.len())),
            ("channels of the values", channels, self.values.ncols()),
            ("channels of the values", channels.clamp(1, Moments::MOST_CHANNELS), channels),
        ] {
            if expected != found {
                return Err(MomentsError::Arrays { what, expected, found });
            }
        }
        Ok(())
    }

    /// Returns the hash that identifies the samples; see "Keys" in `docs/moments-format.md`.
    fn key(&self, part: &Part) -> [u8; 32] {
        let mut key = blake3::Hasher::new_derive_key(KEY_CONTEXT);
        match &part.whole {
            Some(name) => {
                key.update(&1u64.to_le_bytes());
                key.update(&(name.len() as u64).to_le_bytes());
                key.update(name.as_bytes());
            }
            None => {
                let weighted = usize::from(self.weights.is_some());
                for number in [0, self.directions.nrows(), self.values.ncols(), weighted] {
                    key.update(&(number as u64).to_le_bytes());
                }
                let weights = self.weights.map(|weights| weights.insert_axis(Axis(1)));
                for array in [Some(self.directions), Some(self.values), weights].into_iter().flatten() {
                    for values in array.axis_chunks_iter(Axis(0), 1 << 10) {
                        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
                        key.update(&bytes);
                    }
                }
            }
        }
        *key.finalize().as_bytes()
    }
}

#[cfg(test)]
mod tests {
    use ndarray::{Array1, Array2};
    use spharm_monitor::Silent;

    use super::*;
    use crate::merge;

    fn arrays(n: usize) -> (Array2<f64>, Array2<f64>, Array1<f64>) {
        let at = |i: usize, j: usize| ((i * (j + 3) + j) as f64).sin();
        let directions = Array2::from_shape_fn((n, 3), |(i, j)| 3.0 * at(i, j));
        (directions, Array2::from_shape_fn((n, 2), |(i, j)| at(i, j + 5)), Array1::from_shape_fn(n, |i| (i % 3) as f64))
    }

    fn names() -> Vec<String> {
        vec!["a".to_owned(), "b".to_owned()]
    }

    fn part(index: u32, of: u32) -> Part {
        Part { whole: Some("whole".to_owned()), shard: Shard { index, of } }
    }

    #[test]
    fn parts_add_up_to_the_whole_and_only_once() {
        let (directions, values, weights) = arrays(700);
        let of = |rows: std::ops::Range<usize>, part: &Part| {
            let samples = Samples {
                directions: directions.slice(s![rows.clone(), ..]),
                values: values.slice(s![rows.clone(), ..]),
                weights: Some(weights.slice(s![rows])),
            };
            accumulate_samples(&samples, names(), 6, part, &Silent).unwrap()
        };
        let whole = of(0..700, &part(0, 1));
        // The second part is empty.
        let parts = [of(0..300, &part(0, 3)), of(300..300, &part(1, 3)), of(300..700, &part(2, 3))];
        let all = merge(parts.to_vec(), false).unwrap();
        assert_eq!((all.rows, &all.sources), (whole.rows, &whole.sources));
        let off = all.sums.moments.iter().zip(&whole.sums.moments).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-11, "{off:e}");
        assert!(matches!(merge(parts[1..].to_vec(), false), Err(MomentsError::Missing { .. })));
        let twice = vec![parts[0].clone(), parts[0].clone()];
        assert!(matches!(merge(twice, true), Err(MomentsError::Overlap { .. })));
        // Without a name, the samples are identified by their bytes.
        let [a, b] = [0..300, 300..700].map(|rows| of(rows, &Part::default()));
        assert!(merge(vec![a.clone(), b], false).is_ok());
        assert!(matches!(merge(vec![a.clone(), a], false), Err(MomentsError::Overlap { .. })));
    }

    #[test]
    fn bad_samples_are_named() {
        let (directions, values, weights) = arrays(20);
        let (mut origin, mut nan, mut negative) = (directions.clone(), values.clone(), weights.clone());
        origin.row_mut(7).fill(0.0);
        nan[[5, 1]] = f64::NAN;
        negative[19] = -1.0;
        let fails = |directions: &Array2<f64>, values: &Array2<f64>, weights: &Array1<f64>| {
            let samples =
                Samples { directions: directions.view(), values: values.view(), weights: Some(weights.view()) };
            accumulate_samples(&samples, names(), 2, &Part::default(), &Silent).unwrap_err().to_string()
        };
        assert!(fails(&origin, &values, &weights).contains("sample 7: direction"));
        assert!(fails(&directions, &nan, &weights).contains("sample 5: value"));
        assert!(fails(&directions, &values, &negative).contains("sample 19: weight"));
        assert!(fails(&directions, &values.slice(s![..9, ..]).to_owned(), &weights).contains("expected 20, found 9"));
        assert!(fails(&directions, &Array2::zeros((20, 3)), &weights).contains("channels"));
    }
}
