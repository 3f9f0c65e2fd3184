//! Headers of NumPy's array files (`.npy`), versions 1 to 3.
//!
//! Magic, version, length of the header, the header: a Python dictionary of type, order and shape. The values follow. Source:
//! NumPy Enhancement Proposal 1, and `numpy.lib.format`.

use std::io::{self, Read};

/// What such a file begins with.
pub const MAGIC: &[u8] = b"\x93NUMPY";
/// NumPy's own limit is 10,000 characters.
const LONGEST: usize = 1 << 16;

/// What an array's header says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Kind of the values, as NumPy has it: `f`, `i`, `u`, `c`, `b`, `U`.
    pub kind: char,
    /// Bytes of a value.
    pub size: usize,
    /// Whether the least significant byte comes first.
    pub little: bool,
    /// Whether the first index runs fastest.
    pub fortran: bool,
    /// Lengths of the axes.
    pub shape: Vec<usize>,
}

impl Header {
    /// Reads a header, and leaves the input where the values begin.
    ///
    /// # Errors
    ///
    /// Those of `input`; [`InvalidData`](io::ErrorKind::InvalidData) for anything but such a header.
    pub fn read(input: &mut dyn Read) -> io::Result<Self> {
        let invalid = |text: String| io::Error::new(io::ErrorKind::InvalidData, text);
        let mut start = [0; 8];
        input.read_exact(&mut start)?;
        let length = match start {
            [magic @ .., 1, _] if magic == MAGIC => {
                let mut length = [0; 2];
                input.read_exact(&mut length)?;
                u16::from_le_bytes(length).into()
            }
            [magic @ .., 2 | 3, _] if magic == MAGIC => {
                let mut length = [0; 4];
                input.read_exact(&mut length)?;
                u32::from_le_bytes(length) as usize
            }
            _ => return Err(invalid("not a NumPy array of version 1 to 3".to_owned())),
        };
        if length > LONGEST {
            return Err(invalid("its header is too long".to_owned()));
        }
        let mut text = vec![0; length];
        input.read_exact(&mut text)?;
        let text = String::from_utf8(text).map_err(|_| invalid("its header isn't text".to_owned()))?;
        Self::parse(&text).ok_or_else(|| invalid(format!("the header {text:?} is not understood")))
    }

    fn parse(text: &str) -> Option<Self> {
        let value = |key: &str| Some(text.split_once(&format!("'{key}':"))?.1.trim_start());
        let descr = value("descr")?.strip_prefix('\'')?.split_once('\'')?.0;
        let order = descr.chars().next()?;
        let descr = descr.trim_start_matches(['<', '>', '|', '=']);
        let kind = descr.chars().next()?;
        let size: usize = descr.get(kind.len_utf8()..)?.parse().ok()?;
        let shape = value("shape")?.strip_prefix('(')?.split_once(')')?.0;
        let shape = shape.split(',').map(str::trim).filter(|n| !n.is_empty());
        Some(Self {
            kind,
            // Characters have four bytes.
            size: if kind == 'U' { size.checked_mul(4)? } else { size },
            little: order != '>',
            fortran: value("fortran_order")?.starts_with("True"),
            shape: shape.map(|n| n.parse().ok()).collect::<Option<_>>()?,
        })
    }

    /// Returns the bytes of all values; `None` where there are more than can be.
    #[must_use]
    pub fn bytes(&self) -> Option<u64> {
        self.shape.iter().try_fold(self.size as u64, |product, &n| product.checked_mul(n as u64))
    }
}
