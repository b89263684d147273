// Layers over the pictures: coloured ones as images on the ground, and lines.

import { LAYER_TITLES, classColour, divergingColour, heightColour, objectColour } from './palettes.js';

const CONTOURS = 24;

export class Layers {
  constructor(product, changed) {
    this.product = product;
    this.changed = changed;
    this.on = new Set();
    this.threshold = 0.05;
    this.leastHeight = 2 / product.crs.height_unit_m;
    this.features = [];
    this.index = 0;
  }

  available() {
    const { product } = this, found = [];
    if (product.homogeneity.length) found.push('homogeneity');
    if (product.objects) found.push('objects');
    found.push('hillshade', 'tints', 'contours');
    if (product.record.lineage.maps) found.push('lineage', 'seams');
    found.push('photographs');
    if (product.points?.length) found.push('points');
    found.push('grid');
    return found.map((id) => [id, LAYER_TITLES[id]]);
  }

  async toggle(id, on) {
    if (on) this.on.add(id); else this.on.delete(id);
    if (on) await this.#prepare(id);
    this.changed();
  }

  async #prepare(id) {
    const { product } = this;
    if (id === 'homogeneity') await product.loadHomogeneity(this.index);
    if (id === 'objects') await product.loadObjects();
    if (id === 'lineage' || id === 'seams') await product.loadLineageMap();
    await product.loadSurface();
    await product.loadRelief();
  }

  // Images over the product, the lowest first.
  images() {
    const { product, on } = this, out = [];
    if (on.has('hillshade') && product.relief) out.push({ image: this.#hillshade(), smooth: true });
    if (on.has('tints') && product.relief) out.push({ image: this.#tints(), smooth: true });
    if (on.has('lineage') && product.lineageMap) out.push({ image: this.#lineage(), smooth: false });
    if (on.has('objects') && product.objectValues) out.push({ image: this.#objects(), smooth: false });
    const values = product.homogeneityValues?.get(this.index);
    if (on.has('homogeneity') && values) out.push({ image: this.#homogeneity(values), smooth: false });
    return out;
  }

  #image(colour) {
    const { cols, rows } = this.product.layers, image = new ImageData(cols, rows);
    for (let r = 0, k = 0; r < rows; r++) {
      for (let c = 0; c < cols; c++, k++) {
        const found = colour(k, c, r);
        if (found) image.data.set(found, 4 * k);
      }
    }
    return image;
  }

  #hillshade() {
    const { cols, rows, values, step } = this.product.relief, size = step * this.product.grid.gsd;
    // light from the upper left of the picture, 45 degrees high
    const light = [-0.5, 0.5, Math.SQRT1_2];
    const at = (c, r) => values[Math.min(Math.max(r, 0), rows - 1) * cols + Math.min(Math.max(c, 0), cols - 1)];
    return this.#image((k, c, r) => {
      const dx = (at(c + 1, r) - at(c - 1, r)) / (2 * size), dy = (at(c, r - 1) - at(c, r + 1)) / (2 * size);
      if (!Number.isFinite(dx + dy)) return null;
      const shade = Math.max((-dx * light[0] - dy * light[1] + light[2]) / Math.hypot(dx, dy, 1), 0);
      const grey = Math.round(255 * Math.min(shade, 1));
      return [grey, grey, grey, 150];
    });
  }

  #tints() {
    const [low, high] = this.product.height_range;
    return this.#image((k) => {
      const h = this.product.relief.values[k];
      return Number.isFinite(h) ? [...heightColour((h - low) / (high - low || 1)), 130] : null;
    });
  }

  #lineage() {
    const { cols, rows } = this.product.layers, map = this.product.lineageMap;
    return this.#image((k) => (map[k] ? [...classColour(map[k] - 1), 110] : null), cols, rows);
  }

  // Largest height that colours tell: the 99.5th percentile of what stands out, so that single mismatches do not count.
  get tallest() {
    if (this.tallestObject === undefined) {
      const { cols, rows } = this.product.layers, least = this.leastHeight;
      const heights = this.product.objectValues.slice(0, cols * rows).filter((h) => h >= least).sort();
      this.tallestObject = Math.max(heights[Math.floor(0.995 * heights.length)] ?? 0, 2 * least);
    }
    return this.tallestObject;
  }

  #objects() {
    const { leastHeight, tallest, product: { objectValues: values } } = this;
    return this.#image((k) => {
      const h = values[k];
      return h >= leastHeight ? [...objectColour((h - leastHeight) / (tallest - leastHeight || 1)), 165] : null;
    });
  }

  setLeastHeight(value) {
    this.leastHeight = value;
    this.tallestObject = undefined;
    this.changed();
  }

  #homogeneity(values) {
    return this.#image((k) => {
      const t = values[k];
      if (!Number.isFinite(t)) return null;
      return [...divergingColour(t / 0.2), Math.abs(t) >= this.threshold ? 150 : 0];
    });
  }

  // Lines on the ground: {places: [[col, row, height?], ...], colour, width, closed, label}.
  lines() {
    const { on, product } = this, out = [];
    if (on.has('contours') && product.relief) out.push(...this.#contours());
    if (on.has('seams') && product.lineageMap) out.push(...this.#seams());
    if (on.has('photographs')) out.push(...this.#photographs());
    if (on.has('points')) out.push(...this.#points());
    if (on.has('grid') && product.surface) out.push(...this.#grid());
    for (const feature of this.features) out.push(...feature);
    return out;
  }

  #contours() {
    if (this.contourLines) return this.contourLines;
    const { relief, height_range: [low, high] } = this.product, { cols, rows, values, step } = relief;
    this.contourInterval = niceStep((high - low) / CONTOURS);
    const lines = [];
    for (let r = 0; r + 1 < rows; r++) {
      for (let c = 0; c + 1 < cols; c++) {
        const k = r * cols + c, corner = [values[k], values[k + 1], values[k + cols + 1], values[k + cols]];
        if (!corner.every(Number.isFinite)) continue;
        const first = Math.ceil(Math.min(...corner) / this.contourInterval), last = Math.floor(Math.max(...corner) / this.contourInterval);
        for (let n = first; n <= last; n++) {
          const h = n * this.contourInterval, ends = [];
          [[0, 0, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1], [0, 1, 0, 0]].forEach(([x0, y0, x1, y1], edge) => {
            const a = corner[edge], b = corner[(edge + 1) % 4];
            if ((a < h) !== (b < h)) {
              const t = (h - a) / (b - a);
              ends.push([(c + 0.5 + x0 + t * (x1 - x0)) * step, (r + 0.5 + y0 + t * (y1 - y0)) * step, h]);
            }
          });
          for (let m = 0; m + 1 < ends.length; m += 2) {
            lines.push({ places: [ends[m], ends[m + 1]], colour: [1, 0.85, 0.6], width: n % 5 === 0 ? 1.8 : 0.9 });
          }
        }
      }
    }
    this.contourLines = lines;
    return lines;
  }

  #seams() {
    if (this.seamLines) return this.seamLines;
    const { cols, rows, step } = this.product.layers, map = this.product.lineageMap, lines = [];
    const add = (a, b) => lines.push({ places: [a, b], colour: [1, 1, 1], width: 1.6 });
    for (let r = 0; r < rows; r++) {
      for (let c = 0; c < cols; c++) {
        const k = r * cols + c;
        if (c + 1 < cols && map[k] !== map[k + 1]) add([(c + 1) * step, r * step], [(c + 1) * step, (r + 1) * step]);
        if (r + 1 < rows && map[k] !== map[k + cols]) add([c * step, (r + 1) * step], [(c + 1) * step, (r + 1) * step]);
      }
    }
    this.seamLines = merged(lines);
    return this.seamLines;
  }

  #photographs() {
    const { photographs, centrePixels } = this.product;
    return centrePixels.map((pixel, k) => (
      { places: [pixel], marker: 'centre', colour: [1, 1, 0.6], width: 2, label: photographs[k].name }));
  }

  #points() {
    return this.product.points.flatMap((p) => {
      const place = [...p.pixel, p.map[2]];
      const shape = { places: [place], marker: p.type === 'check' ? 'square' : 'triangle', colour: [0.6, 1, 1], width: 2, label: p.name };
      if (!p.residual) return [shape];
      // residuals a thousand times too large, so that they are seen
      const times = 1000 / this.product.grid.unit_m;
      const end = this.product.pixelOf(p.map[0] + times * p.residual[0], p.map[1] + times * p.residual[1]);
      return [shape, { places: [place, [...end, p.map[2]]], colour: [1, 0.6, 0.6], width: 2.5 }];
    });
  }

  #grid() {
    const { product } = this, [cols, rows] = product.grid.size;
    const corners = [[0, 0], [cols, 0], [cols, rows], [0, rows]].map((p) => product.mapOf(...p));
    const xs = corners.map((p) => p[0]), ys = corners.map((p) => p[1]);
    const step = niceStep(Math.max(Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys)) / 8);
    const lines = [], pieces = 40;
    const run = (a, b, label) => {
      const places = [];
      for (let k = 0; k <= pieces; k++) {
        const [c, r] = product.pixelOf(a[0] + (b[0] - a[0]) * k / pieces, a[1] + (b[1] - a[1]) * k / pieces);
        if (c >= 0 && r >= 0 && c <= cols && r <= rows) places.push([c, r]);
      }
      if (places.length > 1) lines.push({ places, colour: [0.85, 0.95, 1], width: 1, label });
    };
    for (let x = Math.ceil(Math.min(...xs) / step) * step; x <= Math.max(...xs); x += step) {
      run([x, Math.min(...ys)], [x, Math.max(...ys)], `E ${x.toFixed(0)}`);
    }
    for (let y = Math.ceil(Math.min(...ys) / step) * step; y <= Math.max(...ys); y += step) {
      run([Math.min(...xs), y], [Math.max(...xs), y], `N ${y.toFixed(0)}`);
    }
    return lines;
  }

  // Features of a GeoJSON file, in longitude and latitude or in the CRS of the project.
  addFeatures(features) {
    const place = placer(this.product), lines = [];
    for (const { geometry, properties } of features) {
      const label = typeof properties?.name === 'string' ? properties.name.slice(0, 60) : '';
      for (const [kind, path] of paths(geometry)) {
        const places = path.map(place).filter(Boolean);
        if (kind === 'point' && places.length) lines.push({ places, marker: 'circle', colour: [1, 0.8, 1], width: 2, label });
        else if (places.length > 1) lines.push({ places, colour: [1, 0.8, 1], width: 2, label });
      }
    }
    if (lines.length) this.features.push(lines);
    this.changed();
    return lines.length;
  }
}

// From positions of a file to product pixels; null outside of the neighbourhood of the product.
function placer(product) {
  const [cols, rows] = product.grid.size, { lattice } = product.surface;
  const middle = lattice.degrees(cols / 2, rows / 2);
  return (position) => {
    if (!Array.isArray(position) || !position.slice(0, 2).every(Number.isFinite)) return null;
    const [x, y] = position;
    if (Math.abs(x) > 360 || Math.abs(y) > 90) {
      const [c, r] = product.pixelOf(x, y);
      return near(c, r, cols, rows) ? [c, r] : null;
    }
    if (Math.abs(x - middle[0]) > 2 || Math.abs(y - middle[1]) > 2) return null;
    let c = cols / 2, r = rows / 2;
    for (let k = 0; k < 20; k++) {
      const { value, byCol, byRow } = lattice.withSlopes(c, r, 9, 11);
      const ex = x - value[0], ey = y - value[1], d = byCol[0] * byRow[1] - byCol[1] * byRow[0];
      const dc = (ex * byRow[1] - ey * byRow[0]) / d, dr = (byCol[0] * ey - byCol[1] * ex) / d;
      c += dc;
      r += dr;
      if (Math.abs(dc) + Math.abs(dr) < 1e-6) break;
    }
    return near(c, r, cols, rows) ? [c, r] : null;
  };
}

const near = (c, r, cols, rows) => c > -cols && r > -rows && c < 2 * cols && r < 2 * rows;

function paths(geometry) {
  const { type, coordinates, geometries } = geometry ?? {};
  switch (type) {
    case 'Point': return [['point', [coordinates]]];
    case 'MultiPoint': return coordinates.map((p) => ['point', [p]]);
    case 'LineString': return [['line', coordinates]];
    case 'MultiLineString': case 'Polygon': return coordinates.map((p) => ['line', p]);
    case 'MultiPolygon': return coordinates.flat().map((p) => ['line', p]);
    case 'GeometryCollection': return geometries.flatMap(paths);
    default: return [];
  }
}

// Pieces of straight lines that follow one another, as one.
function merged(lines) {
  const out = [], open = new Map();
  for (const line of lines) {
    const [a, b] = line.places, vertical = a[0] === b[0];
    const key = `${vertical ? 'v' : 'h'}${a}`, found = open.get(key);
    if (found) {
      found.places[1] = b;
      open.delete(key);
      open.set(`${vertical ? 'v' : 'h'}${b}`, found);
    } else {
      const made = { ...line, places: [a, b] };
      out.push(made);
      open.set(`${vertical ? 'v' : 'h'}${b}`, made);
    }
  }
  return out;
}

export function niceStep(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].find((m) => m * power >= value) * power;
}
