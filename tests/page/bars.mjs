// Measures pages of `spharm report`, and prints the required limits beside the results: `./run page` calls it.
//
// node bars.mjs PROGRAM [FOLDER of ../shared/data]: writes pages and screenshots to target/page.

import { execFileSync } from 'node:child_process';
import { existsSync, mkdirSync, statSync, writeFileSync } from 'node:fs';
import { cpus, loadavg } from 'node:os';
import { resolve } from 'node:path';

import { barriers } from './accessibility.mjs';
import { launch, open, program, until } from './browser.mjs';
import { readPly, size } from './files.mjs';

const [spharm, data] = process.argv.slice(2).map((path) => resolve(path));
const folder = resolve('../../target/page');
let failed = 0;

/** One bar: what was measured, and whether it is reached. */
function bar(what, found, reached) {
  if (!reached) failed += 1;
  console.log(`${reached ? 'ok    ' : 'FAILED'}  ${what}: ${found}`);
}

const at = (name) => `${folder}/${name}`;
const run = (...words) => execFileSync(spharm, [...words, '-q', '--force'], { cwd: folder, stdio: ['ignore', 'pipe', 'inherit'] });
const megabytes = (file) => statSync(at(file)).size / 1e6;
const median = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];

function prepare() {
  mkdirSync(folder, { recursive: true });
  for (const [name, subdivisions, degree] of [['small', 6, 100], ['large', 7, 200]]) {
    if (existsSync(at(`${name}.spharm.npz`))) continue;
    console.error(`fitting ${name}`);
    run('generate', '--subdivisions', subdivisions, '--surface', `${name}.surf.gii`, '--sphere', `${name}.sphere.surf.gii`);
    run('fit', '--surface', `${name}.surf.gii`, '--sphere', `${name}.sphere.surf.gii`, '--max-degree', degree,
      '-o', `${name}.spharm.npz`, '--report', `${name}.json`);
  }
  for (const name of ['small', 'large']) {
    run('report', `${name}.spharm.npz`, '--surface', `${name}.surf.gii`, '--fit-report', `${name}.json`, '-o', `${name}.html`);
  }
  if (existsSync(at('test/mean.surf.gii'))) return;
  console.error('a study');
  run('generate', '--study', 'meshes', '--subjects', 12, '--bump', 1.5);
  const meshes = execFileSync('sh', ['-c', 'ls meshes/*.ply'], { cwd: folder }).toString().trim().split('\n');
  run('fit', '--max-degree', 15, '-o', 'models', '--surface', ...meshes);
  run('shape', 'align', 'models', '--group', '-o', 'aligned', '--mean', 'mean.spharm.npz');
  run('shape', 'pca', 'aligned', '-o', 'group.shape-model.npz');
  const group = (letter) => execFileSync('sh', ['-c', `ls aligned/${letter}*`], { cwd: folder }).toString().trim().split('\n');
  run('shape', 'test', '--a', ...group('a'), '--b', ...group('b'), '-o', 'test');
}

/** A page in light and dark colours against the rules of axe-core. */
async function accessible(browser, file) {
  for (const dark of [false, true]) {
    const { page } = await open(browser, at(file), { dark });
    const found = await barriers(page);
    bar(`${file}, ${dark ? 'dark' : 'light'}: serious findings of axe-core, none`, found.join('; ') || 'none', found.length === 0);
    await page.context().close();
  }
}

/** Positions and colours in the page against those of the program, at some degrees. */
async function compare(page) {
  const cube = size(readPly(reconstruction(0, 100)));
  for (const degree of [0, 1, 10, 50, 100]) {
    const expected = readPly(reconstruction(degree, degree));
    await page.locator('#degree').fill(String(degree));
    const found = await page.evaluate(() => [...window.spharmReport.view.positions.array]);
    const axes = [expected.x, expected.y, expected.z];
    const worst = found.reduce((most, value, i) => Math.max(most, Math.abs(value - axes[i % 3][Math.floor(i / 3)])), 0);
    bar(`positions at degree ${degree}, of the size, at most 1e-6`, (worst / cube).toExponential(1), worst / cube <= 1e-6);
    run('compare', 'small.surf.gii', `degree${degree}.ply`, '-o', 'compared.ply');
    const { red, green, blue } = readPly(at('compared.ply'));
    const colours = [red, green, blue];
    const tints = await page.evaluate(() => [...window.spharmReport.view.error.tints]);
    const apart = (value, i) => (i % 4 === 3 ? 0 : Math.abs(value - colours[i % 4][Math.floor(i / 4)]));
    const off = tints.reduce((most, value, i) => Math.max(most, apart(value, i)), 0);
    bar(`colours of the distance at degree ${degree}, of 255, at most 1`, off, off <= 1);
  }
}

function reconstruction(name, degree) {
  const file = `degree${degree}.ply`;
  run('reconstruct', '--model', 'small.spharm.npz', '--max-degree', degree, '--double', '-o', file);
  return at(file);
}

async function times(page) {
  const ready = await page.evaluate('window.spharmReport.ready');
  const steps = await page.evaluate(async () => {
    const { view, stage } = window.spharmReport;
    const times = [];
    for (let k = 0; k < 31; k++) {
      const degree = Math.round((view.item.degree * ((k * 7) % 31)) / 30);
      const from = performance.now();
      view.setDegree(degree);
      stage.drawNow();
      const asked = performance.now();
      stage.finish();
      times.push([asked - from, performance.now() - from]);
      await new Promise((resolve) => setTimeout(resolve, 5));
    }
    return times;
  });
  const [step, drawn] = [0, 1].map((k) => median(steps.map((times) => times[k])));
  return { ready, step, drawn };
}

async function standalone(browser, file, most) {
  bar(`${file}, at most ${most} MB`, `${megabytes(file).toFixed(2)} MB`, megabytes(file) <= most);
  const { page, heard } = await open(browser, at(file));
  const measured = await times(page);
  const ready = [measured.ready];
  for (let k = 0; k < 2; k++) {
    const again = await open(browser, at(file));
    ready.push(await again.page.evaluate('window.spharmReport.ready'));
    await again.page.context().close();
  }
  measured.ready = median(ready);
  bar(`${file}: requests and messages of the console, none`, heard.length === 0 ? 'none' : heard.join('; '), heard.length === 0);
  return { page, ...measured };
}

async function narrow(browser, file) {
  const { page, heard } = await open(browser, at(file), { width: 360, height: 640 });
  const found = await page.evaluate(() => {
    const boxes = [...document.querySelectorAll('#viewer button, #viewer select, #viewer input')].filter((e) => e.offsetWidth);
    return {
      wide: document.documentElement.scrollWidth,
      cut: boxes.filter((element) => element.getBoundingClientRect().right > 360).length,
      low: Math.min(...boxes.filter((e) => e.type !== 'checkbox' && e.type !== 'range').map((e) => e.offsetHeight)),
      stage: document.getElementById('stage').getBoundingClientRect().bottom,
      slider: document.getElementById('degree').getBoundingClientRect().bottom,
    };
  });
  const fine = found.wide <= 360 && found.cut === 0 && found.low >= 32 && found.stage < 640 && found.slider < 640;
  bar('360 x 640: nothing cut off, view and slider on the first screen', JSON.stringify(found), fine && heard.length === 0);
  await page.screenshot({ path: at('narrow.png') });
  await page.locator('.tabs button').nth(2).click();
  await page.screenshot({ path: at('narrow-distance.png'), fullPage: true });
  await page.context().close();
}

/** Every control by keyboard, a click on a vertex, downloads. */
async function use(page) {
  const labelled = await page.evaluate(() => {
    const all = [...document.querySelectorAll('button, select, input, [tabindex]')].filter((e) => e.offsetWidth);
    return all.filter((e) => !(e.ariaLabel || e.textContent.trim() || e.labels?.length)).length;
  });
  bar('controls without a name for screen readers, none', labelled, labelled === 0);
  const before = await page.evaluate('window.spharmReport.stage.camera.position.toArray().join()');
  await page.locator('#stage').focus();
  await page.keyboard.press('ArrowLeft');
  const after = await page.evaluate('window.spharmReport.stage.camera.position.toArray().join()');
  bar('the arrow keys turn the views', before !== after ? 'yes' : 'no', before !== after);
  const box = await page.locator('.panel').nth(1).boundingBox();
  await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
  const said = await page.locator('#readout').textContent();
  bar('a click tells vertex, position and distance', said, /^Vertex \d+ {2}\(.*\) {2}distance /.test(said));
  const picked = await page.evaluate(() => {
    const { picked, view, stage } = window.spharmReport;
    const { array } = view.positions;
    const [x, y] = stage.markers[1].position.clone().project(stage.camera).toArray();
    return { there: array[3 * picked[0]] === stage.markers[1].position.x, off: Math.hypot(x, y) };
  });
  bar('the vertex lies where the click was', picked.off.toFixed(3), picked.there || picked.off < 0.1);
  run('reconstruct', '--model', 'small.spharm.npz', '--double', '-o', 'whole.ply');
  for (const [kind, button, file] of [['PLY', '#save-ply', 'saved.ply'], ['GIfTI', '#save-gifti', 'saved.surf.gii']]) {
    const [saved] = await Promise.all([page.waitForEvent('download'), page.locator(button).click()]);
    await saved.saveAs(at(file));
    const report = JSON.parse(run('compare', 'whole.ply', file, '--json'));
    bar(`the ${kind} that is saved is the model`, `xsd ${report.xsd.toExponential(1)}`, report.xsd < 1e-11);
  }
  const [picture] = await Promise.all([page.waitForEvent('download'), page.locator('#save-png').click()]);
  await picture.saveAs(at('saved.png'));
  bar('the PNG that is saved', `${statSync(at('saved.png')).size} bytes`, statSync(at('saved.png')).size > 10_000);
}

async function hostile(browser) {
  const name = `"><img src=x onerror=alert(1)></script><script>document.title='owned'</script>\u202e\u2028'&`;
  writeFileSync(at('hostile.tsv'), `id\tstate\n${name.replace(/[\t"\n]/g, '')}\tfailed\n`);
  run('report', 'mode.spharm.npz', '--title', name, '--status', 'hostile.tsv', '-o', 'hostile.html');
  const { page, heard } = await open(browser, at('hostile.html'));
  const title = await page.title();
  const cells = await page.locator('table.sortable td').allTextContents();
  const fine = heard.length === 0 && title.includes('<img') && cells.some((cell) => cell.includes('onerror'));
  bar('hostile names are text', heard.join('; ') || 'yes', fine);
  await page.context().close();
}

/** A list and a table that show one model of several. */
async function several(browser) {
  run('report', 'small.spharm.npz', 'mode.spharm.npz', '-o', 'several.html');
  const { page, heard } = await open(browser, at('several.html'));
  const shown = 'window.spharmReport.view.item.name';
  await page.locator('#item').selectOption('1');
  await until(page, `${shown} === 'mode'`);
  await page.locator('table.models td button').first().click();
  await until(page, `${shown} === 'small'`);
  bar('list and table show a model', heard.join('; ') || 'yes', heard.length === 0);
  await page.context().close();
}

/** The pictures of a page whose scripts don't run. */
async function still(browser) {
  const { page } = await open(browser, at('group.html'), { scripts: false, wait: false });
  const pictures = await page.locator('.still img').count();
  const first = await page.locator('.still img').first().isVisible();
  bar('without scripts there are pictures', pictures, pictures === 2 && first);
  await page.screenshot({ path: at('without-scripts.png'), fullPage: true });
  await page.context().close();
}

async function without(file) {
  const plain = await launch('--disable-gpu', '--disable-3d-apis');
  const { page, heard } = await open(plain, at(file), { wait: false });
  await until(page, "!document.getElementById('failed').hidden");
  const still = await page.locator('.still img').first().isVisible();
  const errors = heard.filter((line) => line.startsWith('error') || line.startsWith('request'));
  bar('without WebGL a picture takes the place of the views', still && errors.length === 0 ? 'yes' : errors.join('; '), still);
  await page.screenshot({ path: at('without-webgl.png') });
  await plain.close();
}

async function group(browser) {
  writeFileSync(at('status.tsv'), 'id\tstate\tmsd\terror\nsub-02\tdone\t2.5e-5\t\nsub-10\tfailed\t\ttruncated file\nsub-01\tdone\t1e-4\t\n');
  run('report', '--modes', 'group.shape-model.npz', '--test', 'test', '--status', 'status.tsv', '-o', 'group.html', '--title', 'A study');
  const { page, heard } = await open(browser, at('group.html'));
  const kind = 'window.spharmReport.view.item.kind';
  const choices = () => page.locator('#choices button').evaluateAll((all) => all.map((e) => [e.textContent, e.ariaPressed].join(' ')));
  const opened = [await page.evaluate(kind), ...(await choices())].join('; ');
  bar('a group opens with its test', opened, opened === 'maps; test: test true; group: modes false');
  await page.locator('#choices button').nth(1).press('Enter');
  await until(page, `${kind} === 'modes'`);
  await page.locator('#mode-0').fill('2');
  const found = await page.evaluate(() => [...window.spharmReport.view.positions.array]);
  run('shape', 'sample', 'group.shape-model.npz', '--mode', '1=2', '-o', 'mode.spharm.npz');
  run('reconstruct', '--model', 'mode.spharm.npz', '--icosphere', '4', '--double', '-o', 'mode.ply');
  const expected = readPly(at('mode.ply'));
  const axes = [expected.x, expected.y, expected.z];
  const same = found.length >= 3 * expected.x.length;
  const worst = expected.x.reduce((most, _, i) => Math.max(most, ...axes.map((axis, c) => Math.abs(axis[i] - found[3 * i + c]))), 0);
  const relative = worst / size(expected);
  bar('two deviations along a mode, of the size, at most 1e-6', relative.toExponential(1), same && relative <= 1e-6);
  await page.screenshot({ path: at('group-modes.png') });
  await page.locator('#choices button').first().click();
  await until(page, `${kind} === 'maps'`);
  await page.locator('#level').fill('1.3');
  const shown = await page.locator('#level-shown').textContent();
  bar('a threshold counts its vertices', shown, /≤ 0.05: \d+ of \d+ vertices/.test(shown));
  await page.locator('th button').nth(2).click();
  const ids = await page.locator('table.sortable tbody tr td:first-child').allTextContents();
  bar('a click sorts the table', ids.join(' '), ids.join(' ') === 'sub-02 sub-01 sub-10');
  bar('group.html: requests and messages, none', heard.join('; ') || 'none', heard.length === 0);
  await page.waitForTimeout(300);
  await page.screenshot({ path: at('group-test.png'), fullPage: true });
  await page.context().close();
}

if (!program()) {
  console.error('skipped: no Chromium here; install one or set CHROMIUM to its path');
  process.exit(0);
}
prepare();
const browser = await launch();
const small = await standalone(browser, 'small.html', 2.0);
bar('small.html: ready, at most 2 s', `${(small.ready / 1e3).toFixed(2)} s, median of 3`, small.ready <= 2000);
bar('small.html: a step of the slider, at most 60 ms', `${small.step.toFixed(0)} ms, median of 31; ${small.drawn.toFixed(0)} ms until it is drawn`, small.step <= 60);
await compare(small.page);
await use(small.page);
await small.page.screenshot({ path: at('light.png'), fullPage: true });
await small.page.context().close();
const { page: dark } = await open(browser, at('small.html'), { dark: true });
await dark.locator('#sign').selectOption('signed');
await dark.locator('#degree').fill('20');
await dark.waitForTimeout(300);
await dark.screenshot({ path: at('dark.png'), fullPage: true });
await dark.context().close();
await narrow(browser, 'small.html');
const large = await standalone(browser, 'large.html', 6.0);
console.log(`        large.html: ready ${(large.ready / 1e3).toFixed(2)} s, a step ${large.step.toFixed(0)} ms, ${large.drawn.toFixed(0)} ms until it is drawn`);
await large.page.context().close();
await group(browser);
await hostile(browser);
await several(browser);
await still(browser);
for (const file of ['small.html', 'group.html', 'several.html']) await accessible(browser, file);
if (data && existsSync(`${data}/cort40962.surf.gii`)) {
  if (!existsSync(at('cort.spharm.npz'))) {
    run('fit', '--surface', `${data}/cort40962.surf.gii`, '--sphere', `${data}/cort40962.sphere.surf.gii`, '--max-degree', 100, '-o', 'cort.spharm.npz');
  }
  run('report', 'cort.spharm.npz', '--surface', `${data}/cort40962.surf.gii`, '-o', 'cort.html', '--title', 'HCP average');
  const { page } = await standalone(browser, 'cort.html', 2.0);
  await page.screenshot({ path: at('cort.png') });
} else {
  console.error('skipped: no cort40962 in ../shared/data here');
}
await browser.close();
await without('small.html');
console.log(`        load of the machine: ${loadavg()[0].toFixed(1)} on ${cpus().length} processors`);
console.log(failed === 0 ? 'every bar is reached' : `${failed} bars are not reached`);
process.exit(failed === 0 ? 0 : 1);
