// The ground that a product was made with, in its pixels: heights with slopes, points in the tangent frame, and
// the ground that a position on the stereomate shows. Port of stereomate/stereo/surface.py.

import { BASE, DEM } from './lattice.js';
import { bilinearGradient, cubicGradient } from './heights.js';

const APRON = 4;

export class Surface {
  constructor(record, lattice, heights, law) {
    this.grid = record.grid;
    this.range = record.height_range;
    this.lattice = lattice;
    this.tiles = heights;
    this.law = law;
    this.isCubic = record.interpolation === 'cubic';
    this.gradient = this.isCubic ? cubicGradient : bilinearGradient;
    this.scale = record.heights.scale;
    this.cell = Math.min(...record.heights.cell_m) / record.grid.unit_m;
  }

  // Window of the height model around places (col, row) of the product.
  window(places) {
    let c0 = Infinity, r0 = Infinity, c1 = -Infinity, r1 = -Infinity;
    for (const [col, row] of places) {
      const [c, r] = this.lattice.at(col, row, DEM, DEM + 2);
      c0 = Math.min(c0, c); c1 = Math.max(c1, c);
      r0 = Math.min(r0, r); r1 = Math.max(r1, r);
    }
    if (!Number.isFinite(c0 + r0 + c1 + r1)) return [0, 0, 0, 0];
    c0 = Math.floor(c0) - APRON; r0 = Math.floor(r0) - APRON;
    return [c0, r0, Math.floor(c1) + APRON + 1 - c0, Math.floor(r1) + APRON + 1 - r0];
  }

  // (h, dh/du, dh/dv) at a pixel position, with a patch that holds it.
  heights(patch, col, row) {
    const { value, byCol, byRow } = this.lattice.withSlopes(col, row, DEM, DEM + 3);
    const [h, hc, hr] = this.gradient(patch, value[0], value[1]);
    const gsd = this.grid.gsd, s = this.scale;
    const byU = (k) => byCol[k] / gsd, byV = (k) => -byRow[k] / gsd;
    return [
      s * h + value[2],
      s * (hc * byU(0) + hr * byU(1)) + byU(2),
      s * (hc * byV(0) + hr * byV(1)) + byV(2),
    ];
  }

  // Height alone.
  height(patch, col, row) {
    const [c, r, offset] = this.lattice.at(col, row, DEM, DEM + 3);
    return this.scale * this.gradient(patch, c, r)[0] + offset;
  }

  // Point in the tangent frame, and derivatives by u, v and h.
  point(col, row, h) {
    const { value, byCol, byRow } = this.lattice.withSlopes(col, row, BASE, BASE + 6);
    const gsd = this.grid.gsd;
    const point = [0, 1, 2].map((k) => value[k] + h * value[3 + k]);
    const byU = [0, 1, 2].map((k) => (byCol[k] + h * byCol[3 + k]) / gsd);
    const byV = [0, 1, 2].map((k) => -(byRow[k] + h * byRow[3 + k]) / gsd);
    return { point, byU, byV, byH: [value[3], value[4], value[5]] };
  }

  // Part of a stereomate row's ground: columns of the ground that can appear at column `shown`.
  reach(shown) {
    const gsd = this.grid.gsd, step = 0.5 * Math.min(gsd, this.cell) / gsd;
    const [low, high] = this.range.map((h) => this.law.q(h) / gsd);
    return { start: shown + low - 2 * step, end: shown + high + 2 * step, step };
  }

  // Column of the ground shown at (shown, row) of the stereomate: the largest, and how many there are.
  shown(patch, shown, row) {
    const { start, end, step } = this.reach(shown);
    const gsd = this.grid.gsd, length = end - start;
    if (!(length > 0)) return { col: NaN, branches: 0 };
    // position in the height model: quadratic along so short a row, as in the kernel
    const nodes = [start, 0.5 * (start + end), end].map((col) => this.lattice.at(col, row, DEM, DEM + 3));
    const excess = (t) => {
      const a = (1 - t) * (1 - 2 * t), b = 4 * t * (1 - t), c = t * (2 * t - 1);
      const mix = (k) => a * nodes[0][k] + b * nodes[1][k] + c * nodes[2][k];
      const h = this.scale * this.gradient(patch, mix(0), mix(1))[0] + mix(2);
      return start + length * t - this.law.q(h) / gsd - shown;
    };
    const count = Math.max(1, Math.ceil(length / step));
    let right = NaN, branches = 0, col = NaN;
    for (let m = count; m >= 0; m--) {
      const f = excess(m / count);
      if (!Number.isNaN(right) && !Number.isNaN(f) && (f < 0) !== (right < 0)) {
        branches++;
        if (branches === 1) {
          let low = m / count, high = (m + 1) / count;
          const negative = f < 0;
          for (let k = 0; k < 60; k++) {
            const middle = 0.5 * (low + high);
            if ((excess(middle) < 0) === negative) low = middle; else high = middle;
          }
          col = start + length * 0.5 * (low + high);
        }
      }
      right = f;
    }
    return { col, branches };
  }
}
