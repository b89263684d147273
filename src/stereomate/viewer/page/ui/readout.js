// What is read at the place of the mark.

import { $, degreesText, element, fillList, fixed, signed } from './dom.js';
import { reasonsOf } from '../measure/exact.js';

export class Readout {
  constructor(app) {
    this.app = app;
    this.show(null);
  }

  show(found) {
    const { product } = this.app, rows = [];
    if (!found) rows.push(['', 'Point at the picture.']);
    else if (found.error) rows.push(['', `Cannot be measured: ${found.error}`]);
    else if (!found.left || !('flags' in found)) {
      const [x, y] = product.mapOf(...found.left);
      rows.push(['Easting', fixed(x, 3)], ['Northing', fixed(y, 3)], ['Height of the ground', fixed(found.ground.h, 2)]);
    } else this.#exact(found, rows);
    fillList($('readout'), rows);
  }

  #exact(found, rows) {
    const { product } = this.app, { grid } = product;
    if (found.point) {
      const sigma = found.sigma.map((s) => `\u00a0±\u00a0${fixed(s, 3)}`);
      rows.push(['Easting', fixed(found.point[0], 3) + sigma[0]], ['Northing', fixed(found.point[1], 3) + sigma[1]],
        ['Height', element('strong', { id: 'height' }, fixed(found.point[2], 3) + sigma[2])]);
      if (found.orientationSigma?.some((s) => s > 0)) {
        rows.push(['of the orientation', found.orientationSigma.map((s) => `±\u00a0${fixed(s, 3)}`).join(', ')]);
      } else if (found.orientationUnknown) {
        rows.push(['of the orientation', 'not known for these two photographs']);
      }
      rows.push([product.datum, degreesText(found.degrees)]);
    } else rows.push(['', element('span', { className: 'flag' }, 'Cannot be measured here')]);
    rows.push(['By the law alone', `${fixed(found.lawHeight, 2)}${found.point ? ` (${signed(found.lawHeight - found.point[2])})` : ''}`]);
    rows.push(['Ground', `${fixed(found.groundHeight, 2)}${found.point ? `, mark ${signed(found.point[2] - found.groundHeight)}` : ''}`]);
    rows.push(['Residual parallax', `${signed(found.residualPx)} px, y ${signed(found.yParallax / (grid.gsd * grid.unit_m))} px`]);
    rows.push(['Slope', this.#slope(found)]);
    const t = found.homogeneity;
    if (t) rows.push([`Objects of ${product.homogeneity[this.app.layers.index]} ${product.heightUnit}`, `t_x ${signed(100 * t[0], 1)} %, t_y ${signed(100 * t[1], 1)} %`]);
    const object = found.object;
    if (object) rows.push(['Object here, matched', `${fixed(object[0], 1)} ± ${fixed(object[1], 2)} ${product.heightUnit}`]);
    if (Number.isFinite(found.miss)) rows.push(['Rays miss by', `${fixed(found.miss, 3)} m`]);
    rows.push(['Photographs', found.photographs.map((k) => product.photographs[k]?.name ?? '–').join(' | ')]);
    const reasons = reasonsOf(found.flags);
    if (reasons.length) rows.push(['', element('span', { className: 'flag' }, reasons.join('; '))]);
  }

  // Slope in degrees, and the direction in which it falls, from grid north.
  #slope(found) {
    const [hu, hv] = found.groundSlope.map((s) => s * this.app.product.crs.height_unit_m / this.app.product.grid.unit_m);
    if (!Number.isFinite(hu + hv)) return '–';
    const angle = this.app.product.grid.rotation_rad;
    const east = Math.cos(angle) * hu - Math.sin(angle) * hv, north = Math.sin(angle) * hu + Math.cos(angle) * hv;
    const aspect = (Math.atan2(-east, -north) * 180 / Math.PI + 360) % 360;
    return `${fixed(Math.atan(Math.hypot(hu, hv)) * 180 / Math.PI, 1)}°, falls to ${fixed(aspect, 0)}°`;
  }
}
