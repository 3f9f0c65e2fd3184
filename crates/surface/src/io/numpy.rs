//! Reads values on vertices from NumPy arrays (`.npy`): an element per vertex, or a row per vertex and a column per
//! channel. Arrays with three axes are volumes, which [`volume`](super::volume) recognises.

use super::bytes::{Cursor, Endian};
use super::flaw::{Flaw, bounded};
use super::scalar::Scalar;
use crate::mesh::Signal;
use crate::npy::{Header, MAGIC};

/// Name of the format in messages.
pub(super) const NAME: &str = "a NumPy array";

/// Returns whether the bytes begin like a NumPy file. Its array may be a volume.
pub(super) fn is_array(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
}

/// Returns the header of an array with one or two axes; `None` for other files.
pub(super) fn header(mut bytes: &[u8]) -> Option<Header> {
    let header = if is_array(bytes) { Header::read(&mut bytes).ok() } else { None };
    header.filter(|header| matches!(header.shape.len(), 1 | 2))
}

/// Reads the values of an array with one or two axes.
pub(super) fn read(bytes: &[u8], header: &Header) -> Result<Signal, Flaw> {
    let scalar = Scalar::of_numpy(header.kind, header.size).ok_or_else(|| {
        let found = format!("values of type {}{}", header.kind, header.size);
        Flaw::unsupported(found, "convert the array with astype(float)")
    })?;
    let (vertices, channels) = match header.shape[..] {
        [vertices] => (vertices, 1),
        [vertices, channels] => (vertices, channels),
        _ => return Err(Flaw::new("one or two axes", format!("shape {:?}", header.shape))),
    };
    let mut cursor = Cursor::new(bytes);
    cursor.take(usize::try_from(header.start).unwrap_or(usize::MAX))?;
    let count = bounded(header.count().unwrap_or(u64::MAX), scalar.size(), cursor.remaining(), "values")?;
    if cursor.remaining() > count * scalar.size() {
        return Err(Flaw::new(format!("{count} values, as stated in the header"), "more bytes"));
    }
    let endian = if header.little { Endian::Little } else { Endian::Big };
    let mut values = vec![0.0; count];
    for at in 0..count {
        // In Fortran order, the values of a channel are contiguous.
        let place = if header.fortran { at % vertices * channels + at / vertices } else { at };
        values[place] = scalar.read(&mut cursor, endian)?;
    }
    Ok(Signal { values, vertices, channels })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the bytes of a NumPy file of format version 1.
    fn file(header: &str, values: &[u8]) -> Vec<u8> {
        [MAGIC, &[1, 0], &(header.len() as u16).to_le_bytes(), header.as_bytes(), values].concat()
    }

    fn parsed(bytes: &[u8]) -> Result<Signal, Flaw> {
        read(bytes, &header(bytes).expect("an array"))
    }

    #[test]
    fn arrays_of_one_and_two_axes_are_values() {
        let six: Vec<u8> = (0..6_i16).flat_map(i16::to_be_bytes).collect();
        for (shape, order, expected) in [
            ("(6,)", "False", Signal::new(vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0], 6, 1)),
            ("(3, 2)", "False", Signal::new(vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0], 3, 2)),
            ("(3, 2)", "True", Signal::new(vec![0.0, 3.0, 1.0, 4.0, 2.0, 5.0], 3, 2)),
        ] {
            let bytes = file(&format!("{{'descr': '>i2', 'fortran_order': {order}, 'shape': {shape}, }}"), &six);
            assert_eq!(parsed(&bytes).unwrap(), expected, "{shape} {order}");
        }
        let bytes = file("{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}", &f64::NAN.to_le_bytes());
        assert!(parsed(&bytes).unwrap().values[0].is_nan());
        let volume = file("{'descr': '|u1', 'fortran_order': False, 'shape': (1, 1, 1)}", &[1]);
        assert!(header(&volume).is_none() && header(MAGIC).is_none() && header(b"1,2\n").is_none());
    }

    #[test]
    fn damaged_arrays_are_refused() {
        let of = |kind: &str, shape: &str, values: &[u8]| {
            let flaw =
                parsed(&file(&format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}}}"), values));
            flaw.unwrap_err().at("d.npy".as_ref(), NAME).to_string()
        };
        assert!(of("<f4", "(2,)", &[0; 7]).contains("only 7 bytes"));
        assert!(of("<f4", "(2,)", &[0; 9]).contains("expected 2 values, as stated in the header, found more bytes"));
        assert!(of("<f4", "(4294967296, 4294967296)", &[0; 8]).contains("only 8 bytes"));
        assert!(of("<f2", "(2,)", &[0; 4]).contains("values of type f2 is not supported"));
    }
}
