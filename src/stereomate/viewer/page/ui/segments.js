// Lines and symbols as segments of the renderer: each end has a place in both eyes.

import { SEGMENT } from '../view/renderer.js';

const SHAPES = {
  cross: [[-9, 0, -3, 0], [3, 0, 9, 0], [0, -9, 0, -3], [0, 3, 0, 9]],
  centre: [[-8, 0, 8, 0], [0, -8, 0, 8], [-6, -6, 6, -6], [6, -6, 6, 6], [6, 6, -6, 6], [-6, 6, -6, -6]],
  triangle: [[0, -8, 7, 5], [7, 5, -7, 5], [-7, 5, 0, -8]],
  square: [[-6, -6, 6, -6], [6, -6, 6, 6], [6, 6, -6, 6], [-6, 6, -6, -6]],
  mark: [[-16, 0, -5, 0], [5, 0, 16, 0], [0, -16, 0, -5], [0, 5, 0, 16], [-0.7, 0, 0.7, 0]],
};
SHAPES.circle = Array.from({ length: 12 }, (_, k) => {
  const [a, b] = [k, k + 1].map((n) => n * Math.PI / 6);
  return [6 * Math.cos(a), 6 * Math.sin(a), 6 * Math.cos(b), 6 * Math.sin(b)];
});

export class Segments {
  constructor() {
    this.numbers = [];
  }

  line(a, b, colour, width, offset = [0, 0, 0, 0]) {
    this.numbers.push(a.left[0], a.left[1], a.right[0], a.right[1], b.left[0], b.left[1], b.right[0], b.right[1],
      ...offset, ...colour, 1, width);
  }

  path(places, colour, width, closed = false) {
    for (let k = 0; k + 1 < places.length; k++) this.line(places[k], places[k + 1], colour, width);
    if (closed && places.length > 2) this.line(places[places.length - 1], places[0], colour, width);
  }

  symbol(shape, place, colour, width, scale = 1) {
    for (const offset of SHAPES[shape]) this.line(place, place, colour, width, offset.map((v) => v * scale));
  }

  array() {
    return new Float32Array(this.numbers);
  }
}
