// Text over the picture, the scale bar and the north arrow.

import { $ } from './dom.js';
import { niceStep } from './layers.js';

export class Overlay {
  constructor(app) {
    this.app = app;
    this.canvas = $('labels');
    this.context = this.canvas.getContext('2d');
  }

  draw(labels) {
    const { app, canvas, context } = this, { view, renderer } = app;
    const { width, height } = renderer.canvas;
    this.#scale(view);
    this.#north(view);
    // a canvas without a word on it is one more picture to lay over the other
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    else if (!canvas.hidden) context.clearRect(0, 0, width, height);
    canvas.hidden = labels.length === 0;
    if (canvas.hidden) return;
    const ratio = app.ratio;
    context.font = `600 ${12 * ratio}px system-ui, "DejaVu Sans", sans-serif`;
    context.lineWidth = 3 * ratio;
    context.lineJoin = 'round';
    context.strokeStyle = '#000c';
    context.fillStyle = '#fff';
    for (const box of app.boxes()) {
      context.save();
      context.beginPath();
      context.rect(box.x, 0, box.width, height);
      context.clip();
      for (const { place, lines } of labels) {
        const [x, y] = app.onScreen(place, box);
        if (x < box.x - 200 || x > box.x + box.width + 50 || y < -50 || y > height + 50) continue;
        lines.forEach((text, k) => {
          const at = [x + 12 * ratio, y + (4 + 14 * k) * ratio];
          context.strokeText(text, ...at);
          context.fillText(text, ...at);
        });
      }
      context.restore();
    }
  }

  #scale(view) {
    const { app } = this, { grid } = app.product;
    const perPixel = grid.gsd * grid.unit_m * this.#truth(view) / (view.zoom / app.ratio);
    const metres = niceStep(90 * perPixel);
    $('scale-bar').style.width = `${metres / perPixel}px`;
    $('scale-text').textContent = metres >= 1000 ? `${metres / 1000} km` : metres >= 1 ? `${metres} m` : `${metres * 100} cm`;
  }

  // Metres on the ground per metre on the map, in the middle of the view.
  #truth(view) {
    const { surface, height_range: [low, high], grid } = this.app.product;
    if (!surface) return 1;
    const { byU } = surface.point(view.cx, view.cy, 0.5 * (low + high));
    const scale = Math.hypot(...byU) / grid.unit_m;
    return Number.isFinite(scale) && scale > 0.1 && scale < 10 ? scale : 1;
  }

  #north(view) {
    const { surface } = this.app.product;
    if (!surface) return;
    const [dc, dr] = surface.lattice.north(view.cx, view.cy);
    const angle = Math.atan2(dc, -dr) * 180 / Math.PI;
    $('needle').setAttribute('transform', `rotate(${angle.toFixed(2)})`);
    $('north').setAttribute('aria-label', `True north is ${angle.toFixed(1)} degrees clockwise from the top`);
    this.app.northAngle = angle;
  }
}
