// What is looked at and how: a value that a link holds, and how it moves.

import { MODE_NAMES } from '../view/modes.js';

export const EYE = { brightness: 0, contrast: 1, gamma: 1 };

export function defaultView(product) {
  const [cols, rows] = product.grid.size;
  return {
    cx: cols / 2, cy: rows / 2, zoom: 0, mode: product.stereo ? 'half-colour' : 'left', swap: false, accommodate: true,
    accommodation: 0, offset: 0, exaggeration: 1, eyes: [{ ...EYE }, { ...EYE }],
  };
}

const number = (value, low, high, fallback) => {
  const n = Number(value);
  return Number.isFinite(n) ? Math.min(Math.max(n, low), high) : fallback;
};

// A view from plain values of a link or of the browser's store: nothing in them is trusted.
export function viewOf(record, product) {
  const view = defaultView(product), [cols, rows] = product.grid.size;
  if (!record || typeof record !== 'object') return view;
  view.cx = number(record.cx, -cols, 2 * cols, view.cx);
  view.cy = number(record.cy, -rows, 2 * rows, view.cy);
  view.zoom = number(record.zoom, 0, 64, 0);
  if (MODE_NAMES.includes(record.mode) && product.stereo) view.mode = record.mode;
  view.swap = record.swap === true;
  view.accommodate = record.accommodate !== false;
  view.accommodation = number(record.accommodation, -1e6, 1e6, 0);
  view.offset = number(record.offset, -60, 60, 0);
  view.exaggeration = number(record.exaggeration, 0, 3, 1);
  if (Array.isArray(record.eyes)) {
    view.eyes = [0, 1].map((k) => ({
      brightness: number(record.eyes[k]?.brightness, -0.5, 0.5, 0),
      contrast: number(record.eyes[k]?.contrast, 0.2, 4, 1),
      gamma: number(record.eyes[k]?.gamma, 0.3, 3, 1),
    }));
  }
  return view;
}

export function viewRecord(view) {
  const round = (v, digits) => Number(v.toFixed(digits));
  return {
    cx: round(view.cx, 2), cy: round(view.cy, 2), zoom: round(view.zoom, 5), mode: view.mode, swap: view.swap,
    accommodate: view.accommodate, accommodation: round(view.accommodation, 3), offset: view.offset,
    exaggeration: view.exaggeration, eyes: view.eyes,
  };
}

// Moves a view smoothly to where it shall be. Where the system asks for calm it jumps.
export class Motion {
  constructor(view) {
    this.view = view;
    this.target = null;
    this.calm = matchMedia('(prefers-reduced-motion: reduce)');
  }

  // Keep a place of the screen (device pixels from the middle) where it is while zooming.
  zoomTo(zoom, dx = 0, dy = 0) {
    const from = this.target ?? this.view;
    const cx = from.cx + dx / from.zoom - dx / zoom, cy = from.cy + dy / from.zoom - dy / zoom;
    this.target = { cx, cy, zoom };
  }

  panBy(dx, dy) {
    const from = this.target ?? this.view;
    this.target = { cx: from.cx + dx / from.zoom, cy: from.cy + dy / from.zoom, zoom: from.zoom };
  }

  goTo(cx, cy, zoom = this.view.zoom) {
    this.target = { cx, cy, zoom };
  }

  // Straight there, as a finger or the mouse drags.
  drag(dx, dy) {
    this.target = null;
    this.view.cx -= dx / this.view.zoom;
    this.view.cy -= dy / this.view.zoom;
  }

  // One step of `seconds`; whether it still moves.
  step(seconds) {
    if (!this.target) return false;
    const { view, target } = this;
    const part = this.calm.matches ? 1 : 1 - Math.exp(-seconds / 0.06);
    const before = view.zoom;
    view.zoom = Math.exp(Math.log(before) + part * (Math.log(target.zoom) - Math.log(before)));
    // the place that stays still while zooming stays still on the way, too
    const ratio = before === target.zoom ? part : (1 / before - 1 / view.zoom) / (1 / before - 1 / target.zoom);
    view.cx += ratio * (target.cx - view.cx);
    view.cy += ratio * (target.cy - view.cy);
    const left = Math.hypot(target.cx - view.cx, target.cy - view.cy) * target.zoom;
    if (left < 0.3 && Math.abs(Math.log(target.zoom / view.zoom)) < 1e-3) {
      Object.assign(view, target);
      this.target = null;
      return false;
    }
    return true;
  }
}
