// Directions and triangles of an item (crates/report/src/grid.rs).

import { numbers } from './blocks.js';
import { icosphere } from './icosphere.js';

const made = new Map();

/** Directions (n, 3), null where positions are given otherwise, and triangles (m, 3). */
export async function grid({ icosphere: level, directions, faces }) {
  let sphere = null;
  if (level !== null) {
    if (!made.has(level)) made.set(level, icosphere(level));
    sphere = made.get(level);
  }
  const given = directions ? await numbers(directions) : null;
  return { directions: given ?? sphere?.vertices ?? null, faces: sphere?.faces ?? sums(await numbers(faces)) };
}

/** Triangles from the differences of each and the one before. */
function sums(differences) {
  const faces = new Uint32Array(differences.length);
  for (let i = 0; i < faces.length; i++) faces[i] = differences[i] + (i < 3 ? 0 : faces[i - 3]);
  return faces;
}

/** Unit normals at vertices, (n, 3), for a mesh that doesn't change. */
export function normals(positions, faces) {
  const sums = new Float32Array(positions.length);
  for (let i = 0; i < faces.length; i += 3) {
    const [a, b, c] = [3 * faces[i], 3 * faces[i + 1], 3 * faces[i + 2]];
    const [ux, uy, uz] = [0, 1, 2].map((k) => positions[b + k] - positions[a + k]);
    const [vx, vy, vz] = [0, 1, 2].map((k) => positions[c + k] - positions[a + k]);
    const normal = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (const at of [a, b, c]) for (let k = 0; k < 3; k++) sums[at + k] += normal[k];
  }
  for (let i = 0; i < sums.length; i += 3) {
    const length = Math.hypot(sums[i], sums[i + 1], sums[i + 2]) || 1;
    for (let k = 0; k < 3; k++) sums[i + k] /= length;
  }
  return sums;
}
