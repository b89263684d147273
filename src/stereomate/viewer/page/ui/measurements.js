// Measurements: vertices as places on both pictures, what comes of them, and undo.

import { cross, minus, norm } from '../measure/linear.js';

export const KINDS = {
  point: { title: 'Point', letter: 'P', least: 1, most: 1 },
  height: { title: 'Object height', letter: 'H', least: 2, most: 2 },
  line: { title: 'Line', letter: 'L', least: 2, most: Infinity },
  area: { title: 'Area', letter: 'A', least: 3, most: Infinity },
};
const UNDO = 100;
const PROFILE_SAMPLES = 160;
const VOLUME_CELLS = 2500;

export class Measurements {
  constructor(product, changed) {
    this.product = product;
    this.changed = changed;
    this.items = [];
    this.open = null;
    this.past = [];
    this.future = [];
    const { centre_m: centre, angle_deg: angle } = product.orientation_sigma;
    // standard deviations: of a measured coordinate (pixels), of projection centres (m) and of rotations (degrees)
    this.accuracy = { px: 0.3, centre, angle };
    this.selected = null;
    this.generation = 0;
  }

  #snapshot() {
    return JSON.stringify({ items: this.items.map(record), open: this.open && this.open.id });
  }

  #remember() {
    this.past.push(this.#snapshot());
    if (this.past.length > UNDO) this.past.shift();
    this.future = [];
  }

  #restore(text) {
    const { items, open } = JSON.parse(text);
    this.items = items.map((item) => ({ ...item, result: null }));
    this.open = this.items.find((item) => item.id === open) ?? null;
    this.#evaluateAll();
  }

  undo() {
    if (!this.past.length) return false;
    this.future.push(this.#snapshot());
    this.#restore(this.past.pop());
    return true;
  }

  redo() {
    if (!this.future.length) return false;
    this.past.push(this.#snapshot());
    this.#restore(this.future.pop());
    return true;
  }

  // Set a vertex with a tool; a measurement that is full is closed.
  add(kind, left, right) {
    this.#remember();
    if (!this.open || this.open.kind !== kind) {
      this.#drop();
      this.open = { id: this.#nextId(), kind, name: this.#nextName(kind), vertices: [], result: null };
      this.items.push(this.open);
    }
    const item = this.open;
    item.vertices.push({ left: [...left], right: [...right] });
    this.selected = item.id;
    if (item.vertices.length >= KINDS[kind].most) this.open = null;
    this.#evaluate(item);
  }

  #nextId() {
    return this.items.reduce((m, item) => Math.max(m, item.id), 0) + 1;
  }

  #nextName(kind) {
    const letter = KINDS[kind].letter;
    const used = this.items.filter((item) => item.name.startsWith(letter)).map((item) => Number(item.name.slice(1)) || 0);
    return `${letter}${Math.max(0, ...used) + 1}`;
  }

  // An unfinished measurement with too few vertices goes.
  #drop() {
    if (this.open && this.open.vertices.length < KINDS[this.open.kind].least) {
      this.items = this.items.filter((item) => item !== this.open);
    }
    this.open = null;
  }

  finish() {
    if (!this.open) return false;
    this.#remember();
    this.#drop();
    this.changed();
    return true;
  }

  remove(id) {
    this.#remember();
    this.items = this.items.filter((item) => item.id !== id);
    if (this.open?.id === id) this.open = null;
    this.changed();
  }

  rename(id, name) {
    const item = this.items.find((one) => one.id === id);
    if (!item || !name || item.name === name) return;
    this.#remember();
    item.name = name.slice(0, 80);
    this.changed();
  }

  clear() {
    if (!this.items.length) return;
    this.#remember();
    this.items = [];
    this.open = null;
    this.changed();
  }

  // Take measurements from a file, a link or the store; those that are none are left out.
  take(records, keepOld = true) {
    const good = (Array.isArray(records) ? records : []).map(checked).filter(Boolean);
    if (keepOld && good.length) this.#remember();
    if (!keepOld) this.items = [];
    for (const item of good) {
      item.id = this.#nextId();
      this.items.push(item);
    }
    this.open = null;
    this.#evaluateAll();
    return good.length;
  }

  records() {
    return this.items.map(record);
  }

  // Those of the values that can be are taken; measurements follow.
  setAccuracy(values) {
    this.accuracy = accuracyOf(values, this.accuracy);
    this.#evaluateAll();
  }

  #evaluateAll() {
    this.generation++;
    this.changed();
    this.items.forEach((item) => this.#evaluate(item));
  }

  async #evaluate(item) {
    const generation = this.generation, count = item.vertices.length;
    this.changed();
    try {
      const found = await evaluate(this.product, item, this.accuracy);
      if (generation === this.generation && item.vertices.length === count) item.result = found;
    } catch (error) {
      item.result = { error: error.message };
    }
    this.changed();
  }

  get isSettled() {
    return this.items.every((item) => item.result !== null && (item.result.error || item.result.points.length === item.vertices.length));
  }
}

export const inRadians = ({ px, centre, angle }) => ({ px, centre, angle: angle * Math.PI / 180 });

// Standard deviations from a link or a field: nothing in them is trusted.
export function accuracyOf(values, before) {
  const { px, centre, angle } = values ?? {};
  const within = (value, least, most, old) => (typeof value === 'number' && value >= least && value <= most ? value : old);
  return { px: within(px, 0.001, 10, before.px), centre: within(centre, 0, 1000, before.centre), angle: within(angle, 0, 10, before.angle) };
}

const record = ({ id, kind, name, vertices }) => ({ id, kind, name, vertices });

function checked(one) {
  if (!one || typeof one !== 'object' || !Object.hasOwn(KINDS, one.kind) || !Array.isArray(one.vertices)) return null;
  const pair = (p) => Array.isArray(p) && p.length === 2 && p.every((v) => typeof v === 'number' && Number.isFinite(v));
  const vertices = one.vertices.filter((v) => v && pair(v.left) && pair(v.right)).slice(0, 10000);
  const { least, most } = KINDS[one.kind];
  if (vertices.length < least || vertices.length > most) return null;
  const name = String(one.name ?? KINDS[one.kind].letter).slice(0, 80);
  return { id: 0, kind: one.kind, name, vertices: vertices.map((v) => ({ left: [...v.left], right: [...v.right] })), result: null };
}

// Everything that follows from the vertices of a measurement.
export async function evaluate(product, item, accuracy) {
  const points = await Promise.all(item.vertices.map((v) => product.measure(v.left, v.right, inRadians(accuracy))));
  const result = { points };
  if (item.kind === 'height' && points.length === 2) Object.assign(result, objectHeight(points));
  if (item.kind === 'line' && points.length > 1) {
    Object.assign(result, lengths(product, points, false), { profile: await profile(product, points) });
  }
  if (item.kind === 'area' && points.length > 2) {
    Object.assign(result, lengths(product, points, true), await areaAndVolume(product, points));
  }
  return result;
}

function objectHeight([foot, top]) {
  const known = foot.point && top.point;
  return {
    height: known ? top.point[2] - foot.point[2] : NaN,
    heightSigma: known ? Math.hypot(top.sigma[2], foot.sigma[2]) : NaN,
    lawHeight: top.lawHeight - foot.lawHeight,
    leaning: known ? Math.hypot(top.point[0] - foot.point[0], top.point[1] - foot.point[1]) : NaN,
  };
}

const inSpace = (product, p) => (p.point ? product.surface.point(...p.pixel, p.point[2]).point : null);

// Lengths on the map and in space, metres; both ends of each edge measured.
function lengths(product, points, closed) {
  let onMap = 0, spatial = 0, variance = 0;
  const count = closed ? points.length : points.length - 1;
  for (let k = 0; k < count; k++) {
    const a = points[k], b = points[(k + 1) % points.length];
    if (!a.point || !b.point) return { onMap: NaN, spatial: NaN, lengthSigma: NaN };
    const d = [0, 1].map((n) => b.point[n] - a.point[n]);
    const length = Math.hypot(...d);
    onMap += length * product.grid.unit_m;
    spatial += norm(minus(inSpace(product, b), inSpace(product, a)));
    if (length > 0) {
      for (const p of [a, b]) {
        const c = p.covariance;
        variance += (c[0][0] * d[0] ** 2 + 2 * c[0][1] * d[0] * d[1] + c[1][1] * d[1] ** 2) / length ** 2;
      }
    }
  }
  return { onMap, spatial, lengthSigma: Math.sqrt(variance) * product.grid.unit_m };
}

// The height model along a line, and the measured line: distances on the map in metres, heights.
async function profile(product, points) {
  if (points.some((p) => !p.point)) return null;
  const parts = [];
  let total = 0;
  for (let k = 0; k + 1 < points.length; k++) {
    const [a, b] = [points[k], points[k + 1]];
    const length = Math.hypot(b.point[0] - a.point[0], b.point[1] - a.point[1]) * product.grid.unit_m;
    parts.push({ a, b, start: total, length });
    total += length;
  }
  const ground = [];
  for (const { a, b, start, length } of parts) {
    const count = Math.max(2, Math.ceil(PROFILE_SAMPLES * length / (total || 1)));
    const places = Array.from({ length: count + 1 }, (_, k) => {
      const t = k / count;
      return [a.pixel[0] + t * (b.pixel[0] - a.pixel[0]), a.pixel[1] + t * (b.pixel[1] - a.pixel[1]), start + t * length];
    });
    const heights = await groundHeights(product, places);
    places.forEach((p, k) => ground.push([p[2], heights[k]]));
  }
  const measured = [[0, points[0].point[2]], ...parts.map(({ b, start, length }) => [start + length, b.point[2]])];
  return { ground, measured };
}

async function groundHeights(product, places) {
  const surface = await product.loadSurface();
  const window = surface.window(places);
  await surface.tiles.load(window);
  const patch = surface.tiles.patch(window);
  return places.map(([col, row]) => surface.height(patch, col, row));
}

// Area on the map and on the ground (m2), and volumes of the height model over and under the surface that the
// edge spans (mean value coordinates: Floater 2003), m3.
async function areaAndVolume(product, points) {
  if (points.some((p) => !p.point)) return { area: NaN, volumeOver: NaN, volumeUnder: NaN };
  const ring = points.map((p) => p.pixel), heights = points.map((p) => p.point[2]);
  const cell = (product.grid.gsd * product.grid.unit_m) ** 2;
  const map = Math.abs(signedArea(ring)) * cell;
  const cols = ring.map((p) => p[0]), rows = ring.map((p) => p[1]);
  const [c0, c1, r0, r1] = [Math.min(...cols), Math.max(...cols), Math.min(...rows), Math.max(...rows)];
  const step = Math.sqrt(Math.max((c1 - c0) * (r1 - r0), 1e-9) / VOLUME_CELLS);
  const places = [];
  for (let r = r0 + step / 2; r < r1; r += step) {
    for (let c = c0 + step / 2; c < c1; c += step) if (isInside(ring, c, r)) places.push([c, r]);
  }
  const ground = await groundHeights(product, places.length ? places : [ring[0]]);
  const middle = product.surface.point(0.5 * (c0 + c1), 0.5 * (r0 + r1), heights.reduce((s, h) => s + h, 0) / heights.length);
  const onGround = norm(cross(middle.byU, middle.byV)) / product.grid.unit_m ** 2;
  // each place stands for an equal share of the polygon
  const share = places.length ? map * onGround / places.length : 0;
  let over = 0, under = 0;
  places.forEach(([c, r], k) => {
    const base = edgeHeight(ring, heights, c, r), rise = (ground[k] - base) * product.crs.height_unit_m;
    if (rise > 0) over += rise * share; else if (rise < 0) under -= rise * share;
  });
  return { area: map, areaOnGround: map * onGround, volumeOver: over, volumeUnder: under };
}

export function signedArea(ring) {
  return 0.5 * ring.reduce((sum, p, k) => {
    const q = ring[(k + 1) % ring.length];
    return sum + p[0] * q[1] - q[0] * p[1];
  }, 0);
}

export function isInside(ring, x, y) {
  let inside = false;
  for (let i = 0, j = ring.length - 1; i < ring.length; j = i++) {
    const [xi, yi] = ring[i], [xj, yj] = ring[j];
    if ((yi > y) !== (yj > y) && x < (xj - xi) * (y - yi) / (yj - yi) + xi) inside = !inside;
  }
  return inside;
}

// Height at a place inside of the surface through the edge: mean value coordinates.
export function edgeHeight(ring, heights, x, y) {
  const n = ring.length, d = ring.map((p) => [p[0] - x, p[1] - y]), r = d.map((v) => Math.hypot(...v));
  const near = r.findIndex((v) => v < 1e-9);
  if (near >= 0) return heights[near];
  const half = d.map((v, k) => {
    const w = d[(k + 1) % n];
    const sine = v[0] * w[1] - v[1] * w[0], cosine = v[0] * w[0] + v[1] * w[1];
    return Math.tan(0.5 * Math.atan2(sine, cosine));
  });
  let sum = 0, weight = 0;
  for (let k = 0; k < n; k++) {
    const w = (half[(k + n - 1) % n] + half[k]) / r[k];
    sum += w * heights[k];
    weight += w;
  }
  return sum / weight;
}

