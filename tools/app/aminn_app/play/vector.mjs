/** Vectors of 3 numbers, and matrices as flat arrays, row by row. */

export const add = (a, b) => a.map((x, i) => x + b[i]);
export const subtract = (a, b) => a.map((x, i) => x - b[i]);
export const scaled = (a, s) => a.map((x) => x * s);
export const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
export const norm = (a) => Math.hypot(...a);
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** The unit vector along a; a itself where it is zero. */
export function unit(a) {
  const size = norm(a);
  return size > 0 ? scaled(a, 1 / size) : a;
}

/** Two unit vectors that make a right-handed frame with the unit vector z. */
export function acrossOf(z) {
  const x = unit(cross(Math.abs(z[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], z));
  return [x, cross(z, x)];
}

/** Product of a matrix of n rows with another matrix, or with a vector of as many numbers as it has columns. */
export function times(a, b, n = 3) {
  const inner = a.length / n;
  const columns = b.length / inner;
  const found = new Array(n * columns).fill(0);
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < columns; j++) {
      for (let k = 0; k < inner; k++) found[i * columns + j] += a[i * inner + k] * b[k * columns + j];
    }
  }
  return found;
}

export function transposed(a, rows = 3) {
  const columns = a.length / rows;
  return Array.from({ length: a.length }, (_, k) => a[(k % rows) * columns + Math.floor(k / rows)]);
}

/** Inverse of an n x n matrix, by elimination with pivots. */
export function inverse(a, n = 3) {
  const rows = Array.from({ length: n }, (_, i) => [
    ...Array.from(a.slice(i * n, i * n + n)),
    ...Array.from({ length: n }, (_unused, j) => (i === j ? 1 : 0)),
  ]);
  for (let c = 0; c < n; c++) {
    let pivot = c;
    for (let r = c + 1; r < n; r++) if (Math.abs(rows[r][c]) > Math.abs(rows[pivot][c])) pivot = r;
    [rows[c], rows[pivot]] = [rows[pivot], rows[c]];
    rows[c] = scaled(rows[c], 1 / rows[c][c]);
    for (let r = 0; r < n; r++) {
      const share = rows[r][c];
      if (r !== c && share !== 0) rows[r] = rows[r].map((x, k) => x - share * rows[c][k]);
    }
  }
  return rows.flatMap((row) => row.slice(n));
}

/** Rotation matrix of a rotation vector. */
export function rotation(turn) {
  const angle = norm(turn);
  const [x, y, z] = unit(turn);
  const [s, c] = [Math.sin(angle), 1 - Math.cos(angle)];
  return [
    1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y,
    c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x,
    c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y),
  ];
}

/** Angle of a rotation matrix, rad. */
export function angleOf(matrix) {
  const axial = [matrix[7] - matrix[5], matrix[2] - matrix[6], matrix[3] - matrix[1]];
  return Math.atan2(norm(axial), matrix[0] + matrix[4] + matrix[8] - 1);
}

/** Rotation matrix of a unit quaternion, scalar first. */
export function ofQuaternion([w, ...v]) {
  const half = Math.atan2(norm(v), w);
  return rotation(scaled(unit(v), 2 * half));
}

/** Largest eigenvalue of a symmetric positive definite 3 x 3 matrix, by iteration. */
export function largestEigenvalue(a) {
  let v = unit([1, 0.7, 0.4]);
  for (let k = 0; k < 60; k++) v = unit(times(a, v));
  return norm(times(a, v));
}
