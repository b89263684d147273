// Switches of the layers, and what their colours mean.

import { $, element, fixed, notice } from './dom.js';
import { classColour, divergingColour, heightColour, objectColour } from './palettes.js';

export class LayerPanel {
  constructor(app) {
    this.app = app;
    this.#layers();
  }

  #layers() {
    const { app } = this;
    for (const [id, title] of app.layers.available()) {
      const box = element('input', { type: 'checkbox', id: `layer-${id}` });
      box.addEventListener('change', () => {
        app.layers.toggle(id, box.checked).catch((error) => notice(error.message));
      });
      $('layers').append(element('p', { className: 'row' }, element('label', { htmlFor: box.id }, title), box));
      if (id === 'homogeneity') this.#homogeneity();
      if (id === 'objects') this.#objects();
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

  #objects() {
    const { layers, product } = this.app;
    const least = element('input', { type: 'number', id: 'least-height', min: 0, step: 0.5, value: fixed(layers.leastHeight, 1) });
    least.addEventListener('input', () => layers.setLeastHeight(Math.max(0, Number(least.value))));
    $('layers').append(
      element('p', { className: 'row' }, element('label', { htmlFor: least.id }, `Shown from, ${product.heightUnit}`), least));
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
    if (layers.on.has('objects') && product.objectValues) {
      ramp('Heights of objects, matched', objectColour, `${fixed(layers.leastHeight, 1)}`, `${fixed(layers.tallest, 0)} ${product.heightUnit} and more`);
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
}
