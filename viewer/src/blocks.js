// Decoding of the arrays in the page: base64, gzip, planes of bytes (crates/report/src/blocks.rs).

const TYPES = { f32: Float32Array, i32: Int32Array, i16: Int16Array };

const unpacked = new Map();

/** Decodes base64 to bytes. */
function decode(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  return Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
}

/** Returns the decompressed bytes of an element. */
export async function bytes(id) {
  const packed = decode(document.getElementById(id).textContent);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Returns the numbers of a block as a typed array, which is cached for later calls and must not be changed. */
export function numbers(block) {
  const key = `${block.id} ${block.kind}`;
  if (!unpacked.has(key)) unpacked.set(key, unpack(block));
  return unpacked.get(key);
}

async function unpack({ id, kind, length }) {
  const planes = await bytes(`data-${id}`);
  const values = new TYPES[kind](length);
  const whole = new Uint8Array(values.buffer);
  const width = values.BYTES_PER_ELEMENT;
  for (let plane = 0; plane < width; plane++) {
    const from = plane * length;
    for (let i = 0; i < length; i++) whole[i * width + plane] = planes[from + i];
  }
  return values;
}
