// A product in the page: its record, and what is fetched to measure in it.

import { fetchDoubles, fetchFloats, fetchJson, fetchNumbers } from './files.js';
import { Law } from './measure/law.js';
import { Lattice } from './measure/lattice.js';
import { HeightTiles } from './measure/heights.js';
import { Surface } from './measure/surface.js';
import { groundOfOrthophoto, mapOfPixel, measurePoint, pixelOfMap } from './measure/exact.js';
import { orientationOf } from './measure/orientation.js';

export class Product {
  constructor(record, folder) {
    Object.assign(this, record);
    this.record = record;
    this.folder = folder;
    this.version = record.version;
    this.lawRecord = record.law;
    this.law = new Law(record.law);
    this.lineageTiles = new Map();
    this.lineagePending = new Map();
    this.surface = null;
    this.orientation = null;
    this.centrePixels = [];
  }

  static async open(folder) {
    return new Product(await fetchJson(`${folder}/product.json`), folder);
  }

  // The lattice, without which nothing is measured; pictures do not wait for it.
  loadSurface() {
    this.surfacePromise ??= Promise.all([
      fetchJson(`${this.folder}/measure.json`, this.version), fetchDoubles(`${this.folder}/lattice.bin`, this.version),
    ]).then(([record, values]) => {
      Object.assign(this.record, record);
      this.datum = record.datum;
      this.orientation = orientationOf(record.orientation);
      this.centrePixels = record.centre_pixels;
      const lattice = new Lattice(this.record.lattice, values);
      const tiles = new HeightTiles(this.record.heights, this.folder, this.version);
      this.surface = new Surface(this.record, lattice, tiles, this.law);
      return this.surface;
    });
    return this.surfacePromise;
  }

  loadRelief() {
    this.reliefPromise ??= fetchFloats(`${this.folder}/relief.bin`, this.version).then((values) => {
      this.relief = new Relief(this.record, this.law, values);
      return this.relief;
    });
    return this.reliefPromise;
  }

  loadHomogeneity(index = 0) {
    this.homogeneityPromises ??= new Map();
    if (!this.homogeneityPromises.has(index)) {
      const path = `${this.folder}/homogeneity_${index}.bin`;
      this.homogeneityPromises.set(index, fetchFloats(path, this.version).then((values) => {
        this.homogeneityValues ??= new Map();
        this.homogeneityValues.set(index, values);
        return values;
      }));
    }
    return this.homogeneityPromises.get(index);
  }

  // t_x and t_y predicted at a place for objects of the height number `index`; null before it is loaded.
  homogeneityAt(index, col, row) {
    const values = this.homogeneityValues?.get(index);
    if (!values) return null;
    const { cols, rows, step } = this.layers;
    const c = Math.floor(col / step), r = Math.floor(row / step);
    if (!(c >= 0 && r >= 0 && c < cols && r < rows)) return null;
    return [values[r * cols + c], values[rows * cols + r * cols + c]];
  }

  // Heights of objects above the ground, and their standard deviations, on the cells of the layers.
  loadObjects() {
    this.objectsPromise ??= fetchFloats(`${this.folder}/objects.bin`, this.version).then((values) => {
      this.objectValues = values;
      return values;
    });
    return this.objectsPromise;
  }

  // [height, standard deviation] of what stands at a place; null where nothing was matched or it is not loaded.
  objectAt(col, row) {
    if (!this.objectValues) return null;
    const { cols, rows, step } = this.layers, c = Math.floor(col / step), r = Math.floor(row / step);
    if (!(c >= 0 && r >= 0 && c < cols && r < rows)) return null;
    const height = this.objectValues[r * cols + c];
    return Number.isFinite(height) ? [height, this.objectValues[rows * cols + r * cols + c]] : null;
  }

  async loadLineageMap() {
    this.lineageMap ??= await fetchNumbers(`${this.folder}/lineage.bin`, this.version);
    return this.lineageMap;
  }

  #lineageKeys(places) {
    const tile = this.record.lineage.tile, [cols, rows] = this.grid.size, keys = new Set();
    for (const [col, row] of places) {
      for (const [dc, dr] of [[-4, 0], [4, 0], [0, -4], [0, 4]]) {
        const c = Math.floor(Math.min(Math.max(col + dc, 0), cols - 1) / tile);
        const r = Math.floor(Math.min(Math.max(row + dr, 0), rows - 1) / tile);
        keys.add(`${c}_${r}`);
      }
    }
    return keys;
  }

  #fetchLineage(key) {
    if (this.lineageTiles.has(key)) return null;
    if (!this.lineagePending.has(key)) {
      const job = fetchNumbers(`${this.folder}/lineage/${key}.bin`, this.version)
        .then((values) => this.lineageTiles.set(key, values))
        .finally(() => this.lineagePending.delete(key));
      this.lineagePending.set(key, job);
    }
    return this.lineagePending.get(key);
  }

  // Number of the photograph at a place of a product (0 left, 1 right), from 1; 0 where nothing is shown.
  photographAt(side, col, row) {
    const tile = this.record.lineage.tile, [cols, rows] = this.grid.size;
    if (!(col >= 0 && row >= 0 && col < cols && row < rows)) return 0;
    const c = Math.floor(col / tile), r = Math.floor(row / tile);
    const values = this.lineageTiles.get(`${c}_${r}`);
    if (!values) return 0;
    const width = Math.min(tile, cols - c * tile), height = Math.min(tile, rows - r * tile);
    return values[side * width * height + (Math.floor(row) - r * tile) * width + Math.floor(col) - c * tile];
  }

  // Window of the height model that a measurement at these positions needs.
  windowOf(left, right) {
    const { start, end } = this.surface.reach(right[0]);
    return this.surface.window([left, [start, right[1]], [end, right[1]]]);
  }

  isReady(left, right) {
    return this.surface !== null && this.surface.tiles.has(this.windowOf(left, right)) &&
      [...this.#lineageKeys([left, right])].every((key) => this.lineageTiles.has(key));
  }

  async prepare(left, right) {
    await this.loadSurface();
    await Promise.all([
      this.surface.tiles.load(this.windowOf(left, right)),
      ...[...this.#lineageKeys([left, right])].map((key) => this.#fetchLineage(key)),
    ]);
  }

  // Exact point at positions (col, row) on orthophoto and stereomate.
  async measure(left, right, accuracy) {
    await this.prepare(left, right);
    let found = measurePoint(this, left, right, accuracy);
    if (found.lacking.length) {
      await this.loadHeights(found.lacking);
      found = measurePoint(this, left, right, accuracy);
    }
    return found;
  }

  measureNow(left, right, accuracy) {
    return measurePoint(this, left, right, accuracy);
  }

  loadHeights(windows) {
    return Promise.all(windows.map((window) => this.surface.tiles.load(window)));
  }

  // Height of the ground below a place of the orthophoto, by the exact model where it is loaded; else NaN.
  groundNow(col, row) {
    if (this.surface) {
      const window = this.surface.window([[col, row]]);
      if (this.surface.tiles.has(window)) {
        return this.surface.height(this.surface.tiles.patch(window), col, row);
      }
    }
    return NaN;
  }

  async ground(col, row) {
    await this.loadSurface();
    const window = this.surface.window([[col, row]]);
    await this.surface.tiles.load(window);
    return groundOfOrthophoto(this.surface, this.surface.tiles.patch(window), col, row);
  }

  parallaxOfHeight(h) {
    return this.law.q(h) / this.grid.gsd;
  }

  // Letters of the unit of heights.
  get heightUnit() {
    const metres = this.crs.height_unit_m;
    return metres === 1 ? 'm' : Math.abs(metres - 0.3048) < 1e-9 ? 'ft' : Math.abs(metres - 0.3048) < 1e-6 ? 'us-ft' : `× ${metres} m`;
  }

  mapOf(col, row) {
    return mapOfPixel(this.grid, col, row);
  }

  pixelOf(x, y) {
    return pixelOfMap(this.grid, x, y);
  }
}

// Heights over the whole product on a coarse grid: where the exact model is not loaded, and for the pictures.
export class Relief {
  constructor(record, law, values) {
    Object.assign(this, record.layers);
    this.values = values;
    this.gsd = record.grid.gsd;
    this.law = law;
    const [low, high] = record.height_range;
    this.middle = 0.5 * (low + high);
  }

  height(col, row) {
    const x = Math.min(Math.max(col / this.step - 0.5, 0), this.cols - 1);
    const y = Math.min(Math.max(row / this.step - 0.5, 0), this.rows - 1);
    const j = Math.min(Math.floor(x), Math.max(this.cols - 2, 0)), i = Math.min(Math.floor(y), Math.max(this.rows - 2, 0));
    const fx = x - j, fy = y - i, at = i * this.cols + j, v = this.values;
    const right = this.cols > 1 ? 1 : 0, down = this.rows > 1 ? this.cols : 0;
    const top = v[at] + fx * (v[at + right] - v[at]);
    const bottom = v[at + down] + fx * (v[at + down + right] - v[at + down]);
    const value = top + fy * (bottom - top);
    return Number.isFinite(value) ? value : Number.isFinite(v[at]) ? v[at] : NaN;
  }

  // Parallaxes in product pixels at the nodes of both eyes: of the ground shown by the left one, and by the right.
  parallaxes() {
    const { cols, rows, step } = this;
    const left = new Float32Array(cols * rows), right = new Float32Array(cols * rows);
    const fallback = this.law.q(this.middle) / this.gsd;
    for (let r = 0; r < rows; r++) {
      const q = new Float64Array(cols);
      for (let c = 0; c < cols; c++) {
        const h = this.values[r * cols + c];
        const value = Number.isFinite(h) ? this.law.q(h) / this.gsd : NaN;
        q[c] = Number.isFinite(value) ? value : (c > 0 ? q[c - 1] : fallback);
        left[r * cols + c] = q[c];
      }
      // forward along the row: what the stereomate shows at x - q(x); the highest ground wins
      const shown = new Float32Array(cols).fill(NaN);
      for (let c = 0; c + 1 < cols; c++) {
        const a = (c + 0.5) - q[c] / step, b = (c + 1.5) - q[c + 1] / step;
        for (let k = Math.max(0, Math.ceil(Math.min(a, b) - 0.5)); k <= Math.min(cols - 1, Math.max(a, b) - 0.5); k++) {
          const t = a === b ? 1 : (k + 0.5 - a) / (b - a);
          shown[k] = q[c] + t * (q[c + 1] - q[c]);
        }
      }
      let last = q[0];
      for (let c = 0; c < cols; c++) {
        if (Number.isFinite(shown[c])) last = shown[c];
        right[r * cols + c] = last;
      }
    }
    return { left, right };
  }
}
