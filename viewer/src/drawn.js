// Meshes that don't change: surfaces of other triangles than their model's, those of maps.

import { BufferAttribute } from 'three';

import { numbers } from './blocks.js';
import { grid, normals } from './grid.js';
import { Surface } from './stage.js';

/** Positions and triangles of a mesh, from which any number of surfaces are made. */
export async function drawn({ grid: given, positions: block }) {
  const [{ faces }, positions] = await Promise.all([grid(given), numbers(block)]);
  const index = new BufferAttribute(faces, 1);
  const attributes = [positions, normals(positions, faces)].map((values) => new BufferAttribute(values, 3));
  return { faces, positions, surface: (coloured) => new Surface(...attributes, index, coloured) };
}
