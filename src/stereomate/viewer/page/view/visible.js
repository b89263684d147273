// Which tiles a view shows, with parts of coarser ones where they are not there yet.

import { EYES } from './tilecache.js';

export class Visible {
  constructor(cache) {
    this.cache = cache;
    this.begin();
  }

  begin() {
    this.shown = [];
  }

  // The coarsest tiles of all eyes: the first picture.
  first() {
    this.begin();
    for (const eye of this.cache.product.tiles.eyes) this.#coarsest(eye);
    return this.shown;
  }

  // Tiles beside those shown now, nearest first to where the view is when it moves on.
  around(view, [aheadX, aheadY]) {
    const { tile } = this.cache, found = new Map();
    for (const [eye, level, col, row] of this.shown) {
      if (level === this.cache.levels - 1) continue;
      const [cols, rows] = this.cache.levelSize(level).map((n) => Math.ceil(n / tile));
      for (let r = Math.max(row - 1, 0); r <= Math.min(row + 1, rows - 1); r++) {
        for (let c = Math.max(col - 1, 0); c <= Math.min(col + 1, cols - 1); c++) {
          const edge = tile * 2 ** level;
          const distance = Math.hypot((c + 0.5) * edge - view.cx - aheadX, (r + 0.5) * edge - view.cy - aheadY);
          found.set(`${eye}/${level}/${c}_${r}`, { place: [eye, level, c, r], distance });
        }
      }
    }
    return [...found.values()].sort((a, b) => a.distance - b.distance).map(({ place }) => place);
  }

  // Level whose pixels are nearest to those of the screen.
  level(zoom) {
    return Math.min(Math.max(Math.round(Math.log2(1 / zoom)), 0), this.cache.levels - 1);
  }

  // Parts to draw for one eye, coarse ones first; the mesh may move tiles by low .. high pixels.
  parts(view, eye, width, height, [low, high]) {
    const parts = [], level = this.level(view.zoom), { tile } = this.cache, name = EYES[eye];
    const left = view.cx - width / (2 * view.zoom) - high, right = view.cx + width / (2 * view.zoom) - low;
    const top = view.cy - height / (2 * view.zoom), bottom = view.cy + height / (2 * view.zoom);
    const edge = tile * 2 ** level, [cols, rows] = this.cache.levelSize(level);
    const c0 = Math.max(Math.floor(left / edge), 0), c1 = Math.min(Math.floor(right / edge), Math.ceil(cols / tile) - 1);
    const r0 = Math.max(Math.floor(top / edge), 0), r1 = Math.min(Math.floor(bottom / edge), Math.ceil(rows / tile) - 1);
    for (let row = r0; row <= r1; row++) {
      for (let col = c0; col <= c1; col++) {
        this.shown.push([name, level, col, row]);
        const part = this.#part(name, level, col, row);
        if (part) parts.push(part);
      }
    }
    this.#coarsest(name);
    return parts.sort((a, b) => b.up - a.up);
  }

  // The finest tile that is there for a place, and where the place lies in it, its apron around.
  #part(name, level, col, row) {
    const { tile, apron } = this.cache, [cols, rows] = this.cache.levelSize(level);
    let found = null, up = 0;
    for (; level + up < this.cache.levels && !found; up++) {
      found = this.cache.get(name, level + up, col >> up, row >> up);
    }
    if (!found) return null;
    up--;
    const scale = 2 ** level, coarse = 2 ** (level + up), edge = tile * scale;
    const w = Math.min(tile, cols - col * tile), h = Math.min(tile, rows - row * tile);
    const x = col * edge, y = row * edge;
    const tx = x / coarse - (col >> up) * tile + apron, ty = y / coarse - (row >> up) * tile + apron;
    return {
      up,
      tile: found,
      rectangle: [x, y, w * scale, h * scale],
      texture: [tx / found.width, ty / found.height, w / 2 ** up / found.width, h / 2 ** up / found.height],
    };
  }

  #coarsest(name) {
    const level = this.cache.levels - 1, [cols, rows] = this.cache.levelSize(level), { tile } = this.cache;
    for (let r = 0; r * tile < rows; r++) for (let c = 0; c * tile < cols; c++) this.shown.push([name, level, c, r]);
  }

  // What the cache is to fetch: the coarsest level first, then from the middle outwards, both eyes by turns.
  wanted(view) {
    const top = this.cache.levels - 1, { tile } = this.cache;
    const distance = ([, level, col, row]) => {
      if (level === top) return -1;
      const edge = tile * 2 ** level;
      return Math.hypot((col + 0.5) * edge - view.cx, (row + 0.5) * edge - view.cy);
    };
    const sorted = (list) => list.map((place) => [distance(place), place]).sort((a, b) => a[0] - b[0]).map(([, place]) => place);
    return sorted(this.shown);
  }
}
