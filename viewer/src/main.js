// The page's script: reads the page's data and shows them.

import { byId, make } from './dom.js';
import { Engine } from './engine.js';
import { mapsControls, modelControls, modesControls, stop } from './controls.js';
import { MapsView } from './maps.js';
import { ModelView } from './model.js';
import { ModesView } from './modes.js';
import { Panel } from './panels.js';
import { gifti, ply, png, say } from './save.js';
import { AXES, Stage, VIEWS } from './stage.js';
import { sortable } from './tables.js';

const KINDS = {
  model: [ModelView, modelControls],
  modes: [ModesView, modesControls],
  maps: [MapsView, mapsControls],
};

// Read by tests.
const report = { ready: null, view: null };
window.spharmReport = report;

async function start() {
  document.querySelectorAll('table.sortable').forEach(sortable);
  const { items, ...colours } = JSON.parse(byId('info').textContent);
  if (items.length === 0) return;
  const sections = [...document.querySelectorAll('section.item')];
  const viewer = byId('viewer');
  viewer.hidden = false;
  const panels = [...viewer.querySelectorAll('.panel')].map((element) => new Panel(element));
  // For pages with space for only one view.
  const tabs = [...viewer.querySelectorAll('.tabs button')];
  let view = null;
  const pick = (vertex, panel) => {
    say(view.describe(vertex, panel));
    byId('vertex').value = vertex;
    report.picked = [vertex, panel];
    stage.draw();
  };
  let stage;
  let engine;
  // WebAssembly is compiled while the browser starts to draw.
  const starting = Engine.start();
  starting.catch(() => {});
  try {
    stage = new Stage(byId('stage'), panels.map((panel) => panel.element), pick);
    engine = await starting;
  } catch (error) {
    // The pictures remain visible.
    viewer.hidden = true;
    byId('failed').hidden = false;
    byId('failed').textContent = `The views can't be drawn here (${error.message}): pictures take their place.`;
    return;
  }
  document.body.classList.add('drawn');

  /** Updates tabs and readout after each change of the view. */
  const again = () => {
    tabs.forEach((button, k) => {
      button.textContent = view.tabs[k] ?? '';
      button.hidden = panels[k].element.hidden;
    });
    const vertex = Number(byId('vertex').value);
    if (byId('vertex').value === '' || vertex >= view.vertices) return;
    say(view.describe(vertex, 1));
    stage.draw();
  };
  // The buttons of the views, by the views' names.
  const directions = {};
  const open = async (number) => {
    stop();
    const item = items[number];
    select.value = item.kind === 'model' ? number : '';
    choices.forEach((button, k) => {
      button.ariaPressed = k === number;
    });
    const [View, controls] = KINDS[item.kind];
    view = await View.open(item, { engine, stage, panels, colours });
    report.view = view;
    byId('vertex').value = '';
    byId('vertex').max = view.vertices - 1;
    say('Click on a surface for its vertex.');
    Object.entries(directions).forEach(([name, button]) => {
      button.textContent = item.kind === 'model' ? name : AXES[name];
    });
    controls(view, again);
    sections.forEach((section, k) => {
      section.hidden = k !== number;
    });
    tab(view.first ?? 0);
  };

  const tab = (number) => {
    const shown = panels[number].element.hidden ? 1 : number;
    byId('stage').dataset.shown = shown;
    tabs.forEach((button, k) => {
      button.ariaPressed = k === shown;
    });
    stage.resize();
  };
  tabs.forEach((button, k) => button.addEventListener('click', () => tab(k)));

  // Each test and each group's modes have a button; models, which may be many, are in a list.
  const select = byId('item');
  const choices = new Map();
  const models = [];
  items.forEach((item, k) => {
    if (item.kind === 'model') {
      models.push(k);
      select.append(make('option', { value: k }, item.name));
      return;
    }
    choices.set(k, make('button', { type: 'button', onclick: () => open(k) }, item.name));
    byId('choices').append(choices.get(k));
  });
  if (choices.size > 0) select.prepend(make('option', { value: '', disabled: true }, '–'));
  byId('choices').hidden = items.length < 2 || choices.size === 0;
  select.parentElement.hidden = items.length < 2 || models.length === 0;
  select.onchange = () => open(Number(select.value));
  document.querySelectorAll('table.models tbody tr').forEach((row, k) => {
    const [cell] = row.cells;
    const button = make('button', { type: 'button', title: 'Show' }, ...cell.childNodes);
    button.onclick = async () => {
      await open(models[k]);
      viewer.scrollIntoView({ block: 'nearest' });
    };
    cell.append(button);
  });
  for (const [name, [from, up]] of Object.entries(VIEWS)) {
    directions[name] = make('button', { type: 'button' }, name);
    directions[name].onclick = () => stage.view(from, up);
    byId('views').append(directions[name]);
  }
  byId('wireframe').onchange = (event) => {
    stage.wireframe = event.target.checked;
  };
  byId('vertex').oninput = (event) => {
    const vertex = Number(event.target.value);
    if (event.target.value === '' || !Number.isInteger(vertex) || vertex < 0 || vertex >= view.vertices) return;
    say(view.describe(vertex, 1));
    stage.draw();
  };
  byId('save-png').onclick = () => png(stage, panels, view.item.name);
  byId('save-ply').onclick = () => ply(view.mesh());
  byId('save-gifti').onclick = () => gifti(view.mesh());
  stage.canvas.addEventListener('webglcontextlost', () => {
    document.body.classList.remove('drawn');
    viewer.hidden = true;
  });
  Object.assign(report, { stage, open });
  await open(0);
  stage.drawNow();
  report.ready = performance.now();
}

start();
