// Colours that colour-blind people tell apart: Okabe & Ito's for classes, blue-orange for signs, cividis for heights.

export const LAYER_TITLES = {
  homogeneity: 'Homogeneity: objects read too high or too low', hillshade: 'Hillshade', tints: 'Heights of the ground',
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

const CIVIDIS = [[0, 34, 78], [54, 69, 108], [102, 105, 112], [148, 142, 119], [200, 184, 102], [254, 232, 56]];
export function heightColour(t) {
  const x = Math.min(Math.max(t, 0), 1) * (CIVIDIS.length - 1), k = Math.min(Math.floor(x), CIVIDIS.length - 2);
  return CIVIDIS[k].map((v, n) => Math.round(v + (x - k) * (CIVIDIS[k + 1][n] - v)));
}
