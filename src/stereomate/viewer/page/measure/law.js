// Parallax laws q(h), inverse and slope: the same formulas as stereomate/parallax/kernels/law.py.

export const NONE = 0;
export const LINEAR = 1;
export const LOGARITHMIC = 2;
export const NATURAL = 3;
export const TABLE = 4;
const HEAD = 4;

function knotBelow(values, first, count, value) {
  let low = 0, high = count - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[first + middle] <= value) low = middle; else high = middle;
  }
  return low;
}

function hermite(h0, h1, q0, q1, m0, m1, h) {
  const width = h1 - h0, s = (h - h0) / width, secant = (q1 - q0) / width;
  const c2 = 3 * secant - 2 * m0 - m1, c3 = m0 + m1 - 2 * secant;
  return [q0 + width * s * (m0 + s * (c2 + s * c3)), m0 + s * (2 * c2 + s * 3 * c3)];
}

export class Law {
  constructor(record) {
    this.kind = record.kind;
    this.code = record.code;
    this.parameters = record.parameters;
    [this.base, this.w0, this.reference] = record.parameters;
  }

  // Artificial parallax in ground units of ground at a height; NaN at or above the flying height.
  q(height) {
    const h = height - this.reference;
    switch (this.code) {
      case LINEAR: return this.base * h / this.w0;
      case LOGARITHMIC: return h < this.w0 ? -this.base * Math.log1p(-h / this.w0) : NaN;
      case NATURAL: return h < this.w0 ? this.base * h / (this.w0 - h) : NaN;
      case TABLE: return this.#table(h)[0];
      default: return 0 * h;
    }
  }

  slope(height) {
    const h = height - this.reference;
    switch (this.code) {
      case LINEAR: return this.base / this.w0 + 0 * h;
      case LOGARITHMIC: return h < this.w0 ? this.base / (this.w0 - h) : NaN;
      case NATURAL: return h < this.w0 ? this.base * this.w0 / (this.w0 - h) ** 2 : NaN;
      case TABLE: return this.#table(h)[1];
      default: return 0 * h;
    }
  }

  // Height that shows an artificial parallax; NaN where none does.
  inverse(q) {
    switch (this.code) {
      case LINEAR: return this.reference + this.w0 * q / this.base;
      case LOGARITHMIC: return this.reference - this.w0 * Math.expm1(-q / this.base);
      case NATURAL: return q > -this.base ? this.reference + this.w0 * q / (this.base + q) : NaN;
      case TABLE: return this.reference + this.#tableHeight(q);
      default: return NaN;
    }
  }

  #table(h) {
    const p = this.parameters, n = p[3], q = HEAD + n, m = HEAD + 2 * n;
    if (h <= p[HEAD]) return [p[q] + p[m] * (h - p[HEAD]), p[m]];
    if (h >= p[q - 1]) return [p[m - 1] + p[m + n - 1] * (h - p[q - 1]), p[m + n - 1]];
    const k = knotBelow(p, HEAD, n, h);
    return hermite(p[HEAD + k], p[HEAD + k + 1], p[q + k], p[q + k + 1], p[m + k], p[m + k + 1], h);
  }

  #tableHeight(parallax) {
    const p = this.parameters, n = p[3], q = HEAD + n, m = HEAD + 2 * n;
    if (parallax <= p[q]) return p[HEAD] + (parallax - p[q]) / p[m];
    if (parallax >= p[m - 1]) return p[q - 1] + (parallax - p[m - 1]) / p[m + n - 1];
    const k = knotBelow(p, q, n, parallax);
    let low = p[HEAD + k], high = p[HEAD + k + 1];
    const h0 = low, h1 = high, q0 = p[q + k], q1 = p[q + k + 1];
    let h = h0 + (h1 - h0) * (parallax - q0) / (q1 - q0);
    for (let i = 0; i < 60; i++) {
      const [value, slope] = hermite(h0, h1, q0, q1, p[m + k], p[m + k + 1], h);
      if (value > parallax) high = h; else low = h;
      let next = h + (slope > 0 ? (parallax - value) / slope : Infinity);
      if (!(low <= next && next <= high)) next = 0.5 * (low + high);
      if (Math.abs(next - h) <= 1e-15 * (Math.abs(h0) + Math.abs(h1))) return next;
      h = next;
    }
    return h;
  }
}
