// The lattice of a product: map, height model and tangent frame between nodes, by cubics through 4 x 4 nodes.

export const BASE = 0;
export const NORMAL = 3;
export const DEM = 6;
export const DEGREES = 9;

function weights(f, out) {
  out[0] = -f * (f - 1) * (f - 2) / 6;
  out[1] = (f + 1) * (f - 1) * (f - 2) / 2;
  out[2] = -(f + 1) * f * (f - 2) / 2;
  out[3] = (f + 1) * f * (f - 1) / 6;
}

function slopes(f, out) {
  out[0] = -(3 * f * f - 6 * f + 2) / 6;
  out[1] = (3 * f * f - 4 * f - 1) / 2;
  out[2] = -(3 * f * f - 2 * f - 2) / 2;
  out[3] = (3 * f * f - 1) / 6;
}

const wx = new Float64Array(4), wy = new Float64Array(4), sx = new Float64Array(4), sy = new Float64Array(4);

export class Lattice {
  constructor(record, values) {
    Object.assign(this, record);
    this.count = record.values;
    this.nodes = values;
  }

  #cell(col, row) {
    const x = (col - this.col0) / this.step, y = (row - this.row0) / this.step;
    const j = Math.min(Math.max(Math.floor(x), 1), this.cols - 3);
    const i = Math.min(Math.max(Math.floor(y), 1), this.rows - 3);
    weights(x - j, wx);
    weights(y - i, wy);
    return [i, j, x - j, y - i];
  }

  // Values first .. last - 1 at a pixel position.
  at(col, row, first = 0, last = this.count) {
    const [i, j] = this.#cell(col, row);
    const out = new Float64Array(last - first);
    for (let k = 0; k < 4; k++) {
      for (let m = 0; m < 4; m++) {
        const w = wy[k] * wx[m], at = ((i - 1 + k) * this.cols + j - 1 + m) * this.count;
        for (let n = first; n < last; n++) out[n - first] += w * this.nodes[at + n];
      }
    }
    return out;
  }

  // Values and their derivatives by column and by row.
  withSlopes(col, row, first = 0, last = this.count) {
    const [i, j, fx, fy] = this.#cell(col, row);
    slopes(fx, sx);
    slopes(fy, sy);
    const size = last - first;
    const value = new Float64Array(size), byCol = new Float64Array(size), byRow = new Float64Array(size);
    for (let k = 0; k < 4; k++) {
      for (let m = 0; m < 4; m++) {
        const at = ((i - 1 + k) * this.cols + j - 1 + m) * this.count + first;
        const w = wy[k] * wx[m], wc = wy[k] * sx[m] / this.step, wr = sy[k] * wx[m] / this.step;
        for (let n = 0; n < size; n++) {
          const node = this.nodes[at + n];
          value[n] += w * node;
          byCol[n] += wc * node;
          byRow[n] += wr * node;
        }
      }
    }
    return { value, byCol, byRow };
  }

  degrees(col, row) {
    const [lon, lat] = this.at(col, row, DEGREES, DEGREES + 2);
    return [lon, lat];
  }

  // Direction of true north on the screen: (dcol, drow) of unit length.
  north(col, row) {
    const { byCol, byRow } = this.withSlopes(col, row, DEGREES, DEGREES + 2);
    // the step that leaves the longitude as it is, towards higher latitudes
    let d = [byRow[0], -byCol[0]];
    if (d[0] * byCol[1] + d[1] * byRow[1] < 0) d = [-d[0], -d[1]];
    const length = Math.hypot(d[0], d[1]);
    return [d[0] / length, d[1] / length];
  }
}
