// The controls beside the picture.

import { $, element, fillList, fixed, notice } from './dom.js';
import { MODES, MODE_NAMES } from '../view/modes.js';
import { crsText } from './exchange.js';
import { KEYS } from './input.js';
import { LayerPanel } from './layerpanel.js';
import { MeasurementTable } from './table.js';
import { Readout } from './readout.js';

const EYE_NAMES = ['Left', 'Right'];
const ADJUSTMENTS = [['brightness', -0.5, 0.5, 0.02], ['contrast', 0.2, 4, 0.05], ['gamma', 0.3, 3, 0.05]];
// Fields of standard deviations.
const SIGMAS = [['sigma', 'px'], ['sigma-centre', 'centre'], ['sigma-angle', 'angle']];

export class Panel {
  constructor(app) {
    this.app = app;
    this.#view();
    this.#eyes();
    this.layers = new LayerPanel(app);
    this.table = new MeasurementTable(app);
    this.#about();
    this.#frame();
    this.refresh();
    this.reading = new Readout(app);
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
    for (const [id, key] of SIGMAS) {
      $(id).addEventListener('change', () => {
        app.measurements.setAccuracy({ ...app.measurements.accuracy, [key]: Number($(id).value) });
        this.refresh();
        app.readSoon();
      });
    }
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
    for (const [id, key] of SIGMAS) $(id).value = measurements.accuracy[key];
    for (const { slider, value, eye, key } of this.sliders ?? []) {
      slider.value = view.eyes[eye][key];
      value.textContent = view.eyes[eye][key].toFixed(2);
    }
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

