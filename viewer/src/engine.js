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

  /** Plans the evaluation of models of a degree at directions (n, 3) with triangles (m, 3). */
  plan(directions, faces, degree) {
    this.vertices = directions.length / 3;
    this.#put(Float64Array, this.exports.set_directions(this.vertices), directions);
    this.#put(Uint32Array, this.exports.set_faces(faces.length / 3), faces);
    this.#done(this.exports.plan(degree));
  }

  /** Sets the coefficients (K, 3). */
  coefficients(values) {
    this.#put(Float64Array, this.exports.set_coefficients(values.length / 3), values);
  }

  evaluate(degree) {
    this.#done(this.exports.evaluate(degree));
  }

  /** Sets the reference: the surface that was evaluated last plus, if given, offsets (n, 3) in units of `step`. */
  refer(offsets, step) {
    const at = this.exports.set_offsets(this.vertices);
    if (offsets) this.#put(Int16Array, at, offsets);
    this.#done(this.exports.refer(step));
  }

  /** Returns a copy of the last evaluated surface's distances, (n), from the reference; `signed` along its normals. */
  distances(signed) {
    this.#done(this.exports.measure(signed ? 1 : 0));
    return this.#get(this.exports.distances(), this.vertices).slice();
  }

  /** Returns a view of the module's memory, as do the next two; it is valid until the next call. */
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
