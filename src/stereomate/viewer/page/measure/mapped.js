// Points of the tangent frame in the product.

import { dot, inverse, minus } from './linear.js';

// Product position and height of a point of the tangent frame, and the derivatives of (u, v, h) by the point.
export function mapped(surface, point, start) {
  let { col, row, h } = start;
  const gsd = surface.grid.gsd;
  let by = null;
  for (let k = 0; k < 12; k++) {
    const at = surface.point(col, row, h);
    by = inverse([0, 1, 2].map((n) => [at.byU[n], at.byV[n], at.byH[n]]));
    const excess = minus(point, at.point);
    const du = dot(by[0], excess), dv = dot(by[1], excess), dh = dot(by[2], excess);
    col += du / gsd;
    row -= dv / gsd;
    h += dh;
    if (Math.abs(du) + Math.abs(dv) + Math.abs(dh) < 1e-9) break;
  }
  return { col, row, h, by };
}
