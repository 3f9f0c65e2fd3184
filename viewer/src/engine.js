// The WebAssembly of crates/viewer: one model at a time.

import { bytes } from './blocks.js';

export class Engine {
  static async start() {
    const { instance } = await WebAssembly.instantiate(await bytes('wasm'));
    return new Engine(instance.exports);
  }

  constructor(exports) {
    this.exports = exports;
    this.vertices = 0;
  }

  /** Directions (n, 3) and triangles (m, 3), for models of a degree. */
  plan(directions, faces, degree) {
    this.vertices = directions.length / 3;
    this.#put(Float64Array, this.exports.set_directions(this.vertices), directions);
    this.#put(Uint32Array, this.exports.set_faces(faces.length / 3), faces);
    this.#done(this.exports.plan(degree));
  }

  /** Coefficients (K, 3). */
  coefficients(values) {
    this.#put(Float64Array, this.exports.set_coefficients(values.length / 3), values);
  }

  evaluate(degree) {
    this.#done(this.exports.evaluate(degree));
  }

  /** The reference: what was evaluated last, and offsets (n, 3) in steps from there; without offsets that itself. */
  refer(offsets, step) {
    const at = this.exports.set_offsets(this.vertices);
    if (offsets) this.#put(Int16Array, at, offsets);
    this.#done(this.exports.refer(step));
  }

  /** Distances of what was evaluated last from the reference, (n); `signed` along its normals. A copy. */
  distances(signed) {
    this.#done(this.exports.measure(signed ? 1 : 0));
    return this.#get(this.exports.distances(), this.vertices).slice();
  }

  /** Views that the next call ends. */
  positions() {
    return this.#get(this.exports.positions(), 3 * this.vertices);
  }

  normals() {
    return this.#get(this.exports.normals(), 3 * this.vertices);
  }

  reference() {
    return this.#get(this.exports.reference(), 3 * this.vertices);
  }

  #put(Type, at, values) {
    new Type(this.exports.memory.buffer, at, values.length).set(values);
  }

  #get(at, length) {
    return new Float32Array(this.exports.memory.buffer, at, length);
  }

  #done(code) {
    if (code !== 1) throw new Error('the model cannot be evaluated');
  }
}
