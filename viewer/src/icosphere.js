// The icosahedron with each triangle split in four, in the order of crates/surface/src/generate.

/** Returns unit vectors (n, 3) and triangles (m, 3). */
export function icosphere(subdivisions) {
  let { vertices, faces } = icosahedron();
  for (let level = 0; level < subdivisions; level++) ({ vertices, faces } = split(vertices, faces));
  return { vertices, faces };
}

function icosahedron() {
  const z = 1 / Math.sqrt(5);
  const r = 2 * z;
  const rows = [[0, 0, 1]];
  for (const [turn, height] of [[0, z], [0.5, -z]]) {
    for (let k = 0; k < 5; k++) {
      const phi = ((k + turn) * 2 * Math.PI) / 5;
      rows.push([r * Math.cos(phi), r * Math.sin(phi), height]);
    }
  }
  rows.push([0, 0, -1]);
  const faces = [];
  for (let k = 0; k < 5; k++) {
    const [upper, upperNext, lower, lowerNext] = [1 + k, 1 + ((k + 1) % 5), 6 + k, 6 + ((k + 1) % 5)];
    faces.push(0, upper, upperNext, upper, lower, upperNext, upperNext, lower, lowerNext, 11, lowerNext, lower);
  }
  const vertices = new Float64Array(rows.flat());
  for (let i = 0; i < vertices.length; i += 3) normalise(vertices, i);
  return { vertices, faces: new Uint32Array(faces) };
}

function normalise(vertices, at) {
  const length = Math.sqrt(vertices[at] ** 2 + vertices[at + 1] ** 2 + vertices[at + 2] ** 2);
  for (let c = 0; c < 3; c++) vertices[at + c] /= length;
}

function split(old, oldFaces) {
  const count = old.length / 3;
  const vertices = new Float64Array(3 * (count + oldFaces.length / 2));
  vertices.set(old);
  const faces = new Uint32Array(4 * oldFaces.length);
  // Midpoints of edges, stored in six slots for each edge's lower vertex: no vertex has more than six edges.
  const upper = new Uint32Array(6 * count);
  const middle = new Uint32Array(6 * count);
  let next = count;
  const midpoint = (a, b) => {
    const low = Math.min(a, b);
    const high = Math.max(a, b);
    let slot = 6 * low;
    while (middle[slot] !== 0 && upper[slot] !== high) slot++;
    if (middle[slot] === 0) {
      upper[slot] = high;
      middle[slot] = next;
      for (let c = 0; c < 3; c++) vertices[3 * next + c] = old[3 * low + c] + old[3 * high + c];
      normalise(vertices, 3 * next);
      next++;
    }
    return middle[slot];
  };
  for (let i = 0; i < oldFaces.length; i += 3) {
    const a = oldFaces[i];
    const b = oldFaces[i + 1];
    const c = oldFaces[i + 2];
    const ab = midpoint(a, b);
    const bc = midpoint(b, c);
    const ca = midpoint(c, a);
    faces.set([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], 4 * i);
  }
  return { vertices, faces };
}
