// Mouse, fingers and keys.

import { $, notice } from './dom.js';
import { MODE_NAMES } from '../view/modes.js';

const CLICK_PX = 5;
const PAN_PX = 90;

export const KEYS = [
  ['Arrow keys', 'move the picture'], ['+  −', 'nearer, further'], ['Home', 'whole product'],
  ['Shift + arrow keys', 'move the mark by a pixel (with Alt by a tenth)'],
  ['Page Up, Page Down', 'raise, lower the mark (with Shift by a tenth of a pixel)'],
  ['Wheel', 'zoom; with a measuring tool it raises and lowers the mark. Shift or Alt exchanges the two'],
  ['G', 'mark onto the ground (height model)'], ['C', 'mark onto the surface, by image correlation'],
  ['Enter, click', 'set a point'], ['Escape, double click', 'finish the line or area'], ['Ctrl + Z, Ctrl + Y', 'undo, redo'],
  ['V P H L A', 'tools: look, point, object height, line, area'],
  ['1 … 9, 0, ß or \\', 'viewing modes, in the order of the list'], ['X', 'swap eyes'],
  ['[  ]', 'parallax offset'], ['E, Shift + E', 'more, less exaggeration'], ['T', 'keep the ground at the screen, or not'],
  ['B', 'panel'], ['?', 'this help'],
];

export class Input {
  constructor(app) {
    this.app = app;
    this.pointers = new Map();
    const { canvas } = app;
    canvas.addEventListener('pointerdown', (e) => this.#down(e));
    canvas.addEventListener('pointermove', (e) => this.#move(e));
    canvas.addEventListener('pointerup', (e) => this.#up(e));
    canvas.addEventListener('pointercancel', (e) => this.pointers.delete(e.pointerId));
    canvas.addEventListener('dblclick', () => app.measurements.finish());
    canvas.addEventListener('wheel', (e) => this.#wheel(e), { passive: false });
    canvas.addEventListener('contextmenu', (e) => e.preventDefault());
    addEventListener('keydown', (e) => this.#key(e));
    this.#buttons();
    this.#drop();
  }

  #at(event) {
    const box = this.app.canvas.getBoundingClientRect();
    return [(event.clientX - box.left) * this.app.ratio, (event.clientY - box.top) * this.app.ratio];
  }

  #down(event) {
    this.app.canvas.focus({ preventScroll: true });
    this.app.canvas.setPointerCapture(event.pointerId);
    const [x, y] = this.#at(event);
    this.pointers.set(event.pointerId, { x, y, startX: x, startY: y, moved: false });
    if (this.pointers.size === 2) this.pinch = this.#spread();
  }

  #spread() {
    const [a, b] = [...this.pointers.values()];
    return { size: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, zoom: this.app.view.zoom };
  }

  #move(event) {
    const { app } = this, [x, y] = this.#at(event), pointer = this.pointers.get(event.pointerId);
    if (!pointer) {
      if (event.pointerType === 'mouse' || event.pointerType === 'pen') app.moveMark(x, y);
      return;
    }
    const dx = x - pointer.x, dy = y - pointer.y;
    Object.assign(pointer, { x, y });
    pointer.moved ||= Math.hypot(x - pointer.startX, y - pointer.startY) > CLICK_PX * app.ratio;
    if (this.pointers.size === 2) this.#pinched();
    else if (pointer.moved) {
      app.motion.drag(dx, dy);
      app.touched();
    }
  }

  #pinched() {
    const { app } = this, now = this.#spread(), [width, height] = [app.canvas.width, app.canvas.height];
    for (const pointer of this.pointers.values()) pointer.moved = true;
    app.motion.drag(now.x - this.pinch.x, now.y - this.pinch.y);
    const zoom = this.#limited(app.view.zoom * now.size / Math.max(this.pinch.size, 1));
    app.motion.zoomTo(zoom, now.x - width / 2, now.y - height / 2);
    app.motion.step(10);
    this.pinch = now;
    app.touched();
  }

  #up(event) {
    const { app } = this, pointer = this.pointers.get(event.pointerId);
    this.pointers.delete(event.pointerId);
    if (this.pointers.size === 1) this.pinch = null;
    if (!pointer || pointer.moved) return;
    // a finger sets the mark, a button beside the picture then the point: fingers hide what they touch
    app.moveMark(pointer.x, pointer.y);
    if (event.pointerType !== 'touch' && app.tool !== 'look' && event.button === 0 && event.detail < 2) app.setPoint();
  }

  #limited(zoom) {
    const { app } = this, [cols, rows] = app.product.grid.size;
    const least = 0.2 * Math.min(app.canvas.width / cols, app.canvas.height / rows);
    return Math.min(Math.max(zoom, least), 48);
  }

  #zoomBy(factor, x, y) {
    const { app } = this, from = app.motion.target ?? app.view;
    const box = app.boxes().find((b) => x >= b.x && x < b.x + b.width) ?? app.boxes()[0];
    app.motion.zoomTo(this.#limited(from.zoom * factor), x - box.x - box.width / 2, y - app.canvas.height / 2);
    app.touched();
  }

  #wheel(event) {
    event.preventDefault();
    const { app } = this;
    const exchanged = event.shiftKey || event.altKey, raises = (app.tool !== 'look') !== exchanged;
    // with Shift some systems turn the wheel sideways
    const delta = event.deltaY || event.deltaX, steps = -delta / (event.deltaMode === 1 ? 3 : 100);
    if (raises && !event.ctrlKey) app.raiseMark(steps * 0.5);
    else this.#zoomBy(1.25 ** steps, ...this.#at(event));
  }

  #buttons() {
    const { app } = this;
    $('mark-up').addEventListener('click', () => app.raiseMark(0.5));
    $('mark-down').addEventListener('click', () => app.raiseMark(-0.5));
    $('mark-ground').addEventListener('click', () => this.#toGround());
    $('mark-match').addEventListener('click', () => app.correlateMark());
    $('mark-set').addEventListener('click', () => app.setPoint());
    for (const button of document.querySelectorAll('[data-tool]')) {
      button.addEventListener('click', () => app.setTool(button.dataset.tool));
    }
  }

  #toGround() {
    this.app.ensureMark();
    this.app.mark.toGround();
    this.app.markMoved();
  }

  #drop() {
    const { app } = this, stage = $('stage');
    stage.addEventListener('dragover', (e) => { e.preventDefault(); stage.classList.add('dropping'); });
    stage.addEventListener('dragleave', () => stage.classList.remove('dropping'));
    stage.addEventListener('drop', async (e) => {
      e.preventDefault();
      stage.classList.remove('dropping');
      for (const file of e.dataTransfer.files) await app.panel.table.takeFile(file);
    });
  }

  #moveMark(dc, dr) {
    const { app } = this;
    app.ensureMark();
    const [col, row] = app.mark.left;
    app.mark.moveTo(col + dc / app.view.zoom, row + dr / app.view.zoom);
    app.markMoved();
  }

  #key(event) {
    const { app } = this, inField = event.target.closest?.('input, select, textarea, dialog');
    if (inField && event.target.type !== 'checkbox') return;
    if ((event.ctrlKey || event.metaKey) && 'zyZY'.includes(event.key)) {
      event.preventDefault();
      if (event.key.toLowerCase() === 'y' || event.shiftKey) app.measurements.redo(); else app.measurements.undo();
      return;
    }
    if (event.ctrlKey || event.metaKey) return;
    // Enter and the space bar belong to a button that has the focus, arrow keys to what scrolls
    const onPicture = event.target === app.canvas || event.target === document.body;
    if (this.#command(event, onPicture)) event.preventDefault();
  }

  #command(event, onPicture) {
    const { app } = this, fine = event.altKey ? 0.1 : 1, arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (event.key in arrows) {
      if (!onPicture) return false;
      const [dx, dy] = arrows[event.key];
      if (event.shiftKey) this.#moveMark(dx * fine * app.ratio, dy * fine * app.ratio);
      else {
        app.motion.panBy(dx * PAN_PX * app.ratio, dy * PAN_PX * app.ratio);
        app.touched();
      }
      return true;
    }
    const raise = event.shiftKey ? 0.1 : 0.5, { width, height } = app.canvas;
    const commands = {
      '+': () => this.#zoomBy(1.5, app.boxes()[0].width / 2, height / 2), '=': () => this.#zoomBy(1.5, app.boxes()[0].width / 2, height / 2),
      '-': () => this.#zoomBy(1 / 1.5, app.boxes()[0].width / 2, height / 2), '−': () => this.#zoomBy(1 / 1.5, width / 2, height / 2),
      PageUp: () => app.raiseMark(raise), PageDown: () => app.raiseMark(-raise),
      Home: () => { app.fit(); app.touched(); },
      '?': () => app.panel.help(),
      '[': () => app.panel.setOffset(app.view.offset - 1), ']': () => app.panel.setOffset(app.view.offset + 1),
      e: () => app.panel.setExaggeration(app.view.exaggeration + 0.1), E: () => app.panel.setExaggeration(app.view.exaggeration - 0.1),
      g: () => this.#toGround(), c: () => app.correlateMark(), x: () => app.panel.toggleSwap(), t: () => app.panel.toggleAccommodation(),
      b: () => app.panel.togglePanel(), v: () => app.setTool('look'), p: () => app.setTool('point'), h: () => app.setTool('height'),
      l: () => app.setTool('line'), a: () => app.setTool('area'),
      Escape: () => { if (!app.measurements.finish()) { app.setTool('look'); notice(''); } },
    };
    if (onPicture) Object.assign(commands, { Enter: () => app.setPoint(), ' ': () => app.setPoint() });
    const mode = '1234567890'.indexOf(event.key);
    const chosen = mode >= 0 ? MODE_NAMES[mode] : 'ß\\'.includes(event.key) ? MODE_NAMES[10] : null;
    if (chosen) {
      if (app.product.stereo) app.setMode(chosen);
      return true;
    }
    const command = commands[event.key] ?? commands[event.key.length === 1 ? event.key.toLowerCase() : ''];
    command?.();
    return Boolean(command);
  }
}
