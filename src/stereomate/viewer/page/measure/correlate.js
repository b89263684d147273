// Image correlation in the page: where the stereomate shows what the orthophoto shows at the mark.

import { fetchBitmap } from '../files.js';
import { EYES } from '../view/tilecache.js';

const KEPT = 24;
// Half of the edge of the window that is compared; ranges of the search along and across the rows, pixels.
const HALF = 9;
export const SEARCH = [16, 3];
const LEAST_SCORE = 0.5;
const LEAST_CONTRAST = 1.5;

// Grey values of tiles at full resolution.
export class GreyTiles {
  constructor(product) {
    this.product = product;
    this.kept = new Map();
  }

  #tile(eye, col, row) {
    const key = `${EYES[eye]}/0/${col}_${row}`;
    let found = this.kept.get(key);
    if (!found) {
      found = this.#read(key);
      found.catch(() => this.kept.delete(key));
      if (this.kept.size >= KEPT) this.kept.delete(this.kept.keys().next().value);
    } else {
      this.kept.delete(key);
    }
    this.kept.set(key, found);
    return found;
  }

  async #read(key) {
    const { folder, version, tiles } = this.product;
    const bitmap = await fetchBitmap(`${folder}/${key}.${tiles.format}`, version);
    const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
    const context = canvas.getContext('2d', { willReadFrequently: true });
    context.drawImage(bitmap, 0, 0);
    const { data, width, height } = context.getImageData(0, 0, bitmap.width, bitmap.height);
    bitmap.close();
    const grey = new Float32Array(width * height);
    for (let k = 0; k < grey.length; k++) {
      grey[k] = 0.299 * data[4 * k] + 0.587 * data[4 * k + 1] + 0.114 * data[4 * k + 2];
    }
    return { grey, width, height };
  }

  // Whole pixels of a window, NaN outside the image.
  async window(eye, col0, row0, cols, rows) {
    const { size, apron } = this.product.tiles, [allCols, allRows] = this.product.grid.size;
    const out = new Float32Array(cols * rows).fill(NaN);
    const tiles = [];
    const c0 = Math.max(col0, 0), r0 = Math.max(row0, 0);
    const c1 = Math.min(col0 + cols, allCols), r1 = Math.min(row0 + rows, allRows);
    for (let r = Math.floor(r0 / size); r * size < r1; r++) {
      for (let c = Math.floor(c0 / size); c * size < c1; c++) tiles.push([c, r]);
    }
    await Promise.all(tiles.map(async ([c, r]) => {
      const tile = await this.#tile(eye, c, r);
      for (let y = Math.max(r0, r * size); y < Math.min(r1, (r + 1) * size); y++) {
        for (let x = Math.max(c0, c * size); x < Math.min(c1, (c + 1) * size); x++) {
          out[(y - row0) * cols + x - col0] = tile.grey[(y - r * size + apron) * tile.width + x - c * size + apron];
        }
      }
    }));
    return { data: out, col0, row0, cols, rows };
  }
}

// Bilinear value at a pixel position (centres at +0.5).
function at(window, col, row) {
  const x = col - window.col0 - 0.5, y = row - window.row0 - 0.5;
  const j = Math.floor(x), i = Math.floor(y), fx = x - j, fy = y - i, k = i * window.cols + j, d = window.data;
  if (!(j >= 0 && i >= 0 && j + 1 < window.cols && i + 1 < window.rows)) return NaN;
  return (1 - fy) * ((1 - fx) * d[k] + fx * d[k + 1]) + fy * ((1 - fx) * d[k + window.cols] + fx * d[k + window.cols + 1]);
}

function template(window, col, row) {
  const out = new Float64Array((2 * HALF + 1) ** 2);
  for (let r = -HALF, k = 0; r <= HALF; r++) for (let c = -HALF; c <= HALF; c++) out[k++] = at(window, col + c, row + r);
  return out;
}

// Less the mean, over the length; null where it has no contrast.
function normalised(values) {
  let mean = 0, square = 0;
  for (const v of values) mean += v;
  mean /= values.length;
  const out = values.map((v) => v - mean);
  for (const v of out) square += v * v;
  const length = Math.sqrt(square);
  return length > LEAST_CONTRAST * Math.sqrt(values.length) ? out.map((v) => v / length) : null;
}

function score(a, values) {
  const b = normalised(values);
  if (!b) return -1;
  let sum = 0;
  for (let k = 0; k < a.length; k++) sum += a[k] * b[k];
  return Number.isFinite(sum) ? sum : -1;
}

// Position on the stereomate of what the orthophoto shows at `left`, near `right`; null where nothing fits.
export async function correlate(tiles, left, right, search = SEARCH) {
  const margin = HALF + 3;
  const span = (p, extra) => [Math.floor(p) - margin - extra, 2 * (margin + extra) + 2];
  const [lc, lw] = span(left[0], 0), [lr, lh] = span(left[1], 0);
  const [rc, rw] = span(right[0], search[0]), [rr, rh] = span(right[1], search[1]);
  const [a, b] = await Promise.all([tiles.window(0, lc, lr, lw, lh), tiles.window(1, rc, rr, rw, rh)]);
  const pattern = normalised(template(a, left[0], left[1]));
  if (!pattern || !pattern.every(Number.isFinite)) return null;
  let best = { score: -1, dx: 0, dy: 0 };
  for (let dy = -search[1]; dy <= search[1]; dy++) {
    for (let dx = -search[0]; dx <= search[0]; dx++) {
      const found = score(pattern, template(b, right[0] + dx, right[1] + dy));
      if (found > best.score) best = { score: found, dx, dy };
    }
  }
  if (best.score < LEAST_SCORE || Math.abs(best.dx) === search[0]) return null;
  return refined(a, b, left, [right[0] + best.dx, right[1] + best.dy]);
}

// Least-squares matching of two shifts, a stretch along the row, gain and offset.
function refined(a, b, left, start) {
  let [x, y] = start, stretch = 1;
  const pattern = template(a, left[0], left[1]);
  let residual = Infinity, normals = null;
  for (let round = 0; round < 20; round++) {
    normals = new Float64Array(25);
    const right = new Float64Array(5);
    let square = 0, count = 0;
    const line = new Float64Array(5);
    // radiometry first, so that the derivatives are of the corrected image
    const shown = [];
    for (let r = -HALF; r <= HALF; r++) for (let c = -HALF; c <= HALF; c++) shown.push([x + stretch * c, y + r, c]);
    const values = shown.map(([u, v]) => at(b, u, v));
    if (!values.every(Number.isFinite)) return null;
    const [gain, offset] = radiometry(values, pattern);
    for (let k = 0; k < values.length; k++) {
      const [u, v, c] = shown[k];
      const gx = gain * (at(b, u + 0.5, v) - at(b, u - 0.5, v)), gy = gain * (at(b, u, v + 0.5) - at(b, u, v - 0.5));
      line[0] = gx; line[1] = gy; line[2] = gx * c; line[3] = values[k]; line[4] = 1;
      const e = pattern[k] - gain * values[k] - offset;
      if (!Number.isFinite(e + gx + gy)) return null;
      square += e * e;
      count++;
      for (let i = 0; i < 5; i++) {
        right[i] += line[i] * e;
        for (let j = 0; j < 5; j++) normals[5 * i + j] += line[i] * line[j];
      }
    }
    const step = solve(normals, right, 5);
    if (!step) return null;
    x += step[0];
    y += step[1];
    stretch += step[2];
    residual = Math.sqrt(square / Math.max(count - 5, 1));
    if (!(Math.hypot(x - start[0], y - start[1]) < 3 && Math.abs(stretch - 1) < 0.3)) return null;
    if (Math.abs(step[0]) + Math.abs(step[1]) < 1e-3) break;
  }
  const cofactor = [0, 1].map((k) => solve(normals, Float64Array.from({ length: 5 }, (_, i) => (i === k ? 1 : 0)), 5)[k]);
  const last = [];
  for (let r = -HALF; r <= HALF; r++) for (let c = -HALF; c <= HALF; c++) last.push(at(b, x + stretch * c, y + r));
  const fit = score(normalised(pattern), Float64Array.from(last));
  if (fit < LEAST_SCORE) return null;
  return { right: [x, y], score: fit, sigma: cofactor.map((q) => residual * Math.sqrt(q)) };
}

function radiometry(values, pattern) {
  const n = values.length;
  const mean = (v) => v.reduce((s, x) => s + x, 0) / n;
  const mv = mean(values), mp = mean(pattern);
  let vp = 0, vv = 0;
  for (let k = 0; k < n; k++) {
    vp += (values[k] - mv) * (pattern[k] - mp);
    vv += (values[k] - mv) ** 2;
  }
  const gain = vv > 0 ? vp / vv : 1;
  return [gain, mp - gain * mv];
}

// Solution of normal equations by Gauss with pivots; null where there is none.
function solve(matrix, right, n) {
  const m = Float64Array.from(matrix), b = Float64Array.from(right);
  for (let k = 0; k < n; k++) {
    let pivot = k;
    for (let i = k + 1; i < n; i++) if (Math.abs(m[i * n + k]) > Math.abs(m[pivot * n + k])) pivot = i;
    if (!(Math.abs(m[pivot * n + k]) > 1e-12)) return null;
    if (pivot !== k) {
      for (let j = 0; j < n; j++) [m[k * n + j], m[pivot * n + j]] = [m[pivot * n + j], m[k * n + j]];
      [b[k], b[pivot]] = [b[pivot], b[k]];
    }
    for (let i = k + 1; i < n; i++) {
      const f = m[i * n + k] / m[k * n + k];
      for (let j = k; j < n; j++) m[i * n + j] -= f * m[k * n + j];
      b[i] -= f * b[k];
    }
  }
  for (let k = n - 1; k >= 0; k--) {
    for (let j = k + 1; j < n; j++) b[k] -= m[k * n + j] * b[j];
    b[k] /= m[k * n + k];
  }
  return [...b];
}
