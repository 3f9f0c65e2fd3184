// Meshes that don't change: surfaces whose triangles differ from their model's, and the meshes of maps.

import { BufferAttribute } from 'three';

import { numbers } from './blocks.js';
import { grid, normals } from './grid.js';
import { Surface } from './stage.js';

/** Loads positions and triangles of a mesh, from which `surface` creates any number of surfaces. */
export async function drawn({ grid: given, positions: block }) {
  const [{ faces }, positions] = await Promise.all([grid(given), numbers(block)]);
  const index = new BufferAttribute(faces, 1);
  const attributes = [positions, normals(positions, faces)].map((values) => new BufferAttribute(values, 3));
  return { faces, positions, surface: (coloured) => new Surface(...attributes, index, coloured) };
}
