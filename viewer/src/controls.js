// The controls of each kind of item.

import { byId, make, row } from './dom.js';

/** Shows the controls of one kind of item and hides the others. */
function only(kind) {
  for (const element of document.querySelectorAll('[data-of]')) element.hidden = element.dataset.of !== kind;
}

let playing = null;

export function stop() {
  clearTimeout(playing);
  playing = null;
  byId('play').textContent = 'Play';
}

export function modelControls(view, again) {
  only('model');
  const [slider, shown] = [byId('degree'), byId('degree-shown')];
  const set = (degree) => {
    view.setDegree(degree);
    slider.value = degree;
    shown.textContent = degree;
    again();
  };
  slider.max = view.item.degree;
  slider.oninput = () => {
    stop();
    set(Number(slider.value));
  };
  byId('play').onclick = () => {
    if (playing !== null) return stop();
    byId('play').textContent = 'Pause';
    const most = view.item.degree;
    let degree = view.degree >= most ? 0 : view.degree;
    const step = () => {
      set(degree);
      // The first degrees change the most.
      degree += degree < 20 ? 1 : Math.max(1, Math.round(most / 60));
      if (view.degree === most) return stop();
      degree = Math.min(degree, most);
      playing = setTimeout(step, 120);
    };
    step();
  };
  const [sign, limit] = [byId('sign'), byId('limit')];
  sign.disabled = view.item.reference.kind === 'surface';
  sign.value = 'distance';
  limit.value = '';
  const colours = () => {
    view.signed = sign.value === 'signed';
    const entered = Number(limit.value);
    view.limit = entered > 0 ? entered : null;
    view.measure();
    again();
  };
  sign.onchange = colours;
  limit.oninput = colours;
  set(view.item.degree);
}

export function modesControls(view, again) {
  only('modes');
  const sliders = view.item.deviations.map((_, k) => {
    const id = `mode-${k}`;
    const shown = make('output', { className: 'value', htmlFor: id });
    const share = `${(100 * view.item.shares[k]).toFixed(1)} %`;
    const input = make('input', { id, type: 'range', min: -3, max: 3, step: 0.1, value: 0 });
    input.oninput = () => update();
    return { input, shown, row: row(`Mode ${k + 1}, ${share}`, id, input, shown) };
  });
  const update = () => {
    const deviations = sliders.map(({ input }) => Number(input.value));
    sliders.forEach(({ shown }, k) => {
      shown.textContent = `${deviations[k].toFixed(1).replace('-', '−')} sd`;
    });
    view.set(deviations);
    again();
  };
  const member = make('select', { id: 'member' }, make('option', { value: '' }, 'Mean'));
  view.item.members.forEach(({ name }, k) => member.append(make('option', { value: k }, name)));
  member.onchange = () => {
    const scores = member.value === '' ? [] : view.item.members[Number(member.value)].scores;
    sliders.forEach(({ input }, k) => {
      input.value = scores[k] ?? 0;
    });
    update();
  };
  byId('modes').replaceChildren(row('Member', 'member', member), ...sliders.map((slider) => slider.row));
  update();
}

export function mapsControls(view, again) {
  only('maps');
  const selects = view.chosen.map((chosen, panel) => {
    const id = `map-${panel}`;
    const select = make('select', { id });
    view.item.maps.forEach((map, k) => select.append(make('option', { value: k, selected: k === chosen }, map.name)));
    select.onchange = () => {
      view.chosen[panel] = Number(select.value);
      view.paint();
      again();
    };
    return row(`View ${panel + 1}`, id, select);
  });
  byId('maps').replaceChildren(...selects);
  const [slider, shown] = [byId('level'), byId('level-shown')];
  byId('threshold').hidden = view.threshold === null;
  if (view.threshold !== null) byId('level-name').textContent = `Threshold, ${view.item.maps[view.threshold].name}`;
  slider.value = 0;
  slider.oninput = () => {
    // 1 at the left end, then 0.1, 0.05, 0.01 and so on.
    view.level = 10 ** -Number(slider.value);
    view.paint();
    const level = Number(view.level.toPrecision(2));
    shown.textContent = view.level >= 1 ? 'all' : `≤ ${level}: ${view.below} of ${view.vertices} vertices`;
    again();
  };
  slider.oninput();
}
