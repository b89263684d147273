// Tiles of both eyes on the GPU. A tile is uploaded once while it is resident; what is seen least recently goes.

import { fetchBitmap } from '../files.js';

const CONCURRENT = 12;
// Of those that are not shown yet: few, so that what is shown next need not wait for them.
const CONCURRENT_AHEAD = 3;
const RETRY_MS = [1000, 4000, 15000];

export const EYES = ['ortho', 'mate'];

const keyOf = ([eye, level, col, row]) => `${eye}/${level}/${col}_${row}`;

export class TileCache {
  constructor(gl, product, changed) {
    this.gl = gl;
    this.product = product;
    this.changed = changed;
    const { tiles, grid } = product;
    this.tile = tiles.size;
    this.apron = tiles.apron;
    this.levels = tiles.levels;
    this.size = grid.size;
    // one megabyte each: those that a large screen shows of both eyes at two levels
    const pixels = window.innerWidth * window.innerHeight * Math.min(window.devicePixelRatio || 1, 2) ** 2;
    this.capacity = Math.min(320, Math.max(96, Math.ceil(6 * pixels / this.tile ** 2) + 48));
    this.resident = new Map();
    this.waiting = new Map();
    this.shown = new Set();
    this.loading = new Map();
    this.ready = [];
    // beside the view: bitmaps that cost no frame, because nothing of them is uploaded before it is shown
    this.ahead = new Map();
    this.aheadCapacity = Math.ceil(this.capacity / 4);
    this.aheadWaiting = [];
    this.aheadLoading = new Map();
    this.failed = new Map();
    this.uploads = 0;
    this.uploadedTwice = 0;
    this.frame = 0;
  }

  levelSize(level) {
    return this.size.map((n) => Math.ceil(n / 2 ** level));
  }

  // The tile if it is on the GPU.
  get(eye, level, col, row) {
    const tile = this.resident.get(`${eye}/${level}/${col}_${row}`);
    if (tile) tile.used = this.frame;
    return tile;
  }

  // Say which tiles the view shows, in the order of their importance; others that wait are given up.
  want(shown) {
    this.waiting.clear();
    this.shown = new Set(shown.map(keyOf));
    for (const place of shown) {
      const key = keyOf(place);
      if (this.resident.has(key) || this.loading.has(key) || this.#isBlocked(key)) continue;
      if (!this.#take(key, place)) this.waiting.set(key, place);
    }
    if (this.waiting.size) this.aheadWaiting = [];
    for (const [key, job] of this.loading) if (!this.shown.has(key)) job.abort();
    this.ready = this.ready.filter((tile) => {
      if (this.shown.has(tile.key)) return true;
      this.loading.delete(tile.key);
      tile.bitmap.close();
      return false;
    });
    this.#next();
  }

  // What was fetched ahead, or is on its way; whether it is.
  #take(key, place) {
    const bitmap = this.ahead.get(key), job = this.aheadLoading.get(key);
    if (bitmap) {
      this.ahead.delete(key);
      this.loading.set(key, new AbortController());
      this.ready.push({ key, place, bitmap });
    } else if (job) {
      this.aheadLoading.delete(key);
      this.loading.set(key, job);
    }
    return Boolean(bitmap || job);
  }

  // Say what the view may show next, in the order of its likelihood: fetched while nothing else is.
  prepare(places) {
    this.aheadWaiting = places.slice(0, this.aheadCapacity).filter((place) => {
      const key = keyOf(place);
      return !this.resident.has(key) && !this.ahead.has(key) && !this.aheadLoading.has(key) && !this.#isBlocked(key);
    });
    this.#next();
  }

  #isBlocked(key) {
    const failure = this.failed.get(key);
    return failure !== undefined && performance.now() < failure.until;
  }

  #next() {
    for (const [key, place] of this.waiting) {
      if (this.loading.size >= CONCURRENT) return;
      this.waiting.delete(key);
      this.#fetch(key, place, this.loading);
    }
    while (this.loading.size === 0 && this.aheadLoading.size < CONCURRENT_AHEAD && this.aheadWaiting.length) {
      const place = this.aheadWaiting.shift();
      this.#fetch(keyOf(place), place, this.aheadLoading);
    }
  }

  async #fetch(key, place, jobs) {
    const job = new AbortController();
    jobs.set(key, job);
    const path = `${this.product.folder}/${key}.${this.product.tiles.format}`;
    try {
      const bitmap = await fetchBitmap(path, this.product.version, job.signal);
      if (job.signal.aborted) {
        bitmap.close();
        this.loading.delete(key);
      } else if (this.aheadLoading.delete(key)) {
        this.#keepAhead(key, bitmap);
      } else {
        this.ready.push({ key, place, bitmap });
        this.failed.delete(key);
      }
    } catch (error) {
      // what was not asked for by the view is asked for again when it is
      if (!this.aheadLoading.delete(key)) {
        this.loading.delete(key);
        if (error.name !== 'AbortError') this.#failure(key, error);
      }
    }
    this.#next();
    if (this.shown.has(key)) this.changed();
  }

  #keepAhead(key, bitmap) {
    this.ahead.set(key, bitmap);
    if (this.ahead.size <= this.aheadCapacity) return;
    const [oldest, dropped] = this.ahead.entries().next().value;
    this.ahead.delete(oldest);
    dropped.close();
  }

  #failure(key, error) {
    const count = (this.failed.get(key)?.count ?? 0) + 1;
    const wait = RETRY_MS[Math.min(count, RETRY_MS.length) - 1];
    this.failed.set(key, { count, until: performance.now() + wait, message: error.message });
    setTimeout(() => this.changed(), wait + 10);
  }

  // Upload what has arrived, for some milliseconds; whether something is left.
  upload(milliseconds) {
    this.frame++;
    const start = performance.now();
    while (this.ready.length) {
      const tile = this.ready.shift();
      this.loading.delete(tile.key);
      this.#put(tile);
      if (performance.now() - start > milliseconds) break;
    }
    return this.ready.length > 0;
  }

  #put({ key, place, bitmap }) {
    if (this.resident.has(key)) {
      this.uploadedTwice++;
      bitmap.close();
      return;
    }
    const gl = this.gl;
    if (this.resident.size >= this.capacity) this.#drop();
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, bitmap.width, bitmap.height);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    this.resident.set(key, { texture, place, width: bitmap.width, height: bitmap.height, used: this.frame, nearest: false });
    this.uploads++;
    bitmap.close();
  }

  #drop() {
    let oldest = null, age = this.frame;
    for (const [key, tile] of this.resident) {
      // the coarsest level stays: it is what is shown where nothing else is there yet
      if (tile.used < age && tile.place[1] < this.levels - 1) {
        age = tile.used;
        oldest = key;
      }
    }
    if (oldest === null) return;
    this.gl.deleteTexture(this.resident.get(oldest).texture);
    this.resident.delete(oldest);
  }

  // Everything was lost with the context.
  forget() {
    this.resident.clear();
  }

  get isBusy() {
    return this.waiting.size + this.loading.size + this.ready.length > 0;
  }

  get failures() {
    return this.failed.size;
  }
}
