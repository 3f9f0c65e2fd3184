//! Maps values to colours.

/// Matplotlib's viridis (van der Walt and Smith, CC0) at multiples of 1/16: dark blue for 0, yellow for 1. Its
/// lightness increases evenly, and it is legible to the colour-blind.
const VIRIDIS: [[u8; 3]; 17] = [
    [68, 1, 84],
    [72, 24, 106],
    [71, 45, 123],
    [66, 64, 134],
    [59, 82, 139],
    [51, 99, 141],
    [44, 114, 142],
    [38, 130, 142],
    [33, 145, 140],
    [31, 160, 136],
    [40, 174, 128],
    [63, 188, 115],
    [94, 201, 98],
    [132, 212, 75],
    [173, 220, 48],
    [216, 226, 25],
    [253, 231, 37],
];

/// Colours from blue through grey to red, of symmetric lightness, for values on both sides of 0.
pub const DIVERGING: [[u8; 3]; 9] = [
    [33, 75, 155],
    [74, 118, 189],
    [125, 161, 213],
    [181, 201, 229],
    [228, 226, 224],
    [236, 190, 172],
    [221, 139, 117],
    [193, 84, 72],
    [152, 27, 43],
];

/// Returns red, green and blue (sRGB) for a value from 0 to 1. Values outside this range are clamped; NaN is grey.
#[must_use]
pub fn viridis(value: f64) -> [u8; 3] {
    between(&VIRIDIS, value)
}

/// Returns the colour of [`DIVERGING`] for a value from 0 to 1, with grey at 0.5. Values outside this range are
/// clamped; NaN is grey.
#[must_use]
pub fn diverging(value: f64) -> [u8; 3] {
    between(&DIVERGING, value)
}

/// Interpolates linearly between equally spaced colours, of which the first is for the value 0 and the last for 1. NaN
/// gives grey.
fn between(stops: &[[u8; 3]], value: f64) -> [u8; 3] {
    if value.is_nan() {
        return [128; 3];
    }
    let last = stops.len() - 1;
    let x = value.clamp(0.0, 1.0) * last as f64;
    let cell = (x as usize).min(last - 1);
    let t = x - cell as f64;
    std::array::from_fn(|i| {
        let (a, b) = (f64::from(stops[cell][i]), f64::from(stops[cell + 1][i]));
        (a + t * (b - a)).round() as u8
    })
}

/// Returns the [`viridis`] colour of each value, with `low` mapped to 0 and `high` to 1. If `low` equals `high`, all
/// values get the colour for 0.
#[must_use]
pub fn colors(values: &[f64], low: f64, high: f64) -> Vec<[u8; 3]> {
    colors_by(viridis, values, low, high)
}

/// Returns the colour of each value under `map`, which maps numbers from 0 to 1 to colours. `low` is mapped to 0 and
/// `high` to 1. If `low` equals `high`, all values get the colour for 0.
#[must_use]
pub fn colors_by(map: fn(f64) -> [u8; 3], values: &[f64], low: f64, high: f64) -> Vec<[u8; 3]> {
    let span = if high > low { high - low } else { f64::INFINITY };
    values.iter().map(|x| map((x - low) / span)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_diverging_colours_are_grey_at_the_middle_and_blue_and_red_at_the_ends() {
        assert_eq!([0.0, 0.5, 1.0].map(diverging), [DIVERGING[0], DIVERGING[4], DIVERGING[8]]);
        assert_eq!([-3.0, 4.0].map(diverging), [DIVERGING[0], DIVERGING[8]]);
        // A value between two stops gets a colour between theirs, and NaN is grey.
        assert_eq!(diverging(1.0 / 16.0), [54, 97, 172]);
        assert_eq!(diverging(f64::NAN), [128; 3]);
        let [low, .., high] = DIVERGING;
        assert!(low[2] > low[0] && high[0] > high[2]);
    }
}
