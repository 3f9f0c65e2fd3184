//! Computes the key of a sampling scheme: a hash of everything that its files in a store depend on.
//!
//! See "Key" in `store-format.md`.

use std::fmt;
use std::str::FromStr;

use spharm_harmonics::Directions;

/// Scalar type of the stored harmonics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Scalar {
    /// IEEE double precision.
    F64,
    /// IEEE single precision: half the size of double precision, with a relative rounding error of at most 6e-8.
    F32,
}

impl Scalar {
    /// Returns the size of a value in bytes.
    pub const fn size(self) -> usize {
        match self {
            Self::F64 => 8,
            Self::F32 => 4,
        }
    }

    /// Returns `"f64"` or `"f32"`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::F64 => "f64",
            Self::F32 => "f32",
        }
    }

    /// Returns the code of the scalar type in file headers.
    pub(crate) const fn code(self) -> u32 {
        match self {
            Self::F64 => 1,
            Self::F32 => 2,
        }
    }

    pub(crate) const fn from_code(code: u32) -> Option<Self> {
        match code {
            1 => Some(Self::F64),
            2 => Some(Self::F32),
            _ => None,
        }
    }
}

/// BLAKE3 hash that identifies a sampling scheme. Its 64 hexadecimal digits are the name of the scheme's folder in a
/// store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SchemeKey(pub [u8; 32]);

const CONTEXT: &str = "spharm-rs 2026-11 sampling scheme key v1";

/// Number of coordinates hashed at a time: 2 MiB of f64, enough to occupy several threads.
const PART: usize = 1 << 18;

impl SchemeKey {
    /// Computes the key of the harmonics of type `scalar` at `directions`. The order of the directions matters.
    pub fn of(directions: &Directions, scalar: Scalar) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key(CONTEXT);
        let head = |hasher: &mut blake3::Hasher, tag: &str, bytes: usize| {
            hasher.update(&(tag.len() as u64).to_le_bytes());
            hasher.update(tag.as_bytes());
            hasher.update(&(bytes as u64).to_le_bytes());
        };
        let coordinates = directions.as_slice().as_flattened();
        let count = (directions.len() as u64).to_le_bytes();
        let fields: [(&str, &[u8]); 4] = [
            ("normalisation", b"real orthonormal, no Condon-Shortley phase"),
            ("ordering", b"l^2 + l + m"),
            ("scalar", scalar.name().as_bytes()),
            ("count", &count),
        ];
        for (tag, value) in fields {
            head(&mut hasher, tag, value.len());
            hasher.update(value);
        }
        head(&mut hasher, "directions", 8 * coordinates.len());
        let mut bytes = vec![0; 8 * coordinates.len().min(PART)];
        for part in coordinates.chunks(PART) {
            let bytes = &mut bytes[..8 * part.len()];
            // Adding 0 turns -0 into +0. `Directions` contains neither NaN nor infinity.
            let (words, _) = bytes.as_chunks_mut();
            words.iter_mut().zip(part).for_each(|(word, &c)| *word = (c + 0.0).to_bits().to_le_bytes());
            // Outside a thread pool, rayon would use its global pool, whose threads don't exist in a forked process.
            match rayon::current_thread_index() {
                Some(_) => hasher.update_rayon(bytes),
                None => hasher.update(bytes),
            };
        }
        Self(*hasher.finalize().as_bytes())
    }

    /// Returns the first 12 hexadecimal digits, for display.
    pub fn short(&self) -> String {
        self.to_string()[..12].to_owned()
    }
}

impl fmt::Display for SchemeKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Error for a string that isn't a valid [`SchemeKey`], which has 64 lower-case hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected 64 hexadecimal digits")]
pub struct NotAKey;

impl FromStr for SchemeKey {
    type Err = NotAKey;

    fn from_str(text: &str) -> Result<Self, NotAKey> {
        if text.len() != 64 || !text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f')) {
            return Err(NotAKey);
        }
        let mut key = [0; 32];
        for (byte, digits) in key.iter_mut().zip(text.as_bytes().chunks_exact(2)) {
            let digit = |d: u8| if d.is_ascii_digit() { d - b'0' } else { d - b'a' + 10 };
            *byte = digit(digits[0]) << 4 | digit(digits[1]);
        }
        Ok(Self(key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn octahedron(radius: f64) -> Directions {
        let r = radius;
        let vertices = [[r, 0.0, 0.0], [-r, 0.0, 0.0], [0.0, r, 0.0], [0.0, -r, 0.0], [0.0, 0.0, r], [0.0, 0.0, -r]];
        Directions::from_vertices(&vertices).unwrap()
    }

    #[test]
    fn text_and_back() {
        let key = SchemeKey::of(&octahedron(1.0), Scalar::F64);
        assert_eq!(key.to_string().parse(), Ok(key));
        assert_eq!("xyz".parse::<SchemeKey>(), Err(NotAKey));
        assert_eq!(key.to_string().to_uppercase().parse::<SchemeKey>(), Err(NotAKey));
        for text in ["g".repeat(64), "0".repeat(63), "0".repeat(65)] {
            assert_eq!(text.parse::<SchemeKey>(), Err(NotAKey), "{text}");
        }
        let digits = "0123456789abcdef".repeat(4);
        let bytes = [0x01, 0x23, 0x45, 0x67, 0x89, 0xab, 0xcd, 0xef].repeat(4);
        let key: SchemeKey = digits.parse().unwrap();
        assert_eq!((&key.0[..], key.to_string(), key.short()), (&bytes[..], digits, "0123456789ab".to_owned()));
    }

    #[test]
    fn scalars_are_known_by_name_and_number() {
        for (scalar, name, size, code) in [(Scalar::F64, "f64", 8, 1), (Scalar::F32, "f32", 4, 2)] {
            assert_eq!((scalar.name(), scalar.size(), scalar.code()), (name, size, code));
            assert_eq!(Scalar::from_code(code), Some(scalar));
        }
        assert_eq!((Scalar::from_code(0), Scalar::from_code(3)), (None, None));
    }

    #[test]
    fn radius_and_sign_of_zero_do_not_count_but_scalar_and_order_do() {
        let key = SchemeKey::of(&octahedron(1.0), Scalar::F64);
        assert_eq!(SchemeKey::of(&octahedron(100.0), Scalar::F64), key);
        assert_ne!(SchemeKey::of(&octahedron(1.0), Scalar::F32), key);
        let mut vertices = octahedron(1.0).as_slice().to_vec();
        vertices[0][1] = -0.0;
        assert_eq!(SchemeKey::of(&Directions::from_vertices(&vertices).unwrap(), Scalar::F64), key);
        vertices.swap(0, 1);
        assert_ne!(SchemeKey::of(&Directions::from_vertices(&vertices).unwrap(), Scalar::F64), key);
    }
}
