// Reads the program's PLY files, with which the contents of pages are compared.

import { readFileSync } from 'node:fs';

const TYPES = {
  float: ['getFloat32', 4],
  double: ['getFloat64', 8],
  uchar: ['getUint8', 1],
  uint8: ['getUint8', 1],
  float32: ['getFloat32', 4],
  float64: ['getFloat64', 8],
};

/** The vertices' properties of a binary PLY file, by name. */
export function readPly(path) {
  const bytes = readFileSync(path);
  const end = bytes.indexOf('end_header\n') + 'end_header\n'.length;
  const lines = bytes.subarray(0, end).toString('latin1').split('\n');
  const count = Number(lines.find((line) => line.startsWith('element vertex')).split(' ')[2]);
  const of = lines.slice(0, lines.findIndex((line) => line.startsWith('element face')));
  const properties = of.filter((line) => line.startsWith('property')).map((line) => line.split(' ').slice(1));
  const view = new DataView(bytes.buffer, bytes.byteOffset + end);
  const vertices = Object.fromEntries(properties.map(([, name]) => [name, new Float64Array(count)]));
  let at = 0;
  for (let i = 0; i < count; i++) {
    for (const [type, name] of properties) {
      const [get, width] = TYPES[type];
      vertices[name][i] = view[get](at, true);
      at += width;
    }
  }
  return vertices;
}

/** Length of the bounding box's diagonal. */
export function size({ x, y, z }) {
  const span = (values) => values.reduce((m, v) => Math.max(m, v), -Infinity) - values.reduce((m, v) => Math.min(m, v), Infinity);
  return Math.hypot(span(x), span(y), span(z));
}
