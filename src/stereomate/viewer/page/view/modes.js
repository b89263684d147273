// Viewing modes. Both eyes are mixed as  out = left * mL + right * mR  (rows: red, green, blue), or laid out.

const GREY = [0.299, 0.587, 0.114], ZERO = [0, 0, 0];
const R = [1, 0, 0], G = [0, 1, 0], B = [0, 0, 1];

export const MODES = {
  'half-colour': { title: 'Anaglyph, half colour', left: [GREY, ZERO, ZERO], right: [ZERO, G, B] },
  colour: { title: 'Anaglyph, colour', left: [R, ZERO, ZERO], right: [ZERO, G, B] },
  grey: { title: 'Anaglyph, grey', left: [GREY, ZERO, ZERO], right: [ZERO, GREY, GREY] },
  // E. Dubois, A projection method to generate anaglyph stereo images, ICASSP 2001: red-cyan glasses
  dubois: {
    title: 'Anaglyph, Dubois',
    left: [[0.456, 0.500, 0.176], [-0.040, -0.038, -0.016], [-0.015, -0.021, -0.005]],
    right: [[-0.043, -0.088, -0.002], [0.378, 0.734, -0.018], [-0.072, -0.113, 1.226]],
  },
  parallel: { title: 'Side by side, parallel', layout: 'side' },
  crossed: { title: 'Side by side, crossed', layout: 'side', crossed: true },
  interlaced: { title: 'Row-interlaced', select: 1 },
  wiggle: { title: 'Wiggle, without glasses', layout: 'one' },
  left: { title: 'Left eye only', layout: 'one', eye: 0 },
  right: { title: 'Right eye only', layout: 'one', eye: 1 },
  difference: { title: 'Difference', select: 2 },
};
export const MODE_NAMES = Object.keys(MODES);

// How often the eyes change in wiggle mode, milliseconds.
export const WIGGLE_MS = 180;
export const WIGGLE_CALM_MS = 900;
