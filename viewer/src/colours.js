// Colours for values: piecewise linear between stops, as in crates/surface/src/metrics/colormap.rs.

export const PLAIN = [222, 208, 196];
const MISSING = [128, 128, 128];

/** Returns the colour for a value from 0 to 1. */
export function colour(stops, value) {
  if (Number.isNaN(value)) return MISSING;
  const x = Math.min(Math.max(value, 0), 1) * (stops.length - 1);
  const cell = Math.min(Math.floor(x), stops.length - 2);
  const t = x - cell;
  return [0, 1, 2].map((i) => Math.round(stops[cell][i] + t * (stops[cell + 1][i] - stops[cell][i])));
}

/** Writes the colours of values over a range into `tints`, (n, 4); vertices that `shown` rejects are plain. */
export function paint(tints, values, [low, high], stops, shown) {
  const span = high > low ? high - low : Infinity;
  const last = stops.length - 1;
  for (let i = 0; i < values.length; i++) {
    const at = 4 * i;
    const relative = (values[i] - low) / span;
    if (Number.isNaN(relative) || (shown && !shown(i))) {
      const [r, g, b] = Number.isNaN(relative) ? MISSING : PLAIN;
      tints[at] = r;
      tints[at + 1] = g;
      tints[at + 2] = b;
      continue;
    }
    const x = Math.min(Math.max(relative, 0), 1) * last;
    const cell = Math.min(Math.floor(x), last - 1);
    const t = x - cell;
    const from = stops[cell];
    const to = stops[cell + 1];
    for (let c = 0; c < 3; c++) tints[at + c] = Math.round(from[c] + t * (to[c] - from[c]));
  }
}

/** Gives all vertices the plain colour. */
export function plain(tints) {
  for (let i = 0; i < tints.length; i++) tints[i] = PLAIN[i % 4] ?? 255;
}

/** Formats a number to four digits. */
export function short(x) {
  if (x === 0) return '0';
  if (!Number.isFinite(x)) return '–';
  const size = Math.abs(x);
  const text = size >= 1e-3 && size < 1e5 ? String(Number(x.toPrecision(4))) : x.toExponential(2);
  return text.replace('-', '−');
}
