// View of a model: the surface, the model to a degree, and the distance between them.

import { BufferAttribute } from 'three';

import { numbers } from './blocks.js';
import { paint, plain, short } from './colours.js';
import { grid, normals } from './grid.js';
import { drawn } from './drawn.js';
import { Surface } from './stage.js';

export class ModelView {
  /** Reads an item and shows it. */
  static async open(item, { engine, stage, panels, colours }) {
    const view = new ModelView();
    Object.assign(view, { item, engine, stage, panels, colours, degree: item.degree, signed: false, limit: null });
    const { directions, faces } = await grid(item.grid);
    const coefficients = await numbers(item.coefficients);
    engine.plan(directions, faces, item.degree);
    engine.coefficients(coefficients);
    engine.evaluate(item.degree);
    view.faces = faces;
    const { reference } = item;
    const count = item.grid.vertices;
    view.index = new BufferAttribute(faces, 1);
    view.positions = new BufferAttribute(new Float32Array(3 * count), 3);
    view.normals = new BufferAttribute(new Float32Array(3 * count), 3);
    view.model = new Surface(view.positions, view.normals, view.index);
    view.error = new Surface(view.positions, view.normals, view.index, true);
    view.surface = null;
    if (reference.kind === 'vertices') {
      engine.refer(await numbers(reference.offsets), reference.step);
      const positions = engine.reference().slice();
      const attributes = [positions, normals(positions, faces)].map((values) => new BufferAttribute(values, 3));
      view.surface = new Surface(...attributes, view.index);
    } else {
      engine.refer(null, 0);
      if (reference.kind === 'surface') {
        view.fixed = await numbers(reference.distances);
        if (reference.mesh) view.surface = (await drawn(reference.mesh)).surface();
      }
    }
    view.#show();
    return view;
  }

  #show() {
    const { stage, panels } = this;
    panels[0].name(this.surface ? 'Surface' : null);
    panels[1].name('Model');
    panels[2].name('Distance');
    stage.show(0, this.surface);
    stage.show(1, this.model);
    stage.show(2, this.error);
    stage.frame(this.surface ? this.surface.geometry.attributes.position.array : this.engine.positions());
  }

  /** Evaluates the model to a degree and colours it. */
  setDegree(degree) {
    this.degree = degree;
    this.engine.evaluate(degree);
    this.positions.array.set(this.engine.positions());
    this.normals.array.set(this.engine.normals());
    this.positions.needsUpdate = true;
    this.normals.needsUpdate = true;
    this.measure();
    this.panels[1].name(`Model to degree ${degree}`);
  }

  /** Colours the distances. */
  measure() {
    const { item, colours, error, panels } = this;
    const { reference } = item;
    const fixed = reference.kind === 'surface';
    const [panel] = panels.slice(2);
    if (fixed && this.degree !== item.degree) {
      this.values = null;
      plain(error.tints);
      panel.name(`Distance is known at degree ${item.degree}`);
    } else {
      this.values = fixed ? this.fixed : this.engine.distances(this.signed);
      const signed = this.signed && !fixed;
      let most = 0;
      for (const value of this.values) if (Math.abs(value) > most) most = Math.abs(value);
      this.largest = most;
      const limit = this.limit ?? most;
      this.range = signed ? [-limit, limit] : [0, limit];
      const stops = signed ? colours.diverging : colours.viridis;
      paint(error.tints, this.values, this.range, stops);
      const from = reference.kind === 'model' ? `degree ${item.degree}` : 'the surface';
      panel.name(fixed ? 'Distance from the nearest point' : `Distance from ${from}`);
      panel.scale(stops, this.range, signed ? 'along the normal, outward positive' : 'distance');
    }
    error.tinted();
    this.stage.draw([1, 2]);
  }

  /** Describes a vertex of the model or, in the first panel, of the surface, whose vertices may be different ones. */
  describe(vertex, panel) {
    const other = panel === 0 && this.item.reference.kind === 'surface';
    const source = panel === 0 ? this.surface : this.model;
    const at = point(source, vertex);
    this.stage.mark(at);
    const parts = [`Vertex ${vertex}`, `(${at.map(short).join(', ')})`];
    if (this.values && !other) parts.push(`distance ${short(this.values[vertex])}`);
    return parts.join('  ');
  }

  get tabs() {
    return ['Surface', 'Model', 'Distance'];
  }

  get vertices() {
    return this.item.grid.vertices;
  }

  /** Returns the mesh to save: the model as shown, with its distances. */
  mesh() {
    const values = this.values ? { distance: this.values } : {};
    return { name: `${this.item.name}.degree${this.degree}`, positions: this.positions.array, faces: this.faces, values,
      tints: this.error.tints };
  }
}

/** Returns the position of a surface's vertex, (3). */
export function point(surface, vertex) {
  const { array } = surface.geometry.attributes.position;
  return [array[3 * vertex], array[3 * vertex + 1], array[3 * vertex + 2]];
}
