// Whether the height model hides ground from a photograph: the ray is followed from the ground upwards, cell by
// cell of the model. Same question as measure.py's HIDDEN, asked of the same bilinear surface.

import { DEM } from './lattice.js';
import { minus, norm, plus } from './linear.js';
import { mapped } from './mapped.js';

// A ray that ends this much before its ground met something else, metres.
const HIDDEN_M = 0.1;
// Horizontal length of a chord, metres: a ray bends by 0.2 mm over it.
const CHORD_M = 100;
// No ray is followed further over the model than this many chords.
const MOST_CHORDS = 2000;

// Position in the model and height in its own units.
function inModel(surface, point, start) {
  const at = mapped(surface, point, start);
  const [c, r, offset] = surface.lattice.at(at.col, at.row, DEM, DEM + 3);
  return { col: c, row: r, h: (at.h - offset) / surface.scale, start: at };
}

// Chords of a ray from its ground to where nothing of the model is as high: {a, b, hidden?} by positions in the
// model. Null where the ray rises too flatly to be followed.
export function chordsOf(surface, ground, centre) {
  const towards = minus(centre, ground.point), length = norm(towards);
  const direction = towards.map((v) => v / length);
  const cell = Math.min(...surface.tiles.cell_m);
  const room = surface.isCubic ? Math.max(HIDDEN_M, cell) : HIDDEN_M;
  const top = surface.tiles.highest, chords = [];
  if (!(length > room)) return chords;
  const at = (s) => inModel(surface, plus(ground.point, direction, s), ground);
  let s = room, a = at(s);
  // how fast the ray moves over the model, in metres of the ground for each of its own
  const ahead = at(s + 1), pace = Math.max(Math.hypot(ahead.col - a.col, ahead.row - a.row) * cell, 1e-3);
  while (a.h < top && s < length) {
    if (chords.length >= MOST_CHORDS) return null;
    const rise = Math.max((ahead.h - a.h), 1e-6);
    // no further than to the highest ground, and a little
    const step = Math.min(CHORD_M / pace, (top - a.h) / rise + 1, length - s);
    s += step;
    const b = at(s);
    chords.push({ a, b });
    a = b;
  }
  return chords;
}

export function windowOfChords(chords) {
  const ends = chords.flatMap(({ a, b }) => [a, b]);
  const cols = ends.map((p) => p.col), rows = ends.map((p) => p.row);
  const c0 = Math.floor(Math.min(...cols)) - 1, r0 = Math.floor(Math.min(...rows)) - 1;
  return [c0, r0, Math.ceil(Math.max(...cols)) + 2 - c0, Math.ceil(Math.max(...rows)) + 2 - r0];
}

// Windows of the model that chords cross.
export const windowsOf = (chords) => chords.map((chord) => windowOfChords([chord]));

// Whether the surface rises above a chord; voids hide nothing.
export function isBlocked(tiles, { a, b }) {
  // centres of cells are the nodes of the surface
  const x0 = a.col - 0.5, y0 = a.row - 0.5, dx = b.col - a.col, dy = b.row - a.row, dh = b.h - a.h;
  const cuts = [0, 1];
  for (const [from, step] of [[x0, dx], [y0, dy]]) {
    if (step === 0) continue;
    const first = Math.ceil(Math.min(from, from + step)), last = Math.floor(Math.max(from, from + step));
    for (let n = first; n <= last; n++) {
      const t = (n - from) / step;
      if (t > 0 && t < 1) cuts.push(t);
    }
  }
  cuts.sort((p, q) => p - q);
  for (let k = 0; k + 1 < cuts.length; k++) {
    const [t0, t1] = [cuts[k], cuts[k + 1]], middle = 0.5 * (t0 + t1);
    const j = Math.floor(x0 + middle * dx), i = Math.floor(y0 + middle * dy);
    const corner = [tiles.node(j, i), tiles.node(j + 1, i), tiles.node(j, i + 1), tiles.node(j + 1, i + 1)];
    if (!corner.every(Number.isFinite)) continue;
    if (Math.max(...corner) < a.h + dh * (dh > 0 ? t0 : t1)) continue;
    const clearance = (t) => {
      const fx = x0 + t * dx - j, fy = y0 + t * dy - i;
      const above = corner[0] + fx * (corner[1] - corner[0]), below = corner[2] + fx * (corner[3] - corner[2]);
      return a.h + t * dh - (above + fy * (below - above));
    };
    // a parabola along the chord: its ends, and its lowest place if that lies between
    const [f0, fm, f1] = [clearance(t0), clearance(middle), clearance(t1)];
    if (Math.min(f0, fm, f1) < 0) return true;
    const bend = 2 * (f0 + f1 - 2 * fm), slope = 4 * fm - 3 * f0 - f1;
    const lowest = bend > 0 ? -slope / (2 * bend) : -1;
    if (lowest > 0 && lowest < 1 && f0 + lowest * (slope + lowest * bend) < 0) return true;
  }
  return false;
}
