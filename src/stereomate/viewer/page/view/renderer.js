// Draws both eyes: tiles through the table of each eye, layers on the ground, lines and the mark; then mixes them.

import { MODES } from './modes.js';
import { beginProgram, lookupTable, mesh, nearest, readyProgram } from './gl.js';
import { TileCache } from './tilecache.js';
import { Visible } from './visible.js';
import {
  LAYER_FRAGMENT, LINE_FRAGMENT, LINE_VERTEX, MIX_FRAGMENT, MIX_VERTEX, TILE_FRAGMENT, TILE_VERTEX,
} from './shaders.js';

// Cells along each side of a tile, and of a layer over the whole product.
const GRID = 24, SHEET = 128;
// Numbers of a line segment: both ends in both eyes, offsets in pixels, colour, width.
export const SEGMENT = 17;
const PROGRAMS = {
  tile: [TILE_VERTEX, TILE_FRAGMENT],
  mix: [MIX_VERTEX, MIX_FRAGMENT],
  layer: [TILE_VERTEX, LAYER_FRAGMENT],
  line: [LINE_VERTEX, LINE_FRAGMENT],
};

export class Unsupported extends Error {}

// The context of a canvas, and the programs that the first picture needs: asked for before anything is known of
// the product, they are ready when it is.
export function begin(canvas) {
  const gl = canvas.getContext('webgl2', { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: false });
  if (!gl) throw new Unsupported('WebGL2');
  return { gl, programs: firstPrograms(gl) };
}

const firstPrograms = (gl) => new Map(['tile', 'mix'].map((name) => [name, beginProgram(gl, PROGRAMS[name])]));

export class Renderer {
  constructor(canvas, { gl, programs }, product, changed) {
    this.canvas = canvas;
    this.product = product;
    this.gl = gl;
    this.begun = programs;
    this.cache = new TileCache(gl, product, changed);
    this.visible = new Visible(this.cache);
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
      this.begun = firstPrograms(gl);
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
    this.programs = new Map();
    this.meshes = new Map();
    this.quad = this.#mesh(1);
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

  // A program where it is first drawn with: most never are.
  #program(name) {
    if (!this.programs.has(name)) {
      const begun = this.begun.get(name) ?? beginProgram(this.gl, PROGRAMS[name]);
      this.programs.set(name, readyProgram(this.gl, begun));
    }
    return this.programs.get(name);
  }

  #mesh(cells) {
    if (!this.meshes.has(cells)) this.meshes.set(cells, mesh(this.gl, cells));
    return this.meshes.get(cells);
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

  // Whether there is something to draw: nothing is before the coarsest tile of each eye is there, or cannot be read.
  get isBegun() {
    this.hasBegun ||= this.cache.resident.size >= this.product.tiles.eyes.length || this.cache.failures > 0;
    return this.hasBegun;
  }

  // Whether the first picture can be drawn now.
  get isComing() {
    return this.cache.ready.length >= this.product.tiles.eyes.length || this.cache.failures > 0;
  }

  // Draw a frame, uploading tiles for some milliseconds; whether another one is needed for those left.
  draw(view, phase, uploadMs) {
    const gl = this.gl, mode = MODES[view.mode];
    const more = this.cache.upload(this.hasBegun ? uploadMs : Infinity);
    if (!this.isBegun) {
      this.cache.want(this.visible.first());
      return false;
    }
    this.#tables(view.eyes);
    if (this.linesChanged) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.segments);
      gl.bufferData(gl.ARRAY_BUFFER, this.lines, gl.DYNAMIC_DRAW);
      this.linesChanged = false;
    }
    const [width, height] = this.viewSize(view.mode);
    const eyes = this.#eyes(view, phase);
    this.visible.begin();
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
    this.cache.want(this.visible.wanted(view));
    return more;
  }

  // Fetch what the view shows next if it moves on by `ahead` (product pixels), and around it.
  lookAhead(view, ahead) {
    this.cache.prepare(this.visible.around(view, ahead));
  }

  // Calls back once the GPU has drawn all that it was told to.
  whenDrawn(done) {
    const gl = this.gl, fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const look = () => {
      if (gl.isContextLost() || gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.SIGNALED) {
        gl.deleteSync(fence);
        done();
      } else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
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
    let used = this.#program('tile');
    gl.useProgram(used.id);
    this.#place(used, view, width, height, image, 1);
    gl.uniform1i(used.uImage, 0);
    gl.uniform1i(used.uTable, 1);
    gl.uniform1i(used.uEye, eye);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.activeTexture(gl.TEXTURE0);
    const shape = image[1] !== 0 && this.relief ? this.#mesh(GRID) : this.quad;
    gl.bindVertexArray(shape.array);
    const sharp = view.zoom >= 4;
    for (const part of this.visible.parts(view, eye, width, height, this.#moved(image))) {
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
      used = this.#program('layer');
      gl.useProgram(used.id);
      this.#place(used, view, width, height, ground, 0);
      gl.uniform1i(used.uImage, 0);
      const { cols, rows, step } = this.product.layers;
      gl.uniform4f(used.uTexture, 0, 0, 1, 1);
      gl.uniform4f(used.uRectangle, 0, 0, cols * step, rows * step);
      const sheet = ground[1] === 0 ? this.quad : this.#mesh(SHEET);
      gl.bindVertexArray(sheet.array);
      for (const layer of this.layers) {
        gl.bindTexture(gl.TEXTURE_2D, layer.texture);
        gl.drawElements(gl.TRIANGLES, sheet.count, gl.UNSIGNED_SHORT, 0);
      }
    }
    this.#drawLines(view, eye, width, height, image);
    gl.bindVertexArray(null);
  }

  #drawLines(view, eye, width, height, shift) {
    const gl = this.gl, count = this.lines.length / SEGMENT;
    if (!count) return;
    const used = this.#program('line');
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

  // By how many pixels the mesh moves tiles, least and most.
  #moved(shift) {
    if (!this.relief || shift[1] === 0) return [shift[0], shift[0]];
    this.reliefRange ??= this.reliefValues.right.reduce(
      ([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
    const ends = this.reliefRange.map((q) => shift[0] + shift[1] * q);
    return [Math.min(...ends), Math.max(...ends)];
  }

  #mix(mode, targets, height) {
    const gl = this.gl, used = this.#program('mix');
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
