// View of a group's modes: the mean, and the shape at some numbers of standard deviations along the modes.

import { BufferAttribute } from 'three';

import { numbers } from './blocks.js';
import { paint, short } from './colours.js';
import { grid } from './grid.js';
import { point } from './model.js';
import { Surface } from './stage.js';

export class ModesView {
  static async open(item, { engine, stage, panels, colours }) {
    const view = new ModesView();
    Object.assign(view, { item, engine, stage, panels, colours, deviations: item.deviations.map(() => 0) });
    const { directions, faces } = await grid(item.grid);
    [view.mean, view.modes] = await Promise.all([numbers(item.coefficients), numbers(item.modes)]);
    engine.plan(directions, faces, item.degree);
    engine.coefficients(view.mean);
    engine.evaluate(item.degree);
    engine.refer(null, 0);
    view.faces = faces;
    const count = item.grid.vertices;
    const attribute = () => new BufferAttribute(new Float32Array(3 * count), 3);
    const index = new BufferAttribute(faces, 1);
    [view.positions, view.normals] = [attribute(), attribute()];
    const [meanPositions, meanNormals] = [attribute(), attribute()];
    meanPositions.array.set(engine.positions());
    meanNormals.array.set(engine.normals());
    view.middle = new Surface(meanPositions, meanNormals, index);
    view.shape = new Surface(view.positions, view.normals, index);
    view.moved = new Surface(view.positions, view.normals, index, true);
    ['Mean', 'Shape', 'Displacement'].forEach((name, panel) => panels[panel].name(name));
    [view.middle, view.shape, view.moved].forEach((surface, panel) => stage.show(panel, surface));
    stage.frame(meanPositions.array);
    return view;
  }

  /** Shows the shape at these numbers of standard deviations. */
  set(deviations) {
    this.deviations = deviations;
    const { item, engine, modes } = this;
    const shape = Float64Array.from(this.mean);
    const length = shape.length - 3;
    deviations.forEach((z, k) => {
      const along = z * item.deviations[k];
      if (along !== 0) for (let i = 0; i < length; i++) shape[i + 3] += along * modes[k * length + i];
    });
    engine.coefficients(shape);
    engine.evaluate(item.degree);
    this.positions.array.set(engine.positions());
    this.normals.array.set(engine.normals());
    this.positions.needsUpdate = true;
    this.normals.needsUpdate = true;
    this.values = engine.distances(true);
    // The range only grows, so that the colours of different shapes can be compared.
    const most = this.values.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
    this.largest = Math.max(this.largest ?? 0, most);
    this.range = [-(this.largest || 1), this.largest || 1];
    paint(this.moved.tints, this.values, this.range, this.colours.diverging);
    this.moved.tinted();
    this.panels[2].name('Displacement from the mean');
    this.panels[2].scale(this.colours.diverging, this.range, 'along the normal, outward positive');
    this.stage.draw([1, 2]);
  }

  describe(vertex, panel) {
    const at = point(panel === 0 ? this.middle : this.shape, vertex);
    this.stage.mark(at);
    return `Vertex ${vertex}  (${at.map(short).join(', ')})  displacement ${short(this.values[vertex])}`;
  }

  get tabs() {
    return ['Mean', 'Shape', 'Displacement'];
  }

  get vertices() {
    return this.item.grid.vertices;
  }

  mesh() {
    return { name: this.item.name, positions: this.positions.array, faces: this.faces,
      values: { displacement: this.values }, tints: this.moved.tints };
  }
}
