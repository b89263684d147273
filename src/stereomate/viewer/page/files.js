// Fetching the plain files of a product. Numbers are deflated: a damaged file is an error, not a wrong number.

export class FileError extends Error {}

// Files that were damaged or missing: asked for anew, whatever the browser has kept of them.
const bad = new Set();

function failure(path, text) {
  bad.add(path);
  return new FileError(`${path}: ${text}`);
}

async function get(path, version, signal) {
  let response;
  try {
    response = await fetch(version ? `${path}?v=${version}` : path, { signal, cache: bad.has(path) ? 'reload' : 'default' });
  } catch (error) {
    if (error.name === 'AbortError') throw error;
    throw failure(path, 'no answer');
  }
  if (!response.ok) throw failure(path, response.status);
  return response;
}

export async function fetchJson(path, version) {
  return (await get(path, version)).json();
}

async function inflated(path, version) {
  const response = await get(path, version);
  try {
    const stream = response.body.pipeThrough(new DecompressionStream('deflate'));
    return await new Response(stream).arrayBuffer();
  } catch {
    throw failure(path, 'damaged');
  }
}

export async function fetchDoubles(path, version) {
  return new Float64Array(await inflated(path, version));
}

export async function fetchNumbers(path, version) {
  return new Uint16Array(await inflated(path, version));
}

// An offset (float64), then float32 by places of their bytes.
export async function fetchFloats(path, version) {
  const buffer = await inflated(path, version);
  const offset = new DataView(buffer).getFloat64(0, true);
  const planes = new Uint8Array(buffer, 8), count = planes.length / 4;
  const bytes = new Uint8Array(4 * count);
  for (let k = 0; k < count; k++) {
    bytes[4 * k] = planes[k];
    bytes[4 * k + 1] = planes[count + k];
    bytes[4 * k + 2] = planes[2 * count + k];
    bytes[4 * k + 3] = planes[3 * count + k];
  }
  const small = new Float32Array(bytes.buffer), out = new Float64Array(count);
  for (let k = 0; k < count; k++) out[k] = small[k] + offset;
  return out;
}

// Pixels of an image tile, as a bitmap that the GPU takes as it is.
export async function fetchBitmap(path, version, signal) {
  const response = await get(path, version, signal);
  const blob = await response.blob();
  try {
    const bitmap = await createImageBitmap(blob, { colorSpaceConversion: 'none', premultiplyAlpha: 'none' });
    bad.delete(path);
    return bitmap;
  } catch {
    throw failure(path, 'damaged');
  }
}
