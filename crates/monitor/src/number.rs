//! Formats numbers for tables and messages.

/// Formats a number with four significant digits, or with all digits before the decimal point if there are more than
/// four: `0.2450`, `12.30`, `40962`, `3.100e-6`. Numbers below 0.0001, and numbers of a million or more, are written
/// with an exponent.
#[must_use]
pub fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value.is_finite() { "0".to_owned() } else { value.to_string() };
    }
    // Rounding may lead to the next power of ten, such as from 9.9996 to 10.00.
    let rounded = format!("{value:.3e}");
    let exponent = rounded.split_once('e').and_then(|(_, power)| power.parse::<i32>().ok()).unwrap_or(0);
    match exponent {
        -4..6 => format!("{value:.*}", usize::try_from(3 - exponent).unwrap_or(0)),
        _ => rounded,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits() {
        let expected = [
            (0.0, "0"),
            (-0.24474, "-0.2447"),
            (1.2385, "1.238"),
            (9.9996, "10.00"),
            (9.999e-5, "9.999e-5"),
            (1.8521e-4, "0.0001852"),
            (0.99996e-4, "0.0001000"),
            (12345.6, "12346"),
            (999_999.7, "1.000e6"),
            (1.23e-9, "1.230e-9"),
            (2.5e9, "2.500e9"),
            (f64::NAN, "NaN"),
            (f64::NEG_INFINITY, "-inf"),
        ];
        for (value, text) in expected {
            assert_eq!(number(value), text);
        }
    }
}
