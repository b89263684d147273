// A map sheet for print: the view with grid, scale, north, legend and credits.

import { $, element, fixed, svg } from './dom.js';
import { MODES } from '../view/modes.js';
import { crsText } from './exchange.js';
import { niceStep } from './layers.js';

// Room for the picture, as in the style of the sheet.
const SHEET_MM = [277, 150];

// Picture of the view as it is drawn now.
function picture(app) {
  app.renderer.draw(app.view, app.phase, Infinity);
  const { width, height } = app.canvas, canvas = element('canvas', { width, height });
  const context = canvas.getContext('2d');
  context.drawImage(app.canvas, 0, 0);
  context.drawImage($('labels'), 0, 0);
  return canvas.toDataURL('image/jpeg', 0.92);
}

function ticks(app, box) {
  const { product, view } = app, { height } = app.canvas, parts = [];
  const corner = (x, y) => product.mapOf(view.cx + (x - box.width / 2) / view.zoom, view.cy + (y - height / 2) / view.zoom);
  const corners = [[0, 0], [box.width, 0], [box.width, height], [0, height]].map((p) => corner(...p));
  const xs = corners.map((p) => p[0]), ys = corners.map((p) => p[1]);
  const step = niceStep((Math.max(...xs) - Math.min(...xs)) / 6);
  const at = (x, y) => {
    const [c, r] = product.pixelOf(x, y);
    return [box.x + box.width / 2 + (c - view.cx) * view.zoom, height / 2 + (r - view.cy) * view.zoom];
  };
  const size = Math.max(box.width, height) / 48;
  const inside = ([x, y]) => x >= box.x && x <= box.x + box.width && y >= 0 && y <= height;
  for (let x = Math.ceil(Math.min(...xs) / step) * step; x <= Math.max(...xs); x += step) {
    for (let y = Math.ceil(Math.min(...ys) / step) * step; y <= Math.max(...ys); y += step) {
      const [px, py] = at(x, y);
      if (!inside([px, py])) continue;
      parts.push(svg('path', { d: `M${px - size / 2},${py}H${px + size / 2}M${px},${py - size / 2}V${py + size / 2}`, stroke: '#fff', 'stroke-width': size / 10 }));
      const label = svg('text', { x: px + size / 3, y: py - size / 3, 'font-size': size * 0.62, fill: '#fff', stroke: '#000', 'stroke-width': size / 8, 'paint-order': 'stroke' });
      label.textContent = `${x.toFixed(0)} ${y.toFixed(0)}`;
      parts.push(label);
    }
  }
  return parts;
}

// The legend as it is beside the picture: canvases are not copied with their pixels, so they become images.
function legend() {
  if ($('legend').hidden) return [];
  const copy = element('div', { className: 'legend' });
  copy.append(...[...$('legend').childNodes].map((node) => node.cloneNode(true)));
  const drawn = $('legend').querySelectorAll('canvas');
  copy.querySelectorAll('canvas').forEach((canvas, k) => {
    canvas.replaceWith(element('img', { src: drawn[k].toDataURL(), alt: '' }));
  });
  return [copy];
}

// Denominator of the scale of the printed picture: as wide as an A4 sheet, or as high as there is room.
function scaleNumber(metresWide, width, height) {
  const printed = Math.min(SHEET_MM[0], SHEET_MM[1] * width / height) / 1000;
  const rough = metresWide / printed, power = 10 ** Math.max(Math.floor(Math.log10(rough)) - 2, 0);
  return (Math.round(rough / power) * power).toLocaleString('en');
}

export function printSheet(app) {
  const { product, canvas } = app, { width, height } = canvas;
  const drawing = svg('svg', { viewBox: `0 0 ${width} ${height}`, role: 'img', 'aria-label': 'Map sheet' },
    svg('image', { href: picture(app), width, height }));
  for (const box of app.boxes()) drawing.append(...ticks(app, box));
  const size = height / 14, angle = app.northAngle ?? 0;
  const arrow = svg('g', { transform: `translate(${width - size},${size}) rotate(${angle}) scale(${size / 20})` },
    svg('path', { d: 'M0,-17 L6,12 L0,7 L-6,12 Z', fill: '#fff', stroke: '#000' }));
  const perPixel = product.grid.gsd * product.grid.unit_m / app.view.zoom, metres = niceStep(width / 6 * perPixel), bar = metres / perPixel;
  const scale = svg('g', { transform: `translate(${size / 2},${height - size / 2})` },
    svg('path', { d: `M0,${-size / 6}V0H${bar}V${-size / 6}`, fill: 'none', stroke: '#fff', 'stroke-width': size / 14 }));
  const text = svg('text', { x: bar / 2, y: -size / 6, 'text-anchor': 'middle', 'font-size': size / 3, fill: '#fff', stroke: '#000', 'stroke-width': size / 30, 'paint-order': 'stroke' });
  text.textContent = `${metres} m`;
  scale.append(text);
  drawing.append(arrow, scale);
  const glasses = MODES[app.view.mode].left ? 'Red glass before the left eye, cyan before the right one.' : '';
  const number = scaleNumber(width * perPixel, width, height);
  $('sheet').replaceChildren(
    element('h1', {}, product.title || product.name || 'Stereo-orthophoto'), drawing,
    element('div', { className: 'foot' },
      element('div', {}, element('p', {}, `${MODES[app.view.mode].title}. ${glasses}`), ...legend()),
      element('div', {},
        element('p', {}, `${product.crs.name} (${crsText(product)}), ${product.crs.heights}; grid crosses in map units; arrow: true north. ` +
          `Scale about 1 : ${number} on A4. Pixel ${product.grid.gsd} m, ${product.law.kind} law, exaggeration ${fixed(app.view.exaggeration, 1)}.`),
        element('p', {}, `${product.credits ? `${product.credits}. ` : ''}${product.software}`))));
  window.print();
}
