// The shaders. Brightness, contrast and gamma come from a table of 256 values for each eye: no pow per pixel.

const RELIEF = `
uniform sampler2D uRelief;    // parallax of the ground at the cells of a coarse grid, product pixels
uniform float uReliefStep;    // product pixels per cell
float parallax(vec2 p) {
  ivec2 size = textureSize(uRelief, 0);
  vec2 x = clamp(p / uReliefStep - 0.5, vec2(0.0), vec2(size - 1));
  ivec2 i = min(ivec2(x), max(size - 2, ivec2(0)));
  vec2 f = x - vec2(i);
  ivec2 j = min(i + 1, size - 1);
  float a = texelFetch(uRelief, i, 0).r, b = texelFetch(uRelief, ivec2(j.x, i.y), 0).r;
  float c = texelFetch(uRelief, ivec2(i.x, j.y), 0).r, d = texelFetch(uRelief, j, 0).r;
  return mix(mix(a, b, f.x), mix(c, d, f.x), f.y);
}
`;

const PLACE = `
uniform vec2 uCentre;         // product pixel at the middle of the view
uniform vec2 uScale;          // clip units per product pixel
uniform vec2 uShift;          // of this eye: constant, and times the parallax of the ground
vec2 placed(vec2 p) {
  float x = p.x + uShift.x;
  if (uShift.y != 0.0) x += uShift.y * parallax(p);
  return vec2((x - uCentre.x) * uScale.x, -(p.y - uCentre.y) * uScale.y);
}
`;

export const TILE_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec2 aUnit;
uniform vec4 uRectangle;      // product pixels: left, top, width, height
uniform vec4 uTexture;        // the same in texture coordinates
${RELIEF}${PLACE}
out vec2 vTexture;
void main() {
  vTexture = uTexture.xy + aUnit * uTexture.zw;
  gl_Position = vec4(placed(uRectangle.xy + aUnit * uRectangle.zw), 0.0, 1.0);
}`;

export const TILE_FRAGMENT = `#version 300 es
precision mediump float;
uniform sampler2D uImage;
uniform sampler2D uTable;     // 256 x 2: what each byte becomes, for each eye
uniform int uEye;
in vec2 vTexture;
out vec4 colour;
void main() {
  ivec3 c = ivec3(texture(uImage, vTexture).rgb * 255.0 + 0.5);
  colour = vec4(texelFetch(uTable, ivec2(c.r, uEye), 0).r, texelFetch(uTable, ivec2(c.g, uEye), 0).r,
                texelFetch(uTable, ivec2(c.b, uEye), 0).r, 1.0);
}`;

// A layer on the ground: a picture over the whole product, half transparent.
export const LAYER_FRAGMENT = `#version 300 es
precision mediump float;
uniform sampler2D uImage;
in vec2 vTexture;
out vec4 colour;
void main() { colour = texture(uImage, vTexture); }`;

// Lines of constant width on the screen; each end has a place in both eyes and an offset in pixels.
export const LINE_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec2 aUnit;
layout(location = 1) in vec4 aStart;
layout(location = 2) in vec4 aEnd;
layout(location = 3) in vec4 aOffset;
layout(location = 4) in vec4 aColour;
layout(location = 5) in float aWidth;
uniform int uEye;
uniform vec2 uViewport;       // pixels
uniform float uWider;         // pixels added: the dark casing below the line
uniform float uDark;
${RELIEF}${PLACE}
out vec4 vColour;
out float vAcross;
out float vHalf;
void main() {
  vec2 a = placed(uEye == 0 ? aStart.xy : aStart.zw) * 0.5 * uViewport + aOffset.xy * vec2(1.0, -1.0);
  vec2 b = placed(uEye == 0 ? aEnd.xy : aEnd.zw) * 0.5 * uViewport + aOffset.zw * vec2(1.0, -1.0);
  vec2 along = b - a;
  float size = length(along);
  along = size > 1e-6 ? along / size : vec2(1.0, 0.0);
  vec2 across = vec2(-along.y, along.x);
  vHalf = 0.5 * (aWidth + uWider);
  float reach = vHalf + 0.75;
  vAcross = (aUnit.y * 2.0 - 1.0) * reach;
  vec2 p = mix(a - along * (0.5 * uWider), b + along * (0.5 * uWider), aUnit.x) + across * vAcross;
  vColour = vec4(mix(aColour.rgb, vec3(0.0), uDark), aColour.a * mix(1.0, 0.75, uDark));
  gl_Position = vec4(p / (0.5 * uViewport), 0.0, 1.0);
}`;

export const LINE_FRAGMENT = `#version 300 es
precision mediump float;
in vec4 vColour;
in float vAcross;
in float vHalf;
out vec4 colour;
void main() {
  float cover = clamp(vHalf + 0.5 - abs(vAcross), 0.0, 1.0);
  colour = vec4(vColour.rgb, vColour.a * cover);
}`;

export const MIX_VERTEX = `#version 300 es
layout(location = 0) in vec2 aUnit;
void main() { gl_Position = vec4(aUnit * 2.0 - 1.0, 0.0, 1.0); }`;

export const MIX_FRAGMENT = `#version 300 es
precision mediump float;
uniform sampler2D uLeft;
uniform sampler2D uRight;
uniform mat3 uFromLeft;
uniform mat3 uFromRight;
uniform int uSelect;          // 0 mix, 1 rows by turns, 2 difference
uniform int uRows;
out vec4 colour;
void main() {
  ivec2 p = ivec2(gl_FragCoord.xy);
  vec3 left = texelFetch(uLeft, p, 0).rgb, right = texelFetch(uRight, p, 0).rgb;
  if (uSelect == 1) colour = vec4(((uRows - 1 - p.y) & 1) == 0 ? left : right, 1.0);
  else if (uSelect == 2) colour = vec4(abs(left - right), 1.0);
  else colour = vec4(uFromLeft * left + uFromRight * right, 1.0);
}`;
