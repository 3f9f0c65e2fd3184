// View of the maps of a test, with a threshold on p.

import { numbers } from './blocks.js';
import { paint, short } from './colours.js';
import { drawn } from './drawn.js';
import { point } from './model.js';

const FIRST = ['effect', 'statistic'];
// The p values of threshold-free clusters if there are any, otherwise family-wise ones, otherwise others.
const PROBABLE = ['p-tfce', 'p-fwe', 'q', 'p'];

export class MapsView {
  static async open(item, { stage, panels, colours }) {
    const view = new MapsView();
    Object.assign(view, { item, stage, panels, colours, level: 1 });
    view.drawn = await drawn(item.mesh);
    view.values = await Promise.all(item.maps.map(({ values }) => numbers(values)));
    const place = (name) => item.maps.findIndex((map) => map.name === name);
    const probable = PROBABLE.map(place).find((index) => index >= 0) ?? null;
    const first = [...FIRST.map(place), probable ?? -1].filter((index) => index >= 0);
    const rest = item.maps.map((_, index) => index).filter((index) => !first.includes(index));
    view.chosen = [...first, ...rest].slice(0, 3);
    view.threshold = probable;
    view.surfaces = [0, 1, 2].map((panel) => (panel < view.chosen.length ? view.drawn.surface(true) : null));
    view.surfaces.forEach((surface, panel) => stage.show(panel, surface));
    stage.frame(view.drawn.positions);
    view.paint();
    return view;
  }

  /** Colours the vertices whose p is at most the level. */
  paint() {
    const { item, panels, colours } = this;
    const p = this.threshold === null ? null : this.values[this.threshold];
    const shown = p && this.level < 1 ? (vertex) => p[vertex] <= this.level : null;
    panels.forEach((panel, k) => {
      const map = item.maps[this.chosen[k]];
      panel.name(map ? map.name : null);
      if (!map) return;
      let values = this.values[this.chosen[k]];
      let [low, high] = map.range;
      if (map.probability) {
        // The smallest p gets the brightest colour.
        values = values.map((value) => -Math.log10(Math.max(value, 1e-300)));
        [low, high] = [0, Math.max(1, -Math.log10(Math.max(low, 1e-300)))];
      }
      const signed = low < 0;
      const stops = signed ? colours.diverging : colours.viridis;
      paint(this.surfaces[k].tints, values, [low, high], stops, shown);
      this.surfaces[k].tinted();
      panel.scale(stops, [low, high], map.label);
    });
    this.below = p ? p.reduce((count, value) => count + (value <= this.level), 0) : null;
    this.stage.draw();
  }

  describe(vertex) {
    const at = point(this.surfaces[0], vertex);
    this.stage.mark(at);
    const values = this.item.maps.map((map, index) => `${map.name} ${short(this.values[index][vertex])}`);
    return [`Vertex ${vertex}`, `(${at.map(short).join(', ')})`, ...values].join('  ');
  }

  get tabs() {
    return this.chosen.map((index) => this.item.maps[index].name);
  }

  /** The panel that narrow pages show first: that of the p values. */
  get first() {
    return Math.max(0, this.chosen.indexOf(this.threshold));
  }

  get vertices() {
    return this.item.mesh.grid.vertices;
  }

  mesh() {
    const { faces, positions } = this.drawn;
    const values = Object.fromEntries(this.item.maps.map((map, index) => [map.name.replace(/\W/g, '_'), this.values[index]]));
    return { name: this.item.name, positions, faces, values, tints: this.surfaces[0].tints };
  }
}
