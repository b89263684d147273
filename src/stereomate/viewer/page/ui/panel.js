// The controls beside the picture.

import { $, degreesText, download, element, fillList, fixed, notice, signed, svg } from './dom.js';
import { MODES, MODE_NAMES } from '../view/modes.js';
import { reasonsOf } from '../measure/exact.js';
import { KINDS } from './measurements.js';
import { crsText, fromText, toCsv, toGeoJson, toKml } from './exchange.js';
import { divergingColour, heightColour, classColour } from './palettes.js';
import { hashOf } from './link.js';
import { KEYS } from './input.js';

const EYE_NAMES = ['Left', 'Right'];
const ADJUSTMENTS = [['brightness', -0.5, 0.5, 0.02], ['contrast', 0.2, 4, 0.05], ['gamma', 0.3, 3, 0.05]];

export class Panel {
  constructor(app) {
    this.app = app;
    this.#view();
    this.#eyes();
    this.#layers();
    this.#measurements();
    this.#about();
    this.#frame();
    this.refresh();
    this.readout(null);
  }

  announce(text) {
    notice(text, 2);
  }

  // --- view -------------------------------------------------------------------------------------------------

  #view() {
    const { app } = this, { view } = app;
    const usable = app.product.stereo ? MODE_NAMES : ['left'];
    $('mode').append(...usable.map((name) => element('option', { value: name }, MODES[name].title)));
    $('mode').addEventListener('change', () => app.setMode($('mode').value));
    $('swap').addEventListener('change', () => { view.swap = $('swap').checked; app.touched(); });
    $('accommodate').addEventListener('change', () => { view.accommodate = $('accommodate').checked; app.touched(); });
    $('offset').addEventListener('input', () => this.setOffset(Number($('offset').value)));
    $('exaggeration').addEventListener('input', () => this.setExaggeration(Number($('exaggeration').value)));
    $('sigma').addEventListener('change', () => {
      const sigma = Number($('sigma').value);
      if (sigma > 0 && sigma <= 10) {
        app.measurements.setSigma(sigma);
        app.readSoon();
      }
    });
  }

  setOffset(value) {
    this.app.view.offset = Math.min(Math.max(Math.round(value), -60), 60);
    this.refresh();
    this.app.touched();
  }

  setExaggeration(value) {
    this.app.view.exaggeration = Math.round(Math.min(Math.max(value, 0), 3) * 10) / 10;
    this.refresh();
    this.app.touched();
  }

  toggleSwap() {
    this.app.view.swap = !this.app.view.swap;
    this.refresh();
    this.app.touched();
  }

  toggleAccommodation() {
    this.app.view.accommodate = !this.app.view.accommodate;
    this.refresh();
    this.app.touched();
  }

  #eyes() {
    const { app } = this;
    this.sliders = [];
    EYE_NAMES.forEach((name, eye) => {
      for (const [key, low, high, step] of ADJUSTMENTS) {
        const id = `${key}-${eye}`;
        const slider = element('input', { type: 'range', id, min: low, max: high, step });
        const value = element('output', { htmlFor: id });
        slider.addEventListener('input', () => {
          const eyes = $('eyes-linked').checked ? [0, 1] : [eye];
          for (const k of eyes) app.view.eyes[k] = { ...app.view.eyes[k], [key]: Number(slider.value) };
          this.refresh();
          app.touched();
        });
        $('eyes').append(element('p', { className: 'row' }, element('label', { htmlFor: id }, `${name}: ${key}`), slider, value));
        this.sliders.push({ slider, value, eye, key });
      }
    });
    $('eyes').append(element('button', {
      type: 'button',
      onclick: () => {
        app.view.eyes = [0, 1].map(() => ({ brightness: 0, contrast: 1, gamma: 1 }));
        this.refresh();
        app.touched();
      },
    }, 'As they are'));
  }

  // Controls show what the view is.
  refresh() {
    const { view, measurements } = this.app;
    $('mode').value = view.mode;
    $('swap').checked = view.swap;
    $('accommodate').checked = view.accommodate;
    $('offset').value = view.offset;
    $('offset-value').textContent = view.offset;
    $('exaggeration').value = view.exaggeration;
    $('exaggeration-value').textContent = view.exaggeration.toFixed(1);
    $('sigma').value = measurements.sigma;
    for (const { slider, value, eye, key } of this.sliders ?? []) {
      slider.value = view.eyes[eye][key];
      value.textContent = view.eyes[eye][key].toFixed(2);
    }
  }

  // --- layers -----------------------------------------------------------------------------------------------

  #layers() {
    const { app } = this;
    for (const [id, title] of app.layers.available()) {
      const box = element('input', { type: 'checkbox', id: `layer-${id}` });
      box.addEventListener('change', () => {
        app.layers.toggle(id, box.checked).catch((error) => notice(error.message));
      });
      $('layers').append(element('p', { className: 'row' }, element('label', { htmlFor: box.id }, title), box));
      if (id === 'homogeneity') this.#homogeneity();
    }
  }

  #homogeneity() {
    const { app } = this, { layers, product } = app;
    const height = element('select', { id: 'object-height' }, ...product.homogeneity.map((h, k) => element('option', { value: k }, `${h} ${product.heightUnit}`)));
    const threshold = element('input', { type: 'number', id: 'threshold', min: 0, max: 50, step: 1, value: 5 });
    height.addEventListener('change', async () => {
      layers.index = Number(height.value);
      await layers.toggle('homogeneity', layers.on.has('homogeneity'));
    });
    threshold.addEventListener('input', () => {
      layers.threshold = Math.max(0, Number(threshold.value)) / 100;
      layers.changed();
    });
    $('layers').append(
      element('p', { className: 'row' }, element('label', { htmlFor: height.id }, 'Objects of'), height),
      element('p', { className: 'row' }, element('label', { htmlFor: threshold.id }, 'Shown from, %'), threshold));
  }

  legend() {
    const { layers, product } = this.app, parts = [];
    for (const [id] of layers.available()) $(`layer-${id}`).checked = layers.on.has(id);
    const ramp = (title, colour, low, high) => {
      const canvas = element('canvas', { width: 128, height: 1 });
      const context = canvas.getContext('2d'), image = context.createImageData(128, 1);
      for (let k = 0; k < 128; k++) image.data.set([...colour(k / 127), 255], 4 * k);
      context.putImageData(image, 0, 0);
      parts.push(element('div', {}, title, canvas, element('div', { className: 'ends' }, element('span', {}, low), element('span', {}, high))));
    };
    if (layers.on.has('homogeneity')) {
      ramp(`Objects of ${product.homogeneity[layers.index]} ${product.heightUnit}, t_x`, (t) => divergingColour(2 * t - 1), '−20 % read too low', '+20 %');
    }
    if (layers.on.has('tints')) ramp('Ground', heightColour, fixed(product.height_range[0], 0), `${fixed(product.height_range[1], 0)} ${product.heightUnit}`);
    if (layers.on.has('contours') && layers.contourInterval) parts.push(element('div', {}, `Contours every ${layers.contourInterval} ${product.heightUnit}`));
    if (layers.on.has('points') && product.points.some((p) => p.residual)) {
      parts.push(element('div', {}, 'Triangles control, squares check points; residuals in plan 1000 times larger'));
    }
    if (layers.on.has('lineage')) {
      const seen = new Set(product.lineageMap ?? []);
      for (const n of [...seen].filter(Boolean).sort((a, b) => a - b).slice(0, 24)) {
        const canvas = element('canvas', { width: 1, height: 1 }), context = canvas.getContext('2d');
        context.fillStyle = `rgb(${classColour(n - 1)})`;
        context.fillRect(0, 0, 1, 1);
        parts.push(element('div', { className: 'row' }, element('span', {}, product.photographs[n - 1]?.name ?? ''), canvas));
      }
    }
    $('legend').replaceChildren(...parts);
    $('legend').hidden = parts.length === 0;
  }

  // --- readout ----------------------------------------------------------------------------------------------

  readout(found) {
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
      const sigma = found.sigma.map((s) => ` ± ${fixed(s, 3)}`);
      rows.push(['Easting', fixed(found.point[0], 3) + sigma[0]], ['Northing', fixed(found.point[1], 3) + sigma[1]],
        ['Height', element('strong', { id: 'height' }, fixed(found.point[2], 3) + sigma[2])]);
      rows.push([product.crs.degrees, degreesText(found.degrees)]);
    } else rows.push(['', element('span', { className: 'flag' }, 'Cannot be measured here')]);
    rows.push(['By the law alone', `${fixed(found.lawHeight, 2)}${found.point ? ` (${signed(found.lawHeight - found.point[2])})` : ''}`]);
    rows.push(['Ground', `${fixed(found.groundHeight, 2)}${found.point ? `, mark ${signed(found.point[2] - found.groundHeight)}` : ''}`]);
    rows.push(['Residual parallax', `${signed(found.residualPx)} px, y ${signed(found.yParallax / (grid.gsd * grid.unit_m))} px`]);
    rows.push(['Slope', this.#slope(found)]);
    const t = found.homogeneity;
    if (t) rows.push([`Objects of ${product.homogeneity[this.app.layers.index]} ${product.heightUnit}`, `t_x ${signed(100 * t[0], 1)} %, t_y ${signed(100 * t[1], 1)} %`]);
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

  // --- measurements -----------------------------------------------------------------------------------------

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

  table() {
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
    this.table();
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

  // --- the rest ---------------------------------------------------------------------------------------------

  #about() {
    const { app } = this, { product, products, entry } = app, { law, grid, crs } = product;
    $('title').textContent = product.title || product.name || 'Stereo product';
    const rows = [
      ['CRS', `${crs.name} (${crsText(product)})`], ['Heights', crs.heights],
      ['Size', `${grid.size[0]} × ${grid.size[1]} px of ${grid.gsd} m`],
      ['Rows turned', `${fixed(grid.rotation_rad * 180 / Math.PI, 3)}°`],
    ];
    if (product.stereo) rows.push(['Law', `${law.kind}, B ${fixed(law.base)} m, w0 ${fixed(law.w0)} m, zero at ${fixed(law.reference)} m`]);
    rows.push(['Photographs', String(product.photographs.length)], ['Made with', product.software]);
    if (product.credits) rows.push(['Credits', product.credits]);
    fillList($('about'), rows);
    if (products.length > 1) {
      $('product-row').hidden = false;
      $('product').append(...products.map((p) => element('option', { value: p.name, selected: p === entry }, p.name)));
      $('product').addEventListener('change', () => { location.href = `?product=${encodeURIComponent($('product').value)}`; });
    }
  }

  #frame() {
    $('keys').append(...KEYS.flatMap(([key, text]) => [element('dt', {}, element('kbd', {}, key)), element('dd', {}, text)]));
    $('help-open').addEventListener('click', () => this.help());
    $('panel-toggle').addEventListener('click', () => this.togglePanel());
    if (innerWidth <= 640) this.togglePanel();
    $('theme').value = localStorage.getItem('stereomate:theme') ?? 'auto';
    const theme = () => {
      const value = $('theme').value;
      if (value === 'auto') delete document.documentElement.dataset.theme; else document.documentElement.dataset.theme = value;
      localStorage.setItem('stereomate:theme', value);
    };
    $('theme').addEventListener('change', theme);
    theme();
  }

  help() {
    $('help').showModal();
  }

  togglePanel() {
    const hidden = $('app').classList.toggle('no-panel');
    $('panel-toggle').setAttribute('aria-expanded', String(!hidden));
  }
}

