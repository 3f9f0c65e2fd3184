// Up to three views side by side, with one camera, in one canvas.

import {
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  Mesh,
  OrthographicCamera,
  Quaternion,
  Raycaster,
  Scene,
  ShaderMaterial,
  SphereGeometry,
  Vector2,
  Vector3,
  WebGLRenderer,
} from 'three';
import { TrackballControls } from 'three/examples/jsm/controls/TrackballControls.js';

import { plain } from './colours.js';

const VERTEX = `
attribute vec4 tint;
varying vec3 vTint;
varying vec3 vNormal;
void main() {
  vTint = tint.rgb;
  vNormal = normalMatrix * normal;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
// Light from above the left shoulder, plus ambient light. Surfaces whose colours represent values get more ambient
// light, so that their colours match the legend.
const FRAGMENT = `
uniform float ambient;
varying vec3 vTint;
varying vec3 vNormal;
void main() {
  vec3 n = normalize(vNormal);
  if (!gl_FrontFacing) n = -n;
  float direct = 0.72 * max(dot(n, normalize(vec3(-0.35, 0.5, 0.8))), 0.0) + 0.32 * max(n.z, 0.0);
  gl_FragColor = vec4(vTint * (ambient + (1.0 - ambient) * min(direct, 1.0)), 1.0);
}`;
/** Canvas pixels per CSS pixel in each direction: during motion, and at rest, when the higher value smooths edges. */
const COARSE = 1;
const FINE = 2;
/** Milliseconds without a change after which the view is at rest. */
const REST = 160;
/** The first view is of the widest side if the left side has less than this fraction of its area. */
const WIDER = 0.6;
/** Pixels of a view's height reserved for caption and legend. */
const WORDS = 90;
const AMBIENT = { plain: 0.34, coloured: 0.6 };
const MARKER = `
void main() {
  gl_FragColor = vec4(0.85, 0.1, 0.25, 1.0);
}`;

/** Directions from the centre to the camera, and the up directions: those of `spharm picture`. */
export const VIEWS = {
  Left: [[-1, 0, 0], [0, 0, 1]],
  Right: [[1, 0, 0], [0, 0, 1]],
  Front: [[0, 1, 0], [0, 0, 1]],
  Back: [[0, -1, 0], [0, 0, 1]],
  Top: [[0, 0, 1], [0, 1, 0]],
  Bottom: [[0, 0, -1], [0, 1, 0]],
};

/** The same views by the axes of the coordinates, for means, whose frame after an alignment isn't anatomical. */
export const AXES = { Left: 'From \u2212x', Right: 'From +x', Front: 'From +y', Back: 'From \u2212y', Top: 'From +z', Bottom: 'From \u2212z' };

/** A mesh in a view. Only its tints can't be shared with other meshes; `coloured` if the tints have a legend. */
export class Surface {
  constructor(positions, normals, index, coloured = false) {
    this.coloured = coloured;
    this.geometry = new BufferGeometry();
    this.geometry.setIndex(index);
    this.geometry.setAttribute('position', positions);
    this.geometry.setAttribute('normal', normals);
    // Four bytes per vertex, a format that graphics drivers accept without conversion.
    this.tints = new Uint8Array(4 * positions.count);
    plain(this.tints);
    this.geometry.setAttribute('tint', new BufferAttribute(this.tints, 4, true));
  }

  /** Marks the tints as changed. */
  tinted() {
    this.geometry.attributes.tint.needsUpdate = true;
  }

  dispose() {
    this.geometry.dispose();
  }
}

export class Stage {
  constructor(element, panels, onPick) {
    this.element = element;
    this.panels = panels;
    this.canvas = element.querySelector('canvas');
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: false, alpha: true, preserveDrawingBuffer: true });
    // Colours are shown as given, without conversion.
    this.renderer.outputColorSpace = 'srgb-linear';
    this.renderer.setScissorTest(true);
    const lit = ([kind, value]) => {
      const uniforms = { ambient: { value } };
      return [kind, new ShaderMaterial({ uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: DoubleSide })];
    };
    this.materials = Object.fromEntries(Object.entries(AMBIENT).map(lit));
    this.scenes = panels.map(() => new Scene());
    this.surfaces = panels.map(() => null);
    // The panels to draw in the next frame.
    this.stale = new Set();
    const material = new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: MARKER, depthTest: false });
    // Drawn after the surface, which would otherwise cover it.
    this.markers = panels.map(() => Object.assign(new Mesh(new SphereGeometry(1, 12, 8), material), { renderOrder: 1 }));
    this.camera = new OrthographicCamera(-1, 1, 1, -1, 0, 10);
    this.centre = new Vector3();
    this.radius = 1;
    this.controls = new TrackballControls(this.camera, element);
    Object.assign(this.controls, { staticMoving: true, rotateSpeed: 2.5, zoomSpeed: 1.1, panSpeed: 0.8 });
    // By default, keys change the effect of dragging.
    this.controls.keys = [];
    for (const name of ['pointermove', 'pointerup', 'wheel']) {
      element.addEventListener(name, () => this.draw(), { passive: true });
    }
    element.addEventListener('keydown', (event) => this.#key(event));
    this.#picking(onPick);
    new ResizeObserver(() => this.resize()).observe(element);
    this.resize();
  }

  /** Shows a surface, or nothing, in a panel. */
  show(panel, surface) {
    this.surfaces[panel]?.dispose();
    this.surfaces[panel] = surface;
    this.scenes[panel].clear();
    if (surface) {
      const material = surface.coloured ? this.materials.coloured : this.materials.plain;
      this.scenes[panel].add(new Mesh(surface.geometry, material), this.markers[panel]);
    }
    this.mark(null);
  }

  /** Fits the view to points, (n, 3). */
  frame(points) {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    for (let i = 0; i < points.length; i++) {
      if (points[i] < low[i % 3]) low[i % 3] = points[i];
      if (points[i] > high[i % 3]) high[i % 3] = points[i];
    }
    this.centre.set(...low.map((value, k) => 0.5 * (value + high[k])));
    let most = 0;
    const [cx, cy, cz] = this.centre.toArray();
    for (let i = 0; i < points.length; i += 3) {
      most = Math.max(most, (points[i] - cx) ** 2 + (points[i + 1] - cy) ** 2 + (points[i + 2] - cz) ** 2);
    }
    this.radius = Math.sqrt(most) || 1;
    // Viewed from the left, unless another side is much wider.
    const [x, y, z] = low.map((value, k) => high[k] - value);
    const areas = { Left: y * z, Front: x * z, Top: x * y };
    const widest = Object.keys(areas).reduce((best, name) => (areas[name] > areas[best] / WIDER ? name : best));
    this.first = VIEWS[widest];
    this.view(...this.first);
  }

  /** Looks from a direction. */
  view(from, up) {
    this.controls.target.copy(this.centre);
    this.camera.position.set(...from).multiplyScalar(4 * this.radius).add(this.centre);
    this.camera.up.set(...up);
    this.camera.zoom = 1;
    this.resize();
  }

  set wireframe(on) {
    for (const material of Object.values(this.materials)) material.wireframe = on;
    this.draw();
  }

  /** Marks a point, (3), in all views; null for none. */
  mark(point) {
    for (const marker of this.markers) {
      marker.visible = point !== null;
      if (point) marker.position.set(...point);
    }
  }

  resize() {
    const { width, height } = this.element.getBoundingClientRect();
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height, false);
    const panel = this.#visible()[0]?.element.getBoundingClientRect();
    if (panel) {
      // Fits the entire surface, seen from any side, between caption and legend.
      const half = 1.04 * this.radius;
      const scale = half / Math.min(panel.width, Math.max(panel.height - WORDS, 0.5 * panel.height));
      const [x, y] = [scale * panel.width, scale * panel.height];
      Object.assign(this.camera, { left: -x, right: x, top: y, bottom: -y, near: 0, far: 8 * this.radius });
      this.camera.updateProjectionMatrix();
    }
    this.controls.handleResize();
    this.draw();
  }

  /** Draws panels, by default all of them, in the next frame, and again with smooth edges once nothing moves. */
  draw(panels = this.panels.keys()) {
    for (const panel of panels) this.stale.add(panel);
    this.frameAsked ??= requestAnimationFrame(() => {
      this.frameAsked = null;
      this.drawNow(COARSE);
      clearTimeout(this.refining);
      this.refining = setTimeout(() => this.drawNow(FINE), REST);
    });
  }

  /** Draws the panels that have changed, with `detail` canvas pixels per CSS pixel in each direction. */
  drawNow(detail = COARSE) {
    const ratio = Math.max(detail, Math.min(window.devicePixelRatio, FINE));
    if (this.renderer.getPixelRatio() !== ratio || this.stale.size === 0) {
      this.renderer.setPixelRatio(ratio);
      for (const panel of this.panels.keys()) this.stale.add(panel);
    }
    this.controls.update();
    const stage = this.element.getBoundingClientRect();
    const size = (5 * (this.camera.right - this.camera.left)) / (this.camera.zoom * 400);
    this.markers.forEach((marker) => marker.scale.setScalar(size));
    for (const { index, element } of this.#visible()) {
      if (!this.stale.has(index)) continue;
      const { left, bottom, width, height } = element.getBoundingClientRect();
      const place = [left - stage.left, stage.bottom - bottom, width, height];
      this.renderer.setViewport(...place);
      this.renderer.setScissor(...place);
      this.renderer.render(this.scenes[index], this.camera);
    }
    this.stale.clear();
  }

  /** Waits until drawing has finished, for measurements. */
  finish() {
    const gl = this.renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  #visible() {
    const shown = this.panels.map((element, index) => ({ index, element }));
    return shown.filter(({ index, element }) => this.surfaces[index] && element.offsetWidth > 0);
  }

  #key(event) {
    const turns = { ArrowLeft: ['up', 1], ArrowRight: ['up', -1], ArrowUp: ['side', 1], ArrowDown: ['side', -1] };
    const zooms = { '+': 1.2, '=': 1.2, '-': 1 / 1.2 };
    if (event.target !== this.element || event.ctrlKey || event.altKey || event.metaKey) return;
    if (turns[event.key]) {
      const [axis, sign] = turns[event.key];
      const eye = this.camera.position.clone().sub(this.controls.target);
      const around = axis === 'up' ? this.camera.up.clone() : this.camera.up.clone().cross(eye);
      const turn = new Quaternion().setFromAxisAngle(around.normalize(), -sign * (Math.PI / 18));
      this.camera.position.copy(this.controls.target).add(eye.applyQuaternion(turn));
      this.camera.up.applyQuaternion(turn);
    } else if (zooms[event.key]) {
      this.camera.zoom *= zooms[event.key];
      this.camera.updateProjectionMatrix();
    } else if (event.key === '0') {
      this.view(...this.first);
    } else {
      return;
    }
    event.preventDefault();
    this.draw();
  }

  /** Makes a click that isn't a drag pick the nearest vertex. */
  #picking(onPick) {
    let pressed = null;
    this.element.addEventListener('pointerdown', (event) => {
      pressed = [event.clientX, event.clientY];
    });
    this.element.addEventListener('pointerup', (event) => {
      if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4) return;
      for (const { index, element } of this.#visible()) {
        const { left, top, width, height } = element.getBoundingClientRect();
        const [x, y] = [(event.clientX - left) / width, (event.clientY - top) / height];
        if (x < 0 || x > 1 || y < 0 || y > 1) continue;
        const vertex = this.#hit(index, new Vector2(2 * x - 1, 1 - 2 * y));
        if (vertex !== null) onPick(vertex, index);
      }
    });
  }

  #hit(panel, at) {
    const { geometry } = this.surfaces[panel];
    geometry.computeBoundingSphere();
    const caster = new Raycaster();
    caster.setFromCamera(at, this.camera);
    const [hit] = caster.intersectObject(new Mesh(geometry, this.materials.plain));
    if (!hit) return null;
    const positions = geometry.attributes.position;
    const apart = (vertex) => new Vector3().fromBufferAttribute(positions, vertex).distanceTo(hit.point);
    return [hit.face.a, hit.face.b, hit.face.c].sort((p, q) => apart(p) - apart(q))[0];
  }
}
