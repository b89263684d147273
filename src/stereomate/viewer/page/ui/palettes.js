// Colours that colour-blind people tell apart: Okabe & Ito's for classes, blue-orange for signs,
// cividis and plasma for heights.

export const LAYER_TITLES = {
  homogeneity: 'Homogeneity: objects read too high or too low', objects: 'Heights of objects', hillshade: 'Hillshade', tints: 'Heights of the ground',
  contours: 'Contours', lineage: 'Which photograph is seen', seams: 'Seamlines', photographs: 'Projection centres',
  points: 'Control and check points', grid: 'Map grid',
};

const CLASSES = [[230, 159, 0], [86, 180, 233], [0, 158, 115], [240, 228, 66], [0, 114, 178], [213, 94, 0], [204, 121, 167], [200, 200, 200]];
export const classColour = (k) => CLASSES[k % CLASSES.length];

// -1 blue, 0 white, +1 orange.
export function divergingColour(t) {
  const s = Math.min(Math.abs(t), 1) ** 0.7, end = t < 0 ? [33, 102, 214] : [230, 97, 1];
  return end.map((v) => Math.round(255 + s * (v - 255)));
}

function along(colours, t) {
  const x = Math.min(Math.max(t, 0), 1) * (colours.length - 1), k = Math.min(Math.floor(x), colours.length - 2);
  return colours[k].map((v, n) => Math.round(v + (x - k) * (colours[k + 1][n] - v)));
}

const CIVIDIS = [[0, 34, 78], [54, 69, 108], [102, 105, 112], [148, 142, 119], [200, 184, 102], [254, 232, 56]];
export const heightColour = (t) => along(CIVIDIS, t);

// Plasma without its darkest end: what stands on dark ground is seen too.
const PLASMA = [[84, 2, 163], [139, 10, 165], [185, 50, 137], [219, 92, 104], [244, 136, 73], [254, 188, 43], [240, 249, 33]];
export const objectColour = (t) => along(PLASMA, t);
