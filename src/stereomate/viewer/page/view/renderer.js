// Draws both eyes: tiles through the table of each eye, layers on the ground, lines and the mark; then mixes them.

import { MODES } from './modes.js';
import { EYES, TileCache } from './tilecache.js';
import * as shaders from './shaders.js';

const GRID = 24;
// Numbers of a line segment: both ends in both eyes, offsets in pixels, colour, width.
export const SEGMENT = 17;

export class Unsupported extends Error {}

export class Renderer {
  constructor(canvas, product, changed) {
    this.canvas = canvas;
    this.product = product;
    const gl = canvas.getContext('webgl2', { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: false });
    if (!gl) throw new Unsupported('WebGL2');
    this.gl = gl;
    this.cache = new TileCache(gl, product, changed);
    this.#build();
    this.relief = null;
    this.layers = [];
    this.lines = new Float32Array(0);
    this.linesChanged = false;
    this.times = [];
    this.tablesFor = '';
    canvas.addEventListener('webglcontextlost', (event) => event.preventDefault());
    canvas.addEventListener('webglcontextrestored', () => {
      this.cache.forget();
      this.#build();
      this.tablesFor = '';
      this.linesChanged = true;
      if (this.reliefValues) this.setRelief(this.reliefValues, this.reliefShape);
      for (const layer of this.layers) layer.texture = this.#imageTexture(layer.image, layer.smooth);
      changed();
    });
  }

  #build() {
    const gl = this.gl;
    this.tileProgram = program(gl, shaders.TILE_VERTEX, shaders.TILE_FRAGMENT);
    this.layerProgram = program(gl, shaders.TILE_VERTEX, shaders.LAYER_FRAGMENT);
    this.lineProgram = program(gl, shaders.LINE_VERTEX, shaders.LINE_FRAGMENT);
    this.mixProgram = program(gl, shaders.MIX_VERTEX, shaders.MIX_FRAGMENT);
    this.quad = mesh(gl, 1);
    this.grid = mesh(gl, GRID);
    this.table = gl.createTexture();
    this.targets = null;
    this.noRelief = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.noRelief);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, 1, 1, 0, gl.RED, gl.FLOAT, new Float32Array(1));
    nearest(gl);
    this.relief = null;
    this.segments = gl.createBuffer();
    this.lineArray = gl.createVertexArray();
    gl.bindVertexArray(this.lineArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.quad.buffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.quad.elements);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.segments);
    [[1, 4, 0], [2, 4, 4], [3, 4, 8], [4, 4, 12], [5, 1, 16]].forEach(([place, size, offset]) => {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, 4 * SEGMENT, 4 * offset);
      gl.vertexAttribDivisor(place, 1);
    });
    gl.bindVertexArray(null);
  }

  // Parallaxes of the ground at the nodes of a coarse grid, as both eyes show it.
  setRelief(values, shape) {
    this.reliefValues = values;
    this.reliefShape = shape;
    const gl = this.gl;
    this.relief = [values.left, values.right].map((data) => {
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, shape.cols, shape.rows, 0, gl.RED, gl.FLOAT, data);
      nearest(gl);
      return texture;
    });
  }

  // Pictures over the whole product (ImageData), drawn on the ground in this order.
  setLayers(images) {
    for (const layer of this.layers) this.gl.deleteTexture(layer.texture);
    this.layers = images.map(({ image, smooth }) => ({ image, smooth, texture: this.#imageTexture(image, smooth) }));
  }

  #imageTexture(image, smooth) {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
    nearest(gl);
    if (smooth) {
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    }
    return texture;
  }

  setLines(segments) {
    this.lines = segments;
    this.linesChanged = true;
  }

  // Size of one eye's view in device pixels, for a mode.
  viewSize(mode) {
    const { width, height } = this.canvas;
    return MODES[mode].layout === 'side' ? [Math.floor(width / 2), height] : [width, height];
  }

  // Draw a frame; whether another one is needed to upload tiles that have arrived.
  draw(view, phase) {
    const gl = this.gl, mode = MODES[view.mode];
    const more = this.cache.upload();
    this.#tables(view.eyes);
    if (this.linesChanged) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.segments);
      gl.bufferData(gl.ARRAY_BUFFER, this.lines, gl.DYNAMIC_DRAW);
      this.linesChanged = false;
    }
    const [width, height] = this.viewSize(view.mode);
    const eyes = this.#eyes(view, phase);
    this.wanted = [];
    if (mode.layout === 'one') {
      this.#target(null, 0, width, height);
      this.#eye(view, eyes[0], width, height);
    } else if (mode.layout === 'side') {
      eyes.forEach((eye, k) => {
        this.#target(null, k * (this.canvas.width - width), width, height);
        this.#eye(view, eye, width, height);
      });
    } else {
      const targets = this.#targets(width, height);
      eyes.forEach((eye, k) => {
        this.#target(targets[k].buffer, 0, width, height);
        this.#eye(view, eye, width, height);
      });
      this.#mix(mode, targets, height);
    }
    this.cache.want(this.#ordered(view));
    return more;
  }

  // Which pictures go where: 0 orthophoto, 1 stereomate.
  #eyes(view, phase) {
    const mode = MODES[view.mode];
    if (!this.product.stereo) return [0, 0];
    if (mode.layout === 'one') {
      const eye = mode.eye ?? phase;
      return [view.swap ? 1 - eye : eye];
    }
    const crossed = Boolean(mode.crossed) !== view.swap;
    return crossed ? [1, 0] : [0, 1];
  }

  #target(buffer, x, width, height) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
    gl.viewport(x, 0, width, height);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(x, 0, width, height);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  #targets(width, height) {
    const gl = this.gl;
    if (this.targets && this.targets[0].width === width && this.targets[0].height === height) return this.targets;
    for (const old of this.targets ?? []) {
      gl.deleteTexture(old.texture);
      gl.deleteFramebuffer(old.buffer);
    }
    this.targets = [0, 1].map(() => {
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, width, height);
      nearest(gl);
      const buffer = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
      return { texture, buffer, width, height };
    });
    return this.targets;
  }

  #tables(eyes) {
    const key = JSON.stringify(eyes);
    if (key === this.tablesFor) return;
    this.tablesFor = key;
    const data = new Uint8Array(512);
    eyes.forEach((eye, k) => data.set(lookupTable(eye), 256 * k));
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, 256, 2, 0, gl.RED, gl.UNSIGNED_BYTE, data);
    nearest(gl);
  }

  // Shift of an eye's own picture, and of ground geometry, as (constant, times parallax of the ground).
  shifts(view, eye) {
    if (eye === 0 || !this.product.stereo) return { image: [0, 0], ground: [0, 0] };
    const e = this.relief ? view.exaggeration : 1;
    const constant = e * view.accommodation - view.offset;
    return { image: [constant, 1 - e], ground: [constant, -e] };
  }

  #place(used, view, width, height, shift, relief) {
    const gl = this.gl;
    gl.uniform2f(used.uCentre, view.cx, view.cy);
    gl.uniform2f(used.uScale, 2 * view.zoom / width, 2 * view.zoom / height);
    gl.uniform2f(used.uShift, shift[0], this.relief ? shift[1] : 0);
    gl.uniform1f(used.uReliefStep, this.product.layers.step);
    gl.uniform1i(used.uRelief, 2);
    gl.activeTexture(gl.TEXTURE2);
    gl.bindTexture(gl.TEXTURE_2D, this.relief ? this.relief[relief] : this.noRelief);
    gl.activeTexture(gl.TEXTURE0);
  }

  #eye(view, eye, width, height) {
    const gl = this.gl, { image, ground } = this.shifts(view, eye);
    gl.disable(gl.BLEND);
    let used = this.tileProgram;
    gl.useProgram(used.id);
    this.#place(used, view, width, height, image, 1);
    gl.uniform1i(used.uImage, 0);
    gl.uniform1i(used.uTable, 1);
    gl.uniform1i(used.uEye, eye);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.activeTexture(gl.TEXTURE0);
    const shape = image[1] !== 0 && this.relief ? this.grid : this.quad;
    gl.bindVertexArray(shape.array);
    const sharp = view.zoom >= 4;
    for (const part of this.#parts(view, eye, width, height, image)) {
      gl.bindTexture(gl.TEXTURE_2D, part.tile.texture);
      if (part.tile.nearest !== sharp) {
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, sharp ? gl.NEAREST : gl.LINEAR);
        part.tile.nearest = sharp;
      }
      gl.uniform4f(used.uRectangle, ...part.rectangle);
      gl.uniform4f(used.uTexture, ...part.texture);
      gl.drawElements(gl.TRIANGLES, shape.count, gl.UNSIGNED_SHORT, 0);
    }
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    if (this.layers.length) {
      used = this.layerProgram;
      gl.useProgram(used.id);
      this.#place(used, view, width, height, ground, 0);
      gl.uniform1i(used.uImage, 0);
      const { cols, rows, step } = this.product.layers;
      gl.uniform4f(used.uTexture, 0, 0, 1, 1);
      gl.uniform4f(used.uRectangle, 0, 0, cols * step, rows * step);
      const sheet = ground[1] === 0 ? this.quad : this.large();
      gl.bindVertexArray(sheet.array);
      for (const layer of this.layers) {
        gl.bindTexture(gl.TEXTURE_2D, layer.texture);
        gl.drawElements(gl.TRIANGLES, sheet.count, gl.UNSIGNED_SHORT, 0);
      }
    }
    this.#drawLines(view, eye, width, height, image);
    gl.bindVertexArray(null);
  }

  // A fine mesh for layers that lie on the ground of the whole product.
  large() {
    this.largeMesh ??= mesh(this.gl, 128);
    return this.largeMesh;
  }

  #drawLines(view, eye, width, height, shift) {
    const gl = this.gl, used = this.lineProgram, count = this.lines.length / SEGMENT;
    if (!count) return;
    gl.useProgram(used.id);
    this.#place(used, view, width, height, shift, 1);
    gl.uniform1i(used.uEye, this.product.stereo ? eye : 0);
    gl.uniform2f(used.uViewport, width, height);
    gl.bindVertexArray(this.lineArray);
    for (const [wider, dark] of [[2.5, 1], [0, 0]]) {
      gl.uniform1f(used.uWider, wider);
      gl.uniform1f(used.uDark, dark);
      gl.drawElementsInstanced(gl.TRIANGLES, 6, gl.UNSIGNED_SHORT, 0, count);
    }
  }

  // Level whose pixels are nearest to those of the screen.
  level(zoom) {
    return Math.min(Math.max(Math.round(Math.log2(1 / zoom)), 0), this.cache.levels - 1);
  }

  // Tiles of an eye's view, with the parts of coarser ones where they are not there yet, coarse ones first.
  #parts(view, eye, width, height, shift) {
    const parts = [], level = this.level(view.zoom);
    const { tile, apron } = this.cache, name = EYES[eye];
    // what the mesh may move tiles by
    const [low, high] = this.#moved(shift);
    const left = view.cx - width / (2 * view.zoom) - high, right = view.cx + width / (2 * view.zoom) - low;
    const top = view.cy - height / (2 * view.zoom), bottom = view.cy + height / (2 * view.zoom);
    const edge = tile * 2 ** level, [cols, rows] = this.cache.levelSize(level);
    const c0 = Math.max(Math.floor(left / edge), 0), c1 = Math.min(Math.floor(right / edge), Math.ceil(cols / tile) - 1);
    const r0 = Math.max(Math.floor(top / edge), 0), r1 = Math.min(Math.floor(bottom / edge), Math.ceil(rows / tile) - 1);
    for (let row = r0; row <= r1; row++) {
      for (let col = c0; col <= c1; col++) {
        this.wanted.push([name, level, col, row]);
        let found = null, up = 0;
        for (; level + up < this.cache.levels && !found; up++) {
          found = this.cache.get(name, level + up, col >> up, row >> up);
        }
        if (!found) continue;
        up--;
        const scale = 2 ** level, coarse = 2 ** (level + up);
        const w = Math.min(tile, cols - col * tile), h = Math.min(tile, rows - row * tile);
        const x = col * edge, y = row * edge;
        // where the part lies inside the texture, the apron around it
        const tx = x / coarse - (col >> up) * tile + apron, ty = y / coarse - (row >> up) * tile + apron;
        parts.push({
          up,
          tile: found,
          rectangle: [x, y, w * scale, h * scale],
          texture: [tx / found.width, ty / found.height, w / 2 ** up / found.width, h / 2 ** up / found.height],
        });
      }
    }
    const top_ = this.cache.levels - 1;
    for (let r = 0; r * tile < this.cache.levelSize(top_)[1]; r++) {
      for (let c = 0; c * tile < this.cache.levelSize(top_)[0]; c++) this.wanted.push([name, top_, c, r]);
    }
    return parts.sort((a, b) => b.up - a.up);
  }

  #moved(shift) {
    if (!this.relief || shift[1] === 0) return [shift[0], shift[0]];
    this.reliefRange ??= this.reliefValues.right.reduce(
      ([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
    const ends = this.reliefRange.map((q) => shift[0] + shift[1] * q);
    return [Math.min(...ends), Math.max(...ends)];
  }

  // The coarsest level first, then from the middle outwards, both eyes by turns.
  #ordered(view) {
    const top = this.cache.levels - 1, tile = this.cache.tile;
    const distance = ([, level, col, row]) => {
      if (level === top) return -1;
      const edge = tile * 2 ** level;
      return Math.hypot((col + 0.5) * edge - view.cx, (row + 0.5) * edge - view.cy);
    };
    return this.wanted.map((place) => [distance(place), place]).sort((a, b) => a[0] - b[0]).map(([, place]) => place);
  }

  #mix(mode, targets, height) {
    const gl = this.gl, used = this.mixProgram;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.disable(gl.SCISSOR_TEST);
    gl.disable(gl.BLEND);
    gl.useProgram(used.id);
    targets.forEach((target, k) => {
      gl.activeTexture(gl.TEXTURE0 + k);
      gl.bindTexture(gl.TEXTURE_2D, target.texture);
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform1i(used.uLeft, 0);
    gl.uniform1i(used.uRight, 1);
    gl.uniform1i(used.uSelect, mode.select ?? 0);
    gl.uniform1i(used.uRows, height);
    if (mode.left) {
      gl.uniformMatrix3fv(used.uFromLeft, true, mode.left.flat());
      gl.uniformMatrix3fv(used.uFromRight, true, mode.right.flat());
    }
    gl.bindVertexArray(this.quad.array);
    gl.drawElements(gl.TRIANGLES, this.quad.count, gl.UNSIGNED_SHORT, 0);
  }

  // The page's own work for a frame, milliseconds.
  frameTook(milliseconds) {
    this.times.push(milliseconds);
    if (this.times.length > 600) this.times.shift();
  }

  // Middle of the times that frames took, milliseconds.
  get medianMs() {
    const sorted = [...this.times].sort((a, b) => a - b);
    return sorted.length ? sorted[sorted.length >> 1] : NaN;
  }
}

// 256 bytes: brightness and contrast about the middle, then gamma.
export function lookupTable({ brightness, contrast, gamma }) {
  const out = new Uint8Array(256);
  for (let k = 0; k < 256; k++) {
    const value = (k / 255 - 0.5) * contrast + 0.5 + brightness;
    out[k] = Math.round(255 * Math.min(Math.max(value, 0), 1) ** (1 / gamma));
  }
  return out;
}

function nearest(gl) {
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
}

function program(gl, vertex, fragment) {
  const id = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(id, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
      throw new Error(gl.getShaderInfoLog(shader));
    }
  }
  gl.linkProgram(id);
  const found = { id };
  const count = gl.getProgramParameter(id, gl.ACTIVE_UNIFORMS) ?? 0;
  for (let k = 0; k < count; k++) {
    const { name } = gl.getActiveUniform(id, k);
    found[name] = gl.getUniformLocation(id, name);
  }
  return found;
}

// A unit square of n x n cells.
function mesh(gl, n) {
  const points = new Float32Array(2 * (n + 1) ** 2), indices = new Uint16Array(6 * n * n);
  for (let r = 0, k = 0; r <= n; r++) for (let c = 0; c <= n; c++) { points[k++] = c / n; points[k++] = r / n; }
  for (let r = 0, k = 0; r < n; r++) {
    for (let c = 0; c < n; c++) {
      const a = r * (n + 1) + c, b = a + n + 1;
      indices.set([a, a + 1, b, b, a + 1, b + 1], k);
      k += 6;
    }
  }
  const array = gl.createVertexArray(), buffer = gl.createBuffer();
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, points, gl.STATIC_DRAW);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
  const elements = gl.createBuffer();
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, elements);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
  gl.bindVertexArray(null);
  return { array, buffer, elements, count: indices.length };
}
