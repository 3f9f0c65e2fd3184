//! Reads tifffile's description of an array: a JSON object with its `shape` and, if the writer gave them, the names of
//! its `axes`, such as `{"shape": [3, 12, 40, 40], "axes": "TZYX"}`. A page has the axes Y and X; the pages are in the
//! order of the other axes, the last of which varies fastest.

/// How the pages of a file with several channels or time points are divided into images.
#[derive(Debug, PartialEq)]
pub(super) struct Images {
    /// Numbers of slices, channels and time points.
    pub(super) counts: [usize; 3],
    /// Order of the pages: the axes Z, C and T, the fastest-varying axis first.
    pub(super) order: [u8; 3],
}

/// Returns how the pages are divided into images, according to the description `text`; `None` if the pages are the
/// slices of one image. `page` is the size of a page.
///
/// # Errors
///
/// A message with the shape, if the shape has more than three dimensions and the names of the axes don't identify the
/// channels and time points.
pub(super) fn images(text: &str, page: [usize; 2]) -> Result<Option<Images>, String> {
    let Some(shape) = field(text, "shape").and_then(numbers) else { return Ok(None) };
    let Some(axes) = field(text, "axes").and_then(quoted).filter(|axes| axes.len() == shape.len()) else {
        // Axes of length 1 don't add images.
        let found = [&shape[..], &page].map(|sizes| sizes.iter().filter(|&&size| size != 1).count());
        if found[0] <= found[1] + 1 {
            return Ok(None);
        }
        return Err(format!("shape {shape:?} without names of its axes, such as TZYX; extract one volume"));
    };
    let in_page = |axis: u8| matches!(axis, b'Y' | b'X');
    let all: Vec<(u8, usize)> = axes.bytes().zip(shape.iter().copied()).collect();
    let others: Vec<(u8, usize)> = all.iter().copied().filter(|&(axis, size)| !in_page(axis) && size != 1).collect();
    let sizes = |axis: u8| others.iter().filter(move |(other, _)| *other == axis).map(|(_, size)| *size);
    if others.len() < 2 && sizes(b'C').chain(sizes(b'T')).count() == 0 {
        return Ok(None);
    }
    let are_known = others.iter().all(|&(axis, _)| b"ZCT".contains(&axis) && sizes(axis).count() == 1);
    let stored: Vec<u8> =
        all.iter().filter(|&&(axis, size)| in_page(axis) || size != 1).map(|&(axis, _)| axis).collect();
    if !are_known || !stored.ends_with(b"YX") {
        return Err(format!("shape {shape:?} with the axes {axes}; extract one volume"));
    }
    // Axes of length 1 may be anywhere in the order.
    let rest = b"ZCT".iter().copied().filter(|&axis| sizes(axis).count() == 0);
    let order: Vec<u8> = others.iter().rev().map(|&(axis, _)| axis).chain(rest).collect();
    let counts = [b'Z', b'C', b'T'].map(|axis| sizes(axis).next().unwrap_or(1).max(1));
    Ok(Some(Images { counts, order: order.try_into().unwrap_or(*b"ZCT") }))
}

/// Returns the text that follows the name of a field of the outermost object in a JSON text.
fn field<'a>(json: &'a str, name: &str) -> Option<&'a str> {
    let (mut depth, mut at) = (0, 0);
    while let Some(&byte) = json.as_bytes().get(at) {
        at += 1;
        match byte {
            b'{' | b'[' => depth += 1,
            b'}' | b']' => depth -= 1,
            b'"' => {
                let text = json.get(at..)?;
                let length = end(text)?;
                at += length + 1;
                let value = json.get(at..)?.trim_start().strip_prefix(':');
                if let Some(value) = value.filter(|_| depth == 1 && text.get(..length) == Some(name)) {
                    return Some(value.trim_start());
                }
            }
            _ => {}
        }
    }
    None
}

/// Returns the number of bytes before the quotation mark that ends a JSON string.
fn end(text: &str) -> Option<usize> {
    let mut escaped = false;
    text.find(|letter: char| {
        let ends = letter == '"' && !escaped;
        escaped = letter == '\\' && !escaped;
        ends
    })
}

/// Returns the string at the start of a JSON text.
fn quoted(json: &str) -> Option<&str> {
    let text = json.strip_prefix('"')?;
    text.get(..end(text)?)
}

/// Returns the list of whole numbers at the start of a JSON text.
fn numbers(json: &str) -> Option<Vec<usize>> {
    let (list, _) = json.strip_prefix('[')?.split_once(']')?;
    list.split(',').map(|number| number.trim().parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(text: &str) -> Result<Option<Images>, String> {
        images(text, [40, 40])
    }

    #[test]
    fn axes_tell_channels_and_times() {
        let of = |counts, order: &[u8; 3]| Ok(Some(Images { counts, order: *order }));
        assert_eq!(found(r#"{"shape": [3, 12, 40, 40], "axes": "TZYX"}"#), of([12, 1, 3], b"ZTC"));
        assert_eq!(found(r#"{"axes": "ZCYX", "shape": [3, 2, 40, 40]}"#), of([3, 2, 1], b"CZT"));
        assert_eq!(found(r#"{"shape": [4, 3, 2, 40, 40], "axes": "TZCYX"}"#), of([3, 2, 4], b"CZT"));
        assert_eq!(found(r#"{"shape": [5, 40, 40], "axes": "TYX"}"#), of([1, 1, 5], b"TZC"));
    }

    #[test]
    fn volumes_stay_volumes() {
        for text in [
            "a stack",
            "{}",
            r#"{"shape": [12, 40, 40]}"#,
            r#"{"shape": [40, 40]}"#,
            r#"{"shape": [12, 40, 40, 1]}"#,
            r#"{"shape": [12, 40, 40], "axes": "ZYX"}"#,
            r#"{"shape": [12, 40, 40], "axes": "QYX"}"#,
            r#"{"shape": [1, 12, 40, 40], "axes": "TZYX"}"#,
            r#"{"note": "\"shape\": [1, 2, 3, 4]", "other": {"shape": [2, 3, 40, 40]}, "shape": [12, 40, 40]}"#,
        ] {
            assert_eq!(found(text), Ok(None), "{text}");
        }
    }

    #[test]
    fn four_dimensions_without_their_names_are_refused() {
        for (text, why) in [
            (r#"{"shape": [3, 12, 40, 40]}"#, "[3, 12, 40, 40] without names of its axes"),
            (r#"{"shape": [3, 12, 40, 40], "axes": "ZYX"}"#, "without names"),
            (r#"{"shape": [3, 12, 40, 40], "axes": "QZYX"}"#, "with the axes QZYX"),
            (r#"{"shape": [3, 40, 40, 12], "axes": "TYXZ"}"#, "with the axes TYXZ"),
            (r#"{"shape": [3, 3, 40, 40], "axes": "TTYX"}"#, "with the axes TTYX"),
        ] {
            assert!(found(text).unwrap_err().contains(why), "{text}");
        }
    }
}
