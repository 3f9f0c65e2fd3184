// Directions and triangles of an item (crates/report/src/grid.rs).

import { numbers } from './blocks.js';
import { icosphere } from './icosphere.js';

const made = new Map();

/** Returns directions (n, 3), or null if positions are given separately, and triangles (m, 3). */
export async function grid({ icosphere: level, directions, faces }) {
  let sphere = null;
  if (level !== null) {
    if (!made.has(level)) made.set(level, icosphere(level));
    sphere = made.get(level);
  }
  const given = directions ? await numbers(directions) : null;
  return { directions: given ?? sphere?.vertices ?? null, faces: sphere?.faces ?? sums(await numbers(faces)) };
}

/** Computes triangles from the differences between each and the previous one. */
function sums(differences) {
  const faces = new Uint32Array(differences.length);
  for (let i = 0; i < faces.length; i++) faces[i] = differences[i] + (i < 3 ? 0 : faces[i - 3]);
  return faces;
}

/** Returns unit normals at vertices, (n, 3), of a constant mesh. Unrolled for speed: they delay the first drawing. */
export function normals(positions, faces) {
  const sums = new Float32Array(positions.length);
  for (let i = 0; i < faces.length; i += 3) {
    const a = 3 * faces[i];
    const b = 3 * faces[i + 1];
    const c = 3 * faces[i + 2];
    const ux = positions[b] - positions[a];
    const uy = positions[b + 1] - positions[a + 1];
    const uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a];
    const vy = positions[c + 1] - positions[a + 1];
    const vz = positions[c + 2] - positions[a + 2];
    const x = uy * vz - uz * vy;
    const y = uz * vx - ux * vz;
    const z = ux * vy - uy * vx;
    for (let corner = 0; corner < 3; corner++) {
      const at = corner === 0 ? a : corner === 1 ? b : c;
      sums[at] += x;
      sums[at + 1] += y;
      sums[at + 2] += z;
    }
  }
  for (let i = 0; i < sums.length; i += 3) {
    const factor = 1 / (Math.sqrt(sums[i] ** 2 + sums[i + 1] ** 2 + sums[i + 2] ** 2) || 1);
    sums[i] *= factor;
    sums[i + 1] *= factor;
    sums[i + 2] *= factor;
  }
  return sums;
}
