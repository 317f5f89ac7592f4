// Packed arrays and the scene: see README.md.

const TYPES = {
  int8: Int8Array,
  int16: Int16Array,
  int32: Int32Array,
  uint32: Uint32Array,
  float32: Float32Array,
};
const MISSING = { int8: -128, int16: -32768, int32: -2147483648 };

export function bytesOf(base64) {
  const text = atob(base64);
  const out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out;
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** The integers (or floats) of a packed array as they were before shuffling and differences. */
export async function unpackedRaw(entry) {
  const shuffled = await inflated(bytesOf(entry.data));
  const Kind = TYPES[entry.dtype];
  const size = Kind.BYTES_PER_ELEMENT;
  const count = shuffled.length / size;
  const bytes = new Uint8Array(shuffled.length);
  for (let b = 0; b < size; b++)
    for (let i = 0, from = b * count; i < count; i++) bytes[i * size + b] = shuffled[from + i];
  const out = new Kind(bytes.buffer);
  if (entry.delta) {
    const row = entry.shape.slice(1).reduce((a, b) => a * b, 1);
    for (let i = row; i < out.length; i++) out[i] = out[i] + out[i - row];
  }
  return out;
}

/** Values of a packed array; NaN where one is not known. */
export async function unpacked(entry, Kind = Float64Array) {
  const raw = await unpackedRaw(entry);
  if (!(entry.dtype in MISSING)) return raw;
  const missing = MISSING[entry.dtype];
  // 1/scale is a whole number in decimal steps: dividing gives the printed decimal exactly
  const inverse = 1 / entry.scale;
  const whole = Math.abs(inverse - Math.round(inverse)) < 1e-6 * inverse ? Math.round(inverse) : 0;
  const out = new Kind(raw.length);
  for (let i = 0; i < raw.length; i++) {
    const value = whole ? raw[i] / whole : raw[i] * entry.scale;
    out[i] = raw[i] === missing ? NaN : entry.offset + value;
  }
  return out;
}

/** The scene in the page, or, where a server shows a session, the one beside it. */
export async function loadScene() {
  const text = document.getElementById("dvf-scene").textContent.trim();
  if (text) return JSON.parse(text);
  const answer = await fetch("scene.json");
  if (!answer.ok) throw new Error(`scene.json: ${answer.status} ${answer.statusText}`);
  return answer.json();
}
