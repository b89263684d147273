// The height model of a product in its own pixels: tiles that are fetched when asked for, patches cut from them.

import { fetchFloats } from '../files.js';

export class HeightTiles {
  constructor(record, folder, version) {
    Object.assign(this, record);
    this.folder = folder;
    this.version = version;
    this.loaded = new Map();
    this.pending = new Map();
    this.lastNumber = -1;
  }

  #range(col0, row0, cols, rows) {
    const c0 = Math.max(col0 - this.col0, 0), r0 = Math.max(row0 - this.row0, 0);
    const c1 = Math.min(col0 + cols - this.col0, this.cols), r1 = Math.min(row0 + rows - this.row0, this.rows);
    const names = [];
    if (c1 <= c0 || r1 <= r0) return names;
    const t = this.tile;
    for (let r = Math.floor(r0 / t); r <= Math.floor((r1 - 1) / t); r++) {
      for (let c = Math.floor(c0 / t); c <= Math.floor((c1 - 1) / t); c++) names.push([c, r]);
    }
    return names;
  }

  // Whether a window of the model can be cut at once.
  has(window) {
    return this.#range(...window).every(([c, r]) => this.loaded.has(`${c}_${r}`));
  }

  async load(window) {
    await Promise.all(this.#range(...window).map(([c, r]) => this.#fetch(c, r)));
  }

  #fetch(c, r) {
    const key = `${c}_${r}`;
    if (this.loaded.has(key)) return null;
    if (!this.pending.has(key)) {
      const job = fetchFloats(`${this.folder}/heights/${key}.bin`, this.version)
        .then((values) => this.loaded.set(key, values))
        .finally(() => this.pending.delete(key));
      this.pending.set(key, job);
    }
    return this.pending.get(key);
  }

  // Height of one node of the model; NaN outside, in a void, and where its tile is not loaded.
  node(col, row) {
    const c = col - this.col0, r = row - this.row0, t = this.tile;
    if (!(c >= 0 && r >= 0 && c < this.cols && r < this.rows)) return NaN;
    const tc = Math.floor(c / t), tr = Math.floor(r / t), number = tr * this.cols + tc;
    if (number !== this.lastNumber) {
      this.lastTile = this.loaded.get(`${tc}_${tr}`);
      this.lastNumber = this.lastTile ? number : -1;
    }
    return this.lastTile ? this.lastTile[(r - tr * t) * Math.min(t, this.cols - tc * t) + c - tc * t] : NaN;
  }

  // Heights of a window whose tiles are loaded, clamped to the model; NaN = void.
  patch(window) {
    const [modelCols, modelRows] = this.model_size;
    const c0 = Math.max(window[0], 0), r0 = Math.max(window[1], 0);
    const cols = Math.max(Math.min(window[0] + window[2], modelCols) - c0, 0);
    const rows = Math.max(Math.min(window[1] + window[3], modelRows) - r0, 0);
    const data = new Float64Array(cols * rows).fill(NaN);
    const t = this.tile;
    for (const [c, r] of this.#range(c0, r0, cols, rows)) {
      const tile = this.loaded.get(`${c}_${r}`);
      if (!tile) continue;
      const left = c * t + this.col0, top = r * t + this.row0;
      const width = Math.min(t, this.cols - c * t), height = Math.min(t, this.rows - r * t);
      const from = Math.max(left, c0), to = Math.min(left + width, c0 + cols);
      for (let y = Math.max(top, r0); y < Math.min(top + height, r0 + rows); y++) {
        const source = (y - top) * width + from - left;
        data.set(tile.subarray(source, source + to - from), (y - r0) * cols + from - c0);
      }
    }
    return { data, col0: c0, row0: r0, cols, rows };
  }
}

// (h, dh/dcol, dh/drow) of the bilinear surface at a position of the model; NaN outside and next to voids.
export function bilinearGradient(patch, col, row) {
  const { data, cols, rows } = patch;
  const x = col - patch.col0 - 0.5, y = row - patch.row0 - 0.5;
  if (cols < 2 || rows < 2 || !(x >= 0 && y >= 0 && x <= cols - 1 && y <= rows - 1)) return [NaN, NaN, NaN];
  const j = Math.min(Math.floor(x), cols - 2), i = Math.min(Math.floor(y), rows - 2);
  const fx = x - j, fy = y - i, at = i * cols + j;
  const topStep = data[at + 1] - data[at], bottomStep = data[at + cols + 1] - data[at + cols];
  const top = data[at] + fx * topStep, bottom = data[at + cols] + fx * bottomStep;
  return [top + fy * (bottom - top), topStep + fy * (bottomStep - topStep), bottom - top];
}

const cubicWeights = (f) => [
  ((1 - 0.5 * f) * f - 0.5) * f, (1.5 * f - 2.5) * f * f + 1, ((2 - 1.5 * f) * f + 0.5) * f, (0.5 * f - 0.5) * f * f];
const cubicSlopes = (f) => [
  (2 - 1.5 * f) * f - 0.5, (4.5 * f - 5) * f, (4 - 4.5 * f) * f + 0.5, (1.5 * f - 1) * f];

// The same of the bicubic (Catmull-Rom) surface.
export function cubicGradient(patch, col, row) {
  const { data, cols, rows } = patch;
  const x = col - patch.col0 - 0.5, y = row - patch.row0 - 0.5;
  if (cols < 4 || rows < 4 || !(x >= 1 && y >= 1 && x <= cols - 2 && y <= rows - 2)) return [NaN, NaN, NaN];
  const j = Math.min(Math.floor(x), cols - 3), i = Math.min(Math.floor(y), rows - 3);
  const wx = cubicWeights(x - j), sx = cubicSlopes(x - j), wy = cubicWeights(y - i), sy = cubicSlopes(y - i);
  let h = 0, hCol = 0, hRow = 0;
  for (let k = 0; k < 4; k++) {
    let line = 0, step = 0;
    for (let m = 0; m < 4; m++) {
      const node = data[(i - 1 + k) * cols + j - 1 + m];
      line += wx[m] * node;
      step += sx[m] * node;
    }
    h += wy[k] * line;
    hCol += wy[k] * step;
    hRow += sy[k] * line;
  }
  return [h, hCol, hRow];
}
