// Saving: meshes as PLY and as GIfTI, the view as PNG.

import { byId, fileName, save } from './dom.js';

/** Writes a PLY file: little-endian f32, with colours and values at the vertices. */
export function ply({ name, positions, faces, values, tints }) {
  const names = Object.keys(values);
  const count = positions.length / 3;
  const header = [
    'ply',
    'format binary_little_endian 1.0',
    `element vertex ${count}`,
    ...['x', 'y', 'z'].map((axis) => `property float ${axis}`),
    ...['red', 'green', 'blue'].map((channel) => `property uchar ${channel}`),
    ...names.map((value) => `property float ${value}`),
    `element face ${faces.length / 3}`,
    'property list uchar int vertex_indices',
    'end_header\n',
  ].join('\n');
  const width = 15 + 4 * names.length;
  const vertices = new DataView(new ArrayBuffer(width * count));
  for (let i = 0; i < count; i++) {
    const at = width * i;
    for (let c = 0; c < 3; c++) {
      vertices.setFloat32(at + 4 * c, positions[3 * i + c], true);
      vertices.setUint8(at + 12 + c, tints[4 * i + c]);
    }
    names.forEach((value, k) => vertices.setFloat32(at + 15 + 4 * k, values[value][i], true));
  }
  const triangles = new DataView(new ArrayBuffer((13 * faces.length) / 3));
  for (let i = 0; i < faces.length; i += 3) {
    const at = (13 * i) / 3;
    triangles.setUint8(at, 3);
    for (let c = 0; c < 3; c++) triangles.setInt32(at + 1 + 4 * c, faces[i + c], true);
  }
  save(`${fileName(name)}.ply`, 'application/octet-stream', header, vertices, triangles);
}

/** Writes a GIfTI surface: f32 and i32 in base64, which all readers accept. */
export function gifti({ name, positions, faces }) {
  const arrays = [
    array('POINTSET', 'FLOAT32', positions),
    array('TRIANGLE', 'INT32', Int32Array.from(faces)),
  ];
  const head = '<?xml version="1.0" encoding="UTF-8"?>\n<GIFTI Version="1.0" NumberOfDataArrays="2">\n';
  save(`${fileName(name)}.surf.gii`, 'application/xml', head, ...arrays, '</GIFTI>\n');
}

/** Returns one of its arrays, with three values per row. */
function array(intent, type, values) {
  const attributes = {
    Intent: `NIFTI_INTENT_${intent}`,
    DataType: `NIFTI_TYPE_${type}`,
    ArrayIndexingOrder: 'RowMajorOrder',
    Dimensionality: 2,
    Dim0: values.length / 3,
    Dim1: 3,
    Encoding: 'Base64Binary',
    Endian: 'LittleEndian',
    ExternalFileName: '',
    ExternalFileOffset: '',
  };
  const said = Object.entries(attributes).map(([key, value]) => `${key}="${value}"`);
  return `<DataArray ${said.join(' ')}>\n<Data>${base64(values)}</Data>\n</DataArray>\n`;
}

function base64(values) {
  const bytes = new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
  // A multiple of three bytes at a time, so that the encoded pieces can be concatenated.
  const step = 3 << 13;
  let text = '';
  for (let at = 0; at < bytes.length; at += step) text += btoa(String.fromCharCode(...bytes.subarray(at, at + step)));
  return text;
}

/** Writes the views as they appear on screen, with their captions and legends. */
export function png(stage, panels, name) {
  stage.drawNow(2);
  const whole = stage.element.getBoundingClientRect();
  const ratio = stage.renderer.getPixelRatio();
  const picture = document.createElement('canvas');
  [picture.width, picture.height] = [stage.canvas.width, stage.canvas.height];
  const context = picture.getContext('2d');
  const style = getComputedStyle(document.body);
  context.fillStyle = style.backgroundColor;
  context.fillRect(0, 0, picture.width, picture.height);
  context.drawImage(stage.canvas, 0, 0);
  context.scale(ratio, ratio);
  context.fillStyle = style.color;
  context.textBaseline = 'top';
  const text = (element, words) => {
    const box = element.getBoundingClientRect();
    context.font = getComputedStyle(element).font;
    context.fillText(words ?? element.textContent, box.left - whole.left, box.top - whole.top);
  };
  for (const panel of panels) {
    if (panel.element.offsetWidth === 0) continue;
    text(panel.caption);
    if (panel.legend.hidden) continue;
    const bar = panel.bar.getBoundingClientRect();
    context.drawImage(panel.bar, bar.left - whole.left, bar.top - whole.top, bar.width, bar.height);
    [panel.low, panel.label, panel.high].forEach((element) => text(element));
  }
  picture.toBlob((blob) => save(`${fileName(name)}.png`, 'image/png', blob));
}

/** Shows a message in the readout. */
export function say(text) {
  byId('readout').textContent = text;
}
