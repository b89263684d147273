// Pieces of WebGL: programs, meshes, textures, and the table of brightness.

// 256 bytes: brightness and contrast about the middle, then gamma.
export function lookupTable({ brightness, contrast, gamma }) {
  const out = new Uint8Array(256);
  for (let k = 0; k < 256; k++) {
    const value = (k / 255 - 0.5) * contrast + 0.5 + brightness;
    out[k] = Math.round(255 * Math.min(Math.max(value, 0), 1) ** (1 / gamma));
  }
  return out;
}

export function nearest(gl) {
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
}

// Begin to compile a program. The driver does so beside the page until it is asked what came of it.
export function beginProgram(gl, [vertex, fragment]) {
  const id = gl.createProgram();
  const shaders = [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]].map(([kind, text]) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(id, shader);
    return shader;
  });
  gl.linkProgram(id);
  return { id, shaders };
}

// The program with the places of its uniforms, by name; waits until it is compiled.
export function readyProgram(gl, { id, shaders }) {
  if (!gl.getProgramParameter(id, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error([...shaders.map((shader) => gl.getShaderInfoLog(shader)), gl.getProgramInfoLog(id)].join('\n'));
  }
  const found = { id };
  const count = gl.getProgramParameter(id, gl.ACTIVE_UNIFORMS) ?? 0;
  for (let k = 0; k < count; k++) {
    const { name } = gl.getActiveUniform(id, k);
    found[name] = gl.getUniformLocation(id, name);
  }
  return found;
}

// A unit square of n x n cells.
export function mesh(gl, n) {
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
