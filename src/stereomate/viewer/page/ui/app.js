// State of the page and its one loop: a frame is drawn when something has changed.

import { $, notice } from './dom.js';
import { MODES, WIGGLE_CALM_MS, WIGGLE_MS } from '../view/modes.js';
import { Renderer } from '../view/renderer.js';
import { GreyTiles, correlate } from '../measure/correlate.js';
import { Motion, viewOf, viewRecord } from './view.js';
import { Mark } from './mark.js';
import { KINDS, Measurements, accuracyOf, inRadians } from './measurements.js';
import { Layers } from './layers.js';
import { Overlay } from './overlay.js';
import { Segments } from './segments.js';
import { Panel } from './panel.js';
import { Input } from './input.js';
import { keep, shortVertices, stateOfHash, stored } from './link.js';
import { printSheet } from './sheet.js';

const KEEP_MS = 400;
// Tiles are uploaded for two milliseconds of a frame; where frames take long anyway, for a part of them, so that
// the tiles of a view are there after a few.
const UPLOAD_MS = 2, UPLOAD_PART = 0.15, LONG_FRAME_MS = 250;
// A view that stands still for so long fetches what is around it.
const CALM_MS = 120;
const ACCOMMODATION_S = 0.18;
const COLOURS = { point: [1, 0.95, 0.55], height: [0.75, 1, 0.85], line: [1, 0.9, 0.6], area: [0.85, 0.9, 1] };

export class App {
  constructor(begun, product, products, entry) {
    this.product = product;
    this.products = products;
    this.entry = entry;
    this.tool = 'look';
    this.dirty = true;
    this.linesDirty = true;
    this.phase = 0;
    this.last = 0;
    this.turn = 0;
    this.drewLast = -1;
    this.drew = 0;
    this.rest = null;
    this.reading = null;
    this.canvas = $('view');
    this.changed = () => {
      this.dirty = true;
      if (!this.shown && this.renderer.isComing) this.#draw(performance.now());
    };
    this.renderer = new Renderer(this.canvas, begun, product, this.changed);
    this.view = viewOf(null, product);
    this.motion = new Motion(this.view);
    this.mark = new Mark(product);
    this.grey = new GreyTiles(product);
    this.measurements = new Measurements(product, () => this.#measured());
    this.layers = new Layers(product, () => this.#layersChanged());
    this.overlay = new Overlay(this);
    this.panel = new Panel(this);
    this.input = new Input(this);
  }

  async start() {
    const state = (await stateOfHash(location.hash)) ?? stored(this.product);
    new ResizeObserver(() => this.#resize()).observe($('stage'));
    this.#resize();
    this.#take(state);
    addEventListener('hashchange', async () => this.#take(await stateOfHash(location.hash)));
    document.title = `${this.product.title || this.product.name || 'Stereo product'} – stereo viewer`;
    const pictured = new Promise((done) => { this.pictured = done; });
    // asks for the tiles
    this.#draw(performance.now());
    requestAnimationFrame((time) => this.#frame(time));
    // what is measured with, and drawn by, is fetched and computed when there is something to see
    await pictured;
    try {
      await this.product.loadSurface();
      $('sigma-known').hidden = !this.product.orientation;
      await this.product.loadRelief();
      this.renderer.setRelief(this.product.relief.parallaxes(), this.product.layers);
      this.#settle();
    } catch (error) {
      notice(`Heights cannot be read: ${error.message}`, 0);
    }
    this.mark.refresh();
    this.touched();
  }

  #take(state) {
    if (!state) return;
    Object.assign(this.view, viewOf(state.view, this.product));
    this.motion.target = null;
    if (!this.view.zoom) this.fit();
    this.measurements.accuracy = accuracyOf(state.accuracy, this.measurements.accuracy);
    this.measurements.take(state.measurements, false);
    for (const id of Array.isArray(state.layers) ? state.layers : []) {
      if (this.layers.available().some(([name]) => name === id)) this.layers.toggle(id, true).catch(() => {});
    }
    this.panel.refresh();
    this.touched();
  }

  state() {
    return {
      view: viewRecord(this.view), measurements: shortVertices(this.measurements.records()), accuracy: this.measurements.accuracy,
      layers: [...this.layers.on],
    };
  }

  // Something that a link holds has changed.
  touched() {
    this.dirty = true;
    this.linesDirty = true;
    clearTimeout(this.keepTimer);
    this.keepTimer = setTimeout(() => keep(this.product, this.state()), KEEP_MS);
  }

  #measured() {
    this.panel?.table.draw();
    this.touched();
  }

  #layersChanged() {
    this.renderer.setLayers(this.layers.images());
    this.panel.layers.legend();
    this.touched();
  }

  // --- geometry of the screen -------------------------------------------------------------------------------

  #resize() {
    const box = $('stage').getBoundingClientRect();
    this.ratio = window.devicePixelRatio || 1;
    // whole pixels of the screen: a picture that is scaled again loses its rows, and its sharpness
    const [left, top] = [box.left, box.top].map((v) => Math.ceil(v * this.ratio - 1e-6) / this.ratio - v);
    const [width, height] = [box.right, box.bottom].map((v, k) =>
      Math.max(1, Math.floor(v * this.ratio + 1e-6) - Math.ceil([box.left, box.top][k] * this.ratio - 1e-6)));
    for (const canvas of [this.canvas, $('labels')]) {
      Object.assign(canvas.style, {
        left: `${left}px`, top: `${top}px`, width: `${width / this.ratio}px`, height: `${height / this.ratio}px`,
      });
    }
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    if (!this.view.zoom) this.fit();
    this.dirty = true;
  }

  fit() {
    const [cols, rows] = this.product.grid.size, [width, height] = this.renderer.viewSize(this.view.mode);
    const zoom = Math.min(width / cols, height / rows) * 0.98;
    Object.assign(this.view, { cx: cols / 2, cy: rows / 2, zoom });
    this.motion.target = null;
  }

  // Parts of the canvas: which eye each shows (0 orthophoto, 1 stereomate, null both).
  boxes() {
    const { width } = this.canvas, mode = MODES[this.view.mode], half = Math.floor(width / 2);
    if (mode.layout === 'side') {
      const first = Boolean(mode.crossed) !== this.view.swap ? 1 : 0;
      return [{ x: 0, width: half, eye: first }, { x: width - half, width: half, eye: 1 - first }];
    }
    if (mode.layout === 'one') {
      const eye = mode.eye ?? 0;
      return [{ x: 0, width, eye: this.view.swap && mode.eye !== undefined ? 1 - eye : eye }];
    }
    return [{ x: 0, width, eye: null }];
  }

  #rightShift(col, row) {
    const { image } = this.renderer.shifts(this.view, 1);
    if (image[1] === 0) return image[0];
    return image[0] + image[1] * this.product.parallaxOfHeight(this.product.relief.height(col, row));
  }

  // Where a place {left, right} lies on the canvas.
  onScreen({ left, right }, box) {
    const { view } = this, { height } = this.canvas;
    const xLeft = left[0], xRight = right[0] + (box.eye === 0 ? 0 : this.#rightShift(left[0], right[1]));
    const x = box.eye === 0 ? xLeft : box.eye === 1 ? xRight : 0.5 * (xLeft + xRight);
    return [box.x + box.width / 2 + (x - view.cx) * view.zoom, height / 2 + (left[1] - view.cy) * view.zoom];
  }

  // Place of the orthophoto under a position of the canvas (device pixels).
  placeAt(x, y) {
    const { view } = this, boxes = this.boxes();
    const box = boxes.find((b) => x >= b.x && x < b.x + b.width) ?? boxes[0];
    const col = view.cx + (x - box.x - box.width / 2) / view.zoom, row = view.cy + (y - this.canvas.height / 2) / view.zoom;
    if (box.eye !== 1) return [col, row];
    // what the right eye shows there: the ground, plus what the mark is raised by
    let left = col;
    for (let k = 0; k < 8; k++) {
      const p = this.#parallaxAt(left, row);
      left = col - this.#rightShift(left, row) + p;
    }
    return [left, row];
  }

  #parallaxAt(col, row) {
    if (!this.product.relief) return this.mark.parallax;
    const p = this.product.parallaxOfHeight(this.product.relief.height(col, row)) + this.mark.raised;
    return Number.isFinite(p) ? p : this.mark.parallax;
  }

  draped(col, row, h = NaN) {
    const height = Number.isFinite(h) ? h : this.product.relief?.height(col, row) ?? NaN;
    const p = this.product.stereo ? this.product.parallaxOfHeight(height) : 0;
    return { left: [col, row], right: [col - (Number.isFinite(p) ? p : this.view.accommodation), row] };
  }

  // --- the loop ---------------------------------------------------------------------------------------------

  #settle() {
    if (this.view.accommodate) {
      const wanted = this.#wantedAccommodation();
      if (Number.isFinite(wanted)) this.view.accommodation = wanted;
    }
  }

  #wantedAccommodation() {
    const { product, view } = this;
    if (!product.relief || !product.stereo) return NaN;
    return product.parallaxOfHeight(product.relief.height(view.cx, view.cy));
  }

  #accommodate(seconds) {
    if (!this.view.accommodate) return false;
    const wanted = this.#wantedAccommodation(), missing = wanted - this.view.accommodation;
    if (!Number.isFinite(missing) || missing === 0) return false;
    const calm = this.motion.calm.matches || Math.abs(missing * this.view.zoom) < 0.05;
    this.view.accommodation += calm ? missing : missing * (1 - Math.exp(-seconds / ACCOMMODATION_S));
    return true;
  }

  #frame(time) {
    requestAnimationFrame((next) => this.#frame(next));
    const seconds = Math.min((time - this.last) / 1000, 0.1);
    this.last = time;
    const moves = this.motion.step(seconds);
    if (this.#accommodate(seconds) || moves) this.touched();
    if (this.view.mode === 'wiggle') {
      const phase = Math.floor(time / (this.motion.calm.matches ? WIGGLE_CALM_MS : WIGGLE_MS)) % 2;
      if (phase !== this.phase) { this.phase = phase; this.dirty = true; }
    }
    if (this.dirty) this.#draw(time);
    else this.#idle(time);
  }

  #draw(time) {
    const started = performance.now();
    const gap = this.drewLast === this.turn ? Math.min(time - this.drew, LONG_FRAME_MS) : 0;
    this.drewLast = ++this.turn;
    this.drew = time;
    this.dirty = false;
    if (this.linesDirty) {
      this.linesDirty = false;
      this.#lines();
    }
    if (this.renderer.draw(this.view, this.phase, Math.max(UPLOAD_MS, UPLOAD_PART * gap))) this.dirty = true;
    this.overlay.draw(this.labels);
    this.#failures();
    if (!this.shown && this.renderer.isBegun) this.#firstPicture();
    this.renderer.frameTook(performance.now() - started);
    this.frames = (this.frames ?? 0) + 1;
  }

  #firstPicture() {
    this.shown = true;
    $('app').classList.remove('starting');
    performance.mark('first picture');
    this.renderer.whenDrawn(() => {
      performance.mark('first picture drawn');
      this.pictured();
    });
  }

  // Nothing is drawn: what the view would show if it went on as it went lately is fetched.
  #idle(time) {
    const { view, rest } = this;
    this.turn++;
    if (time - this.drew < CALM_MS || this.renderer.cache.isBusy || navigator.connection?.saveData) return;
    if (rest && rest.cx === view.cx && rest.cy === view.cy && rest.zoom === view.zoom) return;
    const ahead = rest && rest.zoom === view.zoom ? [view.cx - rest.cx, view.cy - rest.cy] : [0, 0];
    this.rest = { cx: view.cx, cy: view.cy, zoom: view.zoom };
    this.renderer.lookAhead(view, ahead);
  }

  #failures() {
    const count = this.renderer.cache.failures;
    if (count !== this.shownFailures) {
      this.shownFailures = count;
      if (count) notice(`${count} ${count === 1 ? 'tile' : 'tiles'} cannot be read; trying again`, 0);
      else notice('');
    }
  }

  #lines() {
    const segments = new Segments(), ratio = this.ratio;
    this.labels = [];
    for (const line of this.layers.lines()) {
      const places = line.places.map((p) => this.draped(...p));
      if (line.marker) segments.symbol(line.marker, places[0], line.colour, line.width * ratio, ratio);
      else segments.path(places, line.colour, line.width * ratio);
      if (line.label) this.labels.push({ place: places[Math.floor(places.length / 2)], lines: [line.label] });
    }
    for (const item of this.measurements.items) {
      const colour = COLOURS[item.kind], isOpen = item === this.measurements.open;
      segments.path(item.vertices, colour, 2 * ratio, item.kind === 'area' && !isOpen);
      for (const vertex of item.vertices) segments.symbol('cross', vertex, colour, 2 * ratio, ratio);
      const last = item.vertices[item.vertices.length - 1];
      if (last) this.labels.push({ place: last, lines: [item.name, this.panel.table.shortResult(item)].filter(Boolean) });
      if (isOpen && this.mark.left && last) {
        segments.line(last, { left: this.mark.left, right: this.mark.right }, [1, 1, 1], ratio);
      }
    }
    if (this.mark.left) {
      segments.symbol('mark', { left: this.mark.left, right: this.mark.right }, [1, 1, 1], 2 * ratio, ratio);
    }
    this.renderer.setLines(segments.array());
  }

  // --- the mark ---------------------------------------------------------------------------------------------

  markMoved() {
    this.dirty = true;
    this.linesDirty = true;
    this.readSoon();
  }

  moveMark(x, y) {
    this.mark.moveTo(...this.placeAt(x, y));
    this.canvas.classList.add('marking');
    this.markMoved();
  }

  // The mark where keys have it: in the middle of the view if it is not in it.
  ensureMark() {
    const { view, mark } = this, [width, height] = this.renderer.viewSize(view.mode);
    const inside = mark.left && Math.abs(mark.left[0] - view.cx) * view.zoom < width / 2 &&
      Math.abs(mark.left[1] - view.cy) * view.zoom < height / 2;
    if (!inside) mark.moveTo(view.cx, view.cy);
  }

  raiseMark(pixels) {
    this.ensureMark();
    this.mark.raise(pixels);
    this.markMoved();
  }

  // Read the position once a frame at most, and again when what it needs has come.
  readSoon() {
    if (this.readPending) return;
    this.readPending = true;
    requestAnimationFrame(() => {
      this.readPending = false;
      this.#read();
    });
  }

  async #read() {
    const { product, mark } = this;
    if (!mark.left) return;
    const ticket = (this.readTicket = (this.readTicket ?? 0) + 1);
    try {
      if (!product.stereo || !product.record.lineage.maps) {
        this.reading = { ground: await product.ground(...mark.left), left: [...mark.left] };
      } else {
        if (!product.isReady(mark.left, mark.right)) {
          await product.prepare(mark.left, mark.right);
          if (ticket !== this.readTicket) return;
          // the ground is known better now
          mark.refresh();
          if (!product.isReady(mark.left, mark.right)) await product.prepare(mark.left, mark.right);
          this.linesDirty = true;
          this.dirty = true;
        }
        if (ticket !== this.readTicket) return;
        this.reading = product.measureNow(mark.left, mark.right, inRadians(this.measurements.accuracy));
        // heights beside the rays, for ground that they hide: read again when they are there
        if (this.reading.lacking.length) product.loadHeights(this.reading.lacking).then(() => this.readSoon(), () => {});
      }
      if (product.homogeneity.length) {
        this.reading.homogeneity = product.homogeneityAt(this.layers.index, ...mark.left);
        if (!this.reading.homogeneity) product.loadHomogeneity(this.layers.index).then(() => this.readSoon(), () => {});
      }
      this.reading.object = this.layers.on.has('objects') ? product.objectAt(...mark.left) : null;
    } catch (error) {
      this.reading = { error: error.message };
    }
    this.panel.reading.show(this.reading);
  }

  async correlateMark() {
    this.ensureMark();
    const { mark } = this;
    if (!mark.left || !this.product.stereo) return false;
    await this.product.prepare(mark.left, mark.right);
    mark.refresh();
    const left = [...mark.left];
    let found = null;
    try {
      found = await correlate(this.grey, left, mark.right);
    } catch (error) {
      notice(error.message);
    }
    if (!found) {
      notice('No match here: too little texture, or the surface is further off. Bring the mark nearer to it.');
      return false;
    }
    if (left[0] !== mark.left[0] || left[1] !== mark.left[1]) return false;
    mark.setMatched(found.right, found);
    notice(`Correlation ${found.score.toFixed(2)}, σ ${found.sigma[0].toFixed(2)} px`);
    this.markMoved();
    return true;
  }

  // --- tools ------------------------------------------------------------------------------------------------

  setTool(tool) {
    if (this.tool !== tool) this.measurements.finish();
    this.tool = tool;
    for (const button of document.querySelectorAll('[data-tool]')) {
      button.setAttribute('aria-pressed', String(button.dataset.tool === tool));
    }
    this.touched();
  }

  setPoint() {
    if (this.tool === 'look') this.setTool('point');
    this.ensureMark();
    if (!this.product.stereo) {
      notice('This product has no stereomate: it cannot be measured in.');
      return;
    }
    this.measurements.add(this.tool, this.mark.left, this.mark.right);
    this.panel.announce(`${KINDS[this.tool].title}: point set`);
  }

  setMode(mode) {
    this.view.mode = mode;
    this.panel.refresh();
    this.touched();
  }

  print() {
    printSheet(this);
  }
}
