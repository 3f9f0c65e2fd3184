//! Tests damaged and hostile compressed models.

use proptest::prelude::*;
use spharm_monitor::Silent;
use spharm_shape::codec::{CodecError, CompressParams, Compressed, Target, compress, expand};

use super::{PREFIX, WHOLE, surface};

/// Returns the file with a modified header, whose checksum is valid.
fn forge(file: &Compressed, change: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut head = file.bytes[..file.head - 4].to_vec();
    change(&mut head);
    let length = (head.len() + 4) as u32;
    head[6..10].copy_from_slice(&length.to_le_bytes());
    let crc = crc32c::crc32c(&head);
    head.extend(crc.to_le_bytes());
    head.extend(&file.bytes[file.head..]);
    head
}

#[test]
fn hostile_heads_are_refused() {
    let file = compress(
        &surface(6),
        &CompressParams { provenance: false, ..CompressParams::new(Target::Step(1e-3)) },
        &Silent,
    )
    .unwrap();
    assert!(expand(&forge(&file, |_| {}), &WHOLE).is_ok());
    let varint = |number: u64| {
        let mut bytes: Vec<u8> = (0..9).map(|i| (number >> (7 * i)) as u8 | 128).collect();
        bytes.push((number >> 63) as u8);
        bytes
    };
    let refuse = |what: &str, bytes: Vec<u8>| match expand(&bytes, &PREFIX) {
        Err(error) => assert!(error.to_string().contains(what), "{what}: {error}"),
        Ok(_) => panic!("{what}"),
    };
    // The header's highest degree L, number of channels c, highest degree T of the stream and guess g take one byte
    // each.
    for (at, what) in [(10, "highest degree"), (11, "channels"), (12, "of the stream"), (13, "mean magnitude")] {
        for number in [u64::MAX, 1 << 40, 1 << 32, 2001, 65_537] {
            refuse(what, forge(&file, |head| drop(head.splice(at..=at, varint(number)))));
        }
    }
    refuse("number of coefficients", forge(&file, |head| drop(head.splice(10..11, [0xd0, 0x0f]))));
    refuse("flags", forge(&file, |head| head[5] = 7));
    refuse("step", forge(&file, |head| head[16..24].copy_from_slice(&f64::NAN.to_le_bytes())));
    refuse("step", forge(&file, |head| head[16..24].copy_from_slice(&(-1.0f64).to_le_bytes())));
    refuse("finite", forge(&file, |head| head[16..24].copy_from_slice(&f64::MAX.to_le_bytes())));
    refuse("0 bytes after the last field", forge(&file, |head| head.push(0)));
    refuse("bytes", forge(&file, |head| head.truncate(20)));
    refuse(
        "zlib",
        forge(&file, |head| {
            head[5] = 3;
            head.extend([5, 1, 2, 3]);
        }),
    );
    let mut version = file.bytes.clone();
    version[4] = 2;
    assert!(matches!(expand(&version, &WHOLE), Err(CodecError::Version { expected: 1, found: 2 })));
    let text = expand(b"PK\x03\x04 a NumPy archive", &WHOLE).unwrap_err();
    assert!(matches!(text, CodecError::Magic { .. }), "{text}");
    assert!(matches!(expand(b"", &PREFIX), Err(CodecError::Magic { .. })));
    let mut longer = file.bytes.clone();
    longer.push(0);
    refuse("length", longer);
}

/// The header declares degrees up to 6, but the stream ends earlier.
#[test]
fn a_stream_that_ends_early_is_refused() {
    let file = compress(
        &surface(6),
        &CompressParams { provenance: false, levels: Some(vec![]), ..CompressParams::new(Target::Step(1e-4)) },
        &Silent,
    )
    .unwrap();
    let stream = [0xff, 0xff];
    let mut bytes = forge(&file, |head| {
        let segment = head.len() - 7;
        assert_eq!(head[segment], 6, "the degree of the only segment, a varint of two bytes, a checksum");
        head.truncate(segment + 1);
        head.push(stream.len() as u8);
        head.extend(crc32c::crc32c(&stream).to_le_bytes());
    });
    bytes.truncate(bytes.len() - (file.bytes.len() - file.head));
    bytes.extend(stream);
    let error = expand(&bytes, &WHOLE).unwrap_err();
    assert!(error.to_string().contains("stream"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Changing any byte of a file causes an error.
    #[test]
    fn damage_is_an_error(at in 0.0..1.0f64, flip in 1..=255u8, cut in 0.0..1.0f64, prefix: bool) {
        let model = surface(7);
        let file = compress(&model, &CompressParams { levels: Some(vec![2, 4]), ..CompressParams::new(Target::Step(1e-3)) }, &Silent).unwrap();
        let params = if prefix { PREFIX } else { WHOLE };
        let mut bytes = file.bytes.clone();
        bytes[(at * file.bytes.len() as f64) as usize] ^= flip;
        prop_assert!(expand(&bytes, &params).is_err());
        bytes.truncate((cut * file.bytes.len() as f64) as usize);
        if let Ok(found) = expand(&bytes, &params) {
            // The file was truncated before the damaged byte.
            let whole = expand(&file.bytes, &WHOLE).unwrap().model.coefficients;
            let degree = found.model.coefficients.max_degree();
            prop_assert!(prefix);
            prop_assert_eq!(found.model.coefficients.values(), whole.up_to(degree));
        }
    }

    /// Arbitrary bytes after a valid header with a valid checksum don't cause a panic.
    #[test]
    fn any_stream_is_read_without_a_panic(stream in prop::collection::vec(any::<u8>(), 0..300)) {
        let mut head = file_head(40, stream.len(), crc32c::crc32c(&stream));
        head.extend(&stream);
        if let Ok(found) = expand(&head, &WHOLE) {
            prop_assert!(found.model.coefficients.values().iter().all(|value| value.is_finite()));
        }
    }

    /// Arbitrary bytes in place of the header's fields don't cause a panic.
    #[test]
    fn any_fields_are_read_without_a_panic(fields in prop::collection::vec(any::<u8>(), 0..80), flags in 0..4u8) {
        let mut head = b"\x89SPZ\x01".to_vec();
        head.push(flags);
        head.extend((14 + fields.len() as u32).to_le_bytes());
        head.extend(&fields);
        head.extend(crc32c::crc32c(&head).to_le_bytes());
        let _ = expand(&head, &PREFIX);
    }
}

/// Returns the header of a surface with one segment.
fn file_head(degree: u8, length: usize, crc: u32) -> Vec<u8> {
    let mut head = b"\x89SPZ\x01\x01\0\0\0\0".to_vec();
    head.extend([degree, 3, degree, 3, 0, 0]);
    head.extend(1.0f64.to_le_bytes());
    head.extend([0, 0, 0, 1, degree]);
    head.extend([length as u8 & 127 | 128, (length >> 7) as u8]);
    head.extend(crc.to_le_bytes());
    let end = (head.len() + 4) as u32;
    head[6..10].copy_from_slice(&end.to_le_bytes());
    head.extend(crc32c::crc32c(&head).to_le_bytes());
    head
}
