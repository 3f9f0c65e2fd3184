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

/// Returns red, green and blue (sRGB) for a value from 0 to 1. Values outside are clamped; NaN is grey.
#[must_use]
pub fn viridis(value: f64) -> [u8; 3] {
    if value.is_nan() {
        return [128; 3];
    }
    let x = value.clamp(0.0, 1.0) * 16.0;
    let cell = (x as usize).min(15);
    let t = x - cell as f64;
    std::array::from_fn(|i| {
        let (a, b) = (f64::from(VIRIDIS[cell][i]), f64::from(VIRIDIS[cell + 1][i]));
        (a + t * (b - a)).round() as u8
    })
}

/// Returns the [`viridis`] colour of each value, with `low` mapped to 0 and `high` to 1. If `low` equals `high`, all
/// values get the colour for 0.
#[must_use]
pub fn colors(values: &[f64], low: f64, high: f64) -> Vec<[u8; 3]> {
    let span = if high > low { high - low } else { f64::INFINITY };
    values.iter().map(|x| viridis((x - low) / span)).collect()
}
