// The table of measurements: what each found, its profile, files and links.

import { $, download, element, fixed, notice, signed, svg } from './dom.js';
import { reasonsOf } from '../measure/exact.js';
import { KINDS } from './measurements.js';
import { fromText, toCsv, toGeoJson, toKml } from './exchange.js';
import { hashOf } from './link.js';

export class MeasurementTable {
  constructor(app) {
    this.app = app;
    this.#measurements();
  }

  #measurements() {
    const { app } = this, { measurements } = app;
    $('undo').addEventListener('click', () => measurements.undo());
    $('redo').addEventListener('click', () => measurements.redo());
    $('finish').addEventListener('click', () => measurements.finish());
    $('clear').addEventListener('click', () => measurements.clear());
    const writers = {
      geojson: [toGeoJson, 'application/geo+json'], csv: [toCsv, 'text/csv'], kml: [toKml, 'application/vnd.google-earth.kml+xml'],
    };
    for (const button of document.querySelectorAll('[data-export]')) {
      const [write, type] = writers[button.dataset.export];
      button.addEventListener('click', () => {
        download(`measurements.${button.dataset.export}`, type, write(app.product, measurements.items));
      });
    }
    $('import-open').addEventListener('click', () => $('import').click());
    $('import').addEventListener('change', async () => {
      for (const file of $('import').files) await this.takeFile(file);
      $('import').value = '';
    });
    $('link').addEventListener('click', () => this.#link());
    $('print').addEventListener('click', () => app.print());
  }

  async #link() {
    const address = location.origin + location.pathname + location.search + await hashOf(this.app.state());
    history.replaceState(null, '', address);
    try {
      await navigator.clipboard.writeText(address);
      notice('The link is in the clipboard.');
    } catch {
      notice('The link is in the address bar.');
    }
  }

  async takeFile(file) {
    const { app } = this;
    try {
      await app.product.loadSurface();
      const { measurements, features } = fromText(app.product, file.name, await file.text());
      const taken = app.measurements.take(measurements), shown = features.length ? app.layers.addFeatures(features) : 0;
      if (!taken && !shown) throw new Error('holds nothing that lies on this product');
      notice(`${file.name}: ${taken} measurements, ${shown} other features`);
    } catch (error) {
      notice(`${file.name}: ${error.message}`, 10);
    }
  }

  shortResult(item) {
    const r = item.result, unit = this.app.product.heightUnit;
    if (!r || r.error) return '';
    if (item.kind === 'point') return r.points[0]?.point ? `${fixed(r.points[0].point[2])} ${unit}` : '';
    if (item.kind === 'height') return Number.isFinite(r.height) ? `${fixed(r.height)} ± ${fixed(r.heightSigma)} ${unit}` : '';
    if (item.kind === 'line') return Number.isFinite(r.onMap) ? `${fixed(r.onMap)} m` : '';
    return Number.isFinite(r.area) ? `${fixed(r.area, 1)} m²` : '';
  }

  #long(item) {
    const r = item.result, lines = [], unit = this.app.product.heightUnit;
    if (!r) return ['…'];
    if (r.error) return [r.error];
    const point = r.points[0];
    if (item.kind === 'point' && point?.point) {
      lines.push(`E ${fixed(point.point[0])}  N ${fixed(point.point[1])}`, `h ${fixed(point.point[2])} ± ${fixed(point.sigma[2])} ${unit}`, `law ${fixed(point.lawHeight)}`);
    }
    if (item.kind === 'height' && r.points.length === 2) {
      lines.push(`${fixed(r.height)} ± ${fixed(r.heightSigma)} ${unit}`, `law ${fixed(r.lawHeight)} ${unit} (${signed(r.lawHeight - r.height)})`,
        `top beside foot ${fixed(r.leaning * this.app.product.grid.unit_m)} m`);
    }
    if (item.kind === 'line' && r.points.length > 1) {
      const first = r.points[0].point, last = r.points[r.points.length - 1].point;
      lines.push(`${fixed(r.onMap)} ± ${fixed(r.lengthSigma)} m on the map`, `${fixed(r.spatial)} m in space`, `Δh ${first && last ? signed(last[2] - first[2]) : '–'} ${unit}`);
    }
    if (item.kind === 'area' && r.points.length > 2) {
      lines.push(`${fixed(r.area, 1)} m² on the map`, `${fixed(r.areaOnGround, 1)} m² on the ground`, `edge ${fixed(r.onMap)} m`,
        `ground over the edge's surface ${fixed(r.volumeOver, 1)} m³, under it ${fixed(r.volumeUnder, 1)} m³`);
    }
    return lines;
  }

  draw() {
    const { measurements } = this.app, body = $('table').tBodies[0];
    const focused = document.activeElement?.id;
    body.replaceChildren(...measurements.items.map((item) => {
      const name = element('input', { id: `name-${item.id}`, value: item.name, ariaLabel: `Name of ${item.name}`, maxLength: 80 });
      name.addEventListener('change', () => measurements.rename(item.id, name.value.trim()));
      const flags = (item.result?.points ?? []).reduce((all, p) => all | p.flags, 0);
      const lines = this.#long(item).map((text) => element('div', {}, text));
      if (flags) lines.push(element('div', { className: 'flag' }, reasonsOf(flags).join('; ')));
      const row = element('tr', {},
        element('td', {}, name, element('div', {}, KINDS[item.kind].title)),
        element('td', {}, ...lines),
        element('td', {},
          element('button', { type: 'button', id: `go-${item.id}`, title: 'Show it', ariaLabel: `Show ${item.name}`, onclick: () => this.#show(item) }, 'Go'),
          element('button', { type: 'button', id: `del-${item.id}`, title: 'Delete it', ariaLabel: `Delete ${item.name}`, onclick: () => measurements.remove(item.id) }, '×')));
      if (item.id === measurements.selected) row.setAttribute('aria-current', 'true');
      return row;
    }));
    if (focused && /^(name|go|del)-/.test(focused)) $(focused)?.focus();
    this.#profile(measurements.items.find((item) => item.id === measurements.selected));
  }

  #show(item) {
    const { app } = this, last = item.vertices[item.vertices.length - 1];
    app.measurements.selected = item.id;
    app.mark.set(last.left, last.right);
    app.motion.goTo(last.left[0], last.left[1], Math.max(app.view.zoom, 1));
    app.markMoved();
    app.touched();
    this.draw();
  }

  #profile(item) {
    const found = item?.result?.profile, { product } = this.app;
    if (!found || !found.ground.some((p) => Number.isFinite(p[1]))) {
      $('profile').replaceChildren();
      return;
    }
    const all = [...found.ground, ...found.measured].filter((p) => Number.isFinite(p[1]));
    const heights = all.map((p) => p[1]), far = Math.max(...all.map((p) => p[0]), 1e-9);
    const low = Math.min(...heights), high = Math.max(...heights, low + 0.5), w = 300, h = 130;
    const at = ([s, z]) => [34 + (w - 40) * s / far, h - 18 - (h - 28) * (z - low) / (high - low)];
    const path = (points) => {
      let text = '', pen = false;
      for (const p of points) {
        if (!Number.isFinite(p[1])) { pen = false; continue; }
        text += `${pen ? 'L' : 'M'}${at(p).map((v) => v.toFixed(1)).join(',')}`;
        pen = true;
      }
      return text;
    };
    const label = (x, y, text, anchor) => svg('text', { x, y, 'text-anchor': anchor }, text);
    $('profile').replaceChildren(svg('svg', {
      viewBox: `0 0 ${w} ${h}`, role: 'img',
      'aria-label': `Profile of ${item.name}: ${fixed(far, 0)} m long, heights from ${fixed(low)} to ${fixed(high)} ${product.heightUnit}`,
    },
    svg('path', { class: 'ground', d: path(found.ground) }), svg('path', { class: 'measured', d: path(found.measured) }),
    label(30, 14, fixed(high, 1), 'end'), label(30, h - 18, fixed(low, 1), 'end'), label(w - 4, h - 4, `${fixed(far, 1)} m`, 'end'),
    label(34, h - 4, 'grey: height model', 'start')));
  }
}
