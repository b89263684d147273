// Vectors and 3 x 3 matrices (rows of rows), as far as measuring needs them.

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const plus = (a, b, t = 1) => [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]];
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);
export const transpose = (m) => m[0].map((_, k) => m.map((row) => row[k]));
export const times = (a, b) => a.map((row) => b[0].map((_, j) => row.reduce((s, v, k) => s + v * b[k][j], 0)));

// Inverse of a 3 x 3 matrix; null where there is none.
export function inverse(m) {
  const c0 = cross(m[1], m[2]), c1 = cross(m[2], m[0]), c2 = cross(m[0], m[1]);
  const determinant = dot(m[0], c0);
  const scale = norm(m[0]) * norm(m[1]) * norm(m[2]);
  if (!(Math.abs(determinant) > 1e-13 * scale)) return null;
  return [0, 1, 2].map((k) => [c0[k] / determinant, c1[k] / determinant, c2[k] / determinant]);
}

// Where two rays come closest: midpoint, depths in lengths of the directions, shortest distance.
export function intersectTwoRays(left, a, right, b) {
  const base = minus(right, left), normal = cross(a, b), square = dot(normal, normal);
  if (!(square > 1e-28 * dot(a, a) * dot(b, b))) return null;
  const s = dot(cross(base, b), normal) / square, t = dot(cross(base, a), normal) / square;
  const onLeft = plus(left, a, s), onRight = plus(right, b, t);
  return { point: plus(onLeft, minus(onRight, onLeft), 0.5), depths: [s, t], miss: norm(minus(onLeft, onRight)) };
}
