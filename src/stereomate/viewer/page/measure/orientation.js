// The orientation's share in a point. Port of stereomate/stereo/orientation_share.py and exact.py.

import { minus, times, transpose } from './linear.js';

const SIX = [0, 1, 2, 3, 4, 5];

// What an adjustment knows of the photographs, by their numbers; null where it is not stated.
export function orientationOf(record) {
  if (!record) return null;
  return {
    own: new Map(record.photographs),
    pairs: new Map(record.pairs.map(([a, b, matrix]) => [`${a}_${b}`, matrix])),
  };
}

// Covariance (12 x 12) of two orientations: what is stated for all ({centre, angle}: metres, radians, independent of
// each other), else what is known of these two, else null.
export function covarianceOfPair(known, [left, right], stated) {
  if (stated.centre > 0 || stated.angle > 0) {
    const variances = [0, 1].flatMap(() => [stated.centre, stated.angle].flatMap((s) => [s * s, s * s, s * s]));
    return variances.map((v, i) => variances.map((_, j) => (i === j ? v : 0)));
  }
  if (!known) return null;
  const a = known.own.get(left), b = known.own.get(right);
  const swapped = known.pairs.get(`${right}_${left}`);
  const common = known.pairs.get(`${left}_${right}`) ?? (swapped && transpose(swapped));
  if (!a || !b || !common) return null;
  const back = transpose(common);
  return [...SIX.map((k) => [...a[k], ...common[k]]), ...SIX.map((k) => [...back[k], ...b[k]])];
}

// Covariance of a point by the orientations of its photographs.
export function orientationCovariance(met, centres, sigma, pair) {
  // an image of A is that of A - dO - theta x (A - O) under the orientation in use
  const shares = centres.map((centre, k) => {
    const gain = times(met.covariance, transpose(met.parts[k])).map((line) => line.map((v) => v / sigma ** 2));
    const moved = times(gain, met.parts[k]).map((line) => line.map((v) => -v));
    const [x, y, z] = minus(met.point, centre);
    const turned = times(moved, [[0, -z, y], [z, 0, -x], [-y, x, 0]]).map((line) => line.map((v) => -v));
    return [moved, turned];
  }).flat();
  const by = [0, 1, 2].map((i) => shares.flatMap((part) => part[i]));
  return times(times(by, pair), transpose(by));
}
