//! Counts directions that repeat earlier ones.
//!
//! Each direction is hashed. The hashes are sorted into buckets by their leading bits, so that the bit table of one
//! bucket stays in a core's cache; lookups in a single table for all directions would be as slow as accesses to main
//! memory. Only directions whose hash occurs twice are compared.

use rayon::prelude::*;

/// Number of directions per parallel task.
const PART: usize = 1 << 13;
/// Largest average number of hashes per bucket. A bucket's table of 16 bits per hash then fits in the second-level
/// cache.
const BUCKET: usize = 1 << 16;
/// Largest number of buckets. With more buckets, each part of the directions would have too few hashes per bucket.
const MOST_BUCKETS: usize = 256;

/// Returns the number of directions that repeat an earlier one, bit for bit, with -0 equal to 0. Cost: one pass over
/// the directions by all threads of the caller's pool, and 9 bytes per direction.
pub(crate) fn count(vectors: &[[f64; 3]]) -> usize {
    let buckets = vectors.len().div_ceil(BUCKET).next_power_of_two().min(MOST_BUCKETS);
    let parts = map(vectors.chunks(PART).collect(), |part: &[[f64; 3]]| Part::of(part, buckets));
    let repeated = map((0..buckets).collect(), |bucket: usize| repeated(&parts, bucket));
    drop(parts);
    let mut repeated = repeated.concat();
    if repeated.is_empty() {
        return 0;
    }
    repeated.sort_unstable();
    // Different directions may share a hash, so their coordinates are compared.
    let of_repeated = |v: &&[f64; 3]| repeated.binary_search(&hash(v)).is_ok();
    let keys = map(vectors.chunks(PART).collect(), |part: &[[f64; 3]]| {
        part.iter().filter(of_repeated).map(key).collect::<Vec<_>>()
    });
    let mut keys = keys.concat();
    keys.sort_unstable();
    keys.windows(2).filter(|pair| pair[0] == pair[1]).count()
}

/// Maps items on all threads of the caller's rayon pool, or on the current thread if the caller isn't in a pool.
/// Otherwise rayon would use its global pool, whose threads don't exist in a forked process.
fn map<I: Send, T: Send>(items: Vec<I>, map: impl Fn(I) -> T + Send + Sync) -> Vec<T> {
    if rayon::current_thread_index().is_some() {
        items.into_par_iter().map(map).collect()
    } else {
        items.into_iter().map(map).collect()
    }
}

fn key(v: &[f64; 3]) -> [u64; 3] {
    v.map(|c| (c + 0.0).to_bits())
}

fn hash(v: &[f64; 3]) -> u64 {
    // Multiplication by odd numbers spreads the bits of the mantissas upwards.
    let [x, y, z] = key(v).map(|word| word ^ word >> 32);
    let mixed = (x.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ y).wrapping_mul(0xbf58_476d_1ce4_e5b9) ^ z;
    mixed.wrapping_mul(0x94d0_49bb_1331_11eb)
}

/// Returns the `bits` leading bits of a hash.
fn leading(hash: u64, bits: u32) -> usize {
    // The shift is in two steps, because a single shift by 64 bits, for `bits` equal to 0, would overflow.
    (hash >> 1 >> (63 - bits)) as usize
}

/// Hashes of a run of consecutive directions, sorted into buckets.
struct Part {
    hashes: Vec<u64>,
    /// Position of the first hash of each bucket, followed by the total number of hashes.
    starts: Vec<u32>,
}

impl Part {
    /// Hashes directions and sorts the hashes into `buckets` buckets, a power of two.
    fn of(vectors: &[[f64; 3]], buckets: usize) -> Self {
        let bits = buckets.trailing_zeros();
        let unsorted: Vec<u64> = vectors.iter().map(hash).collect();
        let mut starts = vec![0_u32; buckets + 1];
        unsorted.iter().for_each(|&hash| starts[leading(hash, bits) + 1] += 1);
        for bucket in 0..buckets {
            starts[bucket + 1] += starts[bucket];
        }
        let (mut next, mut hashes) = (starts.clone(), vec![0; unsorted.len()]);
        for hash in unsorted {
            let slot = &mut next[leading(hash, bits)];
            hashes[*slot as usize] = hash;
            *slot += 1;
        }
        Self { hashes, starts }
    }

    fn bucket(&self, bucket: usize) -> &[u64] {
        &self.hashes[self.starts[bucket] as usize..self.starts[bucket + 1] as usize]
    }
}

/// Returns the distinct hashes that occur more than once in a bucket.
fn repeated(parts: &[Part], bucket: usize) -> Vec<u64> {
    let hashes = || parts.iter().flat_map(|part| part.bucket(bucket).iter().copied());
    let mut taken = BitSet::new(16 * hashes().count());
    // Hashes whose bit has already been set by an earlier hash: about one hash in 32, if no direction repeats.
    let later: Vec<u64> = hashes().filter(|&hash| !taken.insert(hash)).collect();
    if later.is_empty() {
        return later;
    }
    let mut shared = BitSet::new(32 * later.len());
    for &hash in &later {
        shared.insert(taken.place(hash));
    }
    let mut among: Vec<u64> = hashes().filter(|&hash| shared.contains(taken.place(hash))).collect();
    among.sort_unstable();
    let mut repeated: Vec<u64> = among.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| pair[0]).collect();
    repeated.dedup();
    repeated
}

/// An approximate set of hashes. Each hash sets one bit of a table, and several hashes may share a bit.
struct BitSet {
    words: Vec<u64>,
    bits: u32,
}

impl BitSet {
    /// Creates an empty set with a table of `bits` bits, rounded up to a power of two, at least 64.
    fn new(bits: usize) -> Self {
        let bits = bits.next_power_of_two().max(64);
        Self { words: vec![0; bits / 64], bits: bits.trailing_zeros() }
    }

    /// Returns a new hash, for use in a smaller set. Hashes that share a bit in this set get equal new hashes.
    fn place(&self, hash: u64) -> u64 {
        (self.bit(hash) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
    }

    /// Returns the index of a hash's bit. All hashes of a bucket have the same leading bits, so the bits are mixed
    /// first.
    fn bit(&self, hash: u64) -> usize {
        leading(hash.wrapping_mul(0xd6e8_feb8_6659_fd93), self.bits)
    }

    /// Adds a hash and returns whether its bit was unset before.
    fn insert(&mut self, hash: u64) -> bool {
        let place = self.bit(hash);
        let (bit, word) = (1 << (place % 64), &mut self.words[place / 64]);
        let unset = *word & bit == 0;
        *word |= bit;
        unset
    }

    fn contains(&self, hash: u64) -> bool {
        let place = self.bit(hash);
        self.words[place / 64] >> (place % 64) & 1 == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts repeated directions among many different directions, in several buckets, and counts directions that are
    /// all equal.
    #[test]
    fn repeated_directions_are_counted_in_every_bucket() {
        let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let point = |i: usize| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / 200_000.0;
            let (sine, phi) = ((1.0 - z * z).sqrt(), golden * i as f64);
            [sine * phi.cos(), sine * phi.sin(), z]
        };
        let mut vectors: Vec<[f64; 3]> = (0..200_000).map(point).collect();
        assert_eq!(count(&vectors), 0);
        vectors.extend((0..200_000).step_by(3).map(point));
        vectors.push(point(3));
        assert_eq!(count(&vectors), 200_000_usize.div_ceil(3) + 1);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        assert_eq!(pool.install(|| count(&vectors)), 200_000_usize.div_ceil(3) + 1);
        assert_eq!(count(&vec![[0.0, 0.0, 1.0]; 150_000]), 149_999);
        assert_eq!(count(&[[0.0, 0.0, 1.0], [-0.0, 0.0, 1.0]]), 1);
    }
}
