// View and measurements in the address and in the browser's store.

const MOST = 30000;

async function squeezed(bytes, kind) {
  const stream = new Blob([bytes]).stream().pipeThrough(kind);
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

async function toText(value) {
  const bytes = await squeezed(new TextEncoder().encode(JSON.stringify(value)), new CompressionStream('deflate-raw'));
  let binary = '';
  for (const b of bytes) binary += String.fromCharCode(b);
  return btoa(binary).replaceAll('+', '-').replaceAll('/', '_').replace(/=+$/, '');
}

async function fromText(text) {
  const binary = atob(text.replaceAll('-', '+').replaceAll('_', '/'));
  const bytes = Uint8Array.from(binary, (c) => c.charCodeAt(0));
  return JSON.parse(new TextDecoder().decode(await squeezed(bytes, new DecompressionStream('deflate-raw'))));
}

export async function hashOf(state) {
  return `#s=${await toText(state)}`;
}

// The state that a link holds; null where there is none or it is damaged.
export async function stateOfHash(hash) {
  const found = /^#s=([\w-]+)$/.exec(hash);
  if (!found) return null;
  try {
    return await fromText(found[1]);
  } catch {
    return null;
  }
}

const storeKey = (product) => `stereomate:${product.key}`;

export function stored(product) {
  try {
    return JSON.parse(localStorage.getItem(storeKey(product)) ?? 'null');
  } catch {
    return null;
  }
}

// Keep the state in the store and, where it is not too long for one, in the address.
export async function keep(product, state) {
  try {
    localStorage.setItem(storeKey(product), JSON.stringify(state));
  } catch {
    // a full or forbidden store: the address still holds it
  }
  const hash = await hashOf(state);
  if (hash.length <= MOST) history.replaceState(null, '', hash);
  return hash;
}

// Numbers of pixels to a thousandth: far below what can be measured, and short.
export function shortVertices(records) {
  const cut = (p) => p.map((v) => Math.round(v * 1000) / 1000);
  return records.map(({ kind, name, vertices }) => ({ kind, name, vertices: vertices.map((v) => ({ left: cut(v.left), right: cut(v.right) })) }));
}
