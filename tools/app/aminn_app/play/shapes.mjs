/** Triangle meshes {positions, normals, indices}, flat arrays: unit shapes that a matrix makes as large as they are. */

import { add, cross, norm, scaled, subtract, unit } from "./vector.mjs";

/** A mesh of rows of points that lie on a grid, `at(u, v)` with u and v from 0 to 1 giving {position, normal}. */
function grid(nu, nv, at) {
  const [positions, normals, indices] = [[], [], []];
  for (let i = 0; i <= nu; i++) {
    for (let j = 0; j <= nv; j++) {
      const { position, normal } = at(i / nu, j / nv);
      positions.push(...position);
      normals.push(...normal);
    }
  }
  for (let i = 0; i < nu; i++) {
    for (let j = 0; j < nv; j++) {
      const [a, b] = [i * (nv + 1) + j, (i + 1) * (nv + 1) + j];
      indices.push(a, b, a + 1, a + 1, b, b + 1);
    }
  }
  return { positions, normals, indices };
}

function joined(...meshes) {
  const found = { positions: [], normals: [], indices: [] };
  for (const mesh of meshes) {
    const start = found.positions.length / 3;
    found.positions.push(...mesh.positions);
    found.normals.push(...mesh.normals);
    found.indices.push(...mesh.indices.map((i) => i + start));
  }
  return found;
}

const around = (u) => [Math.cos(2 * Math.PI * u), Math.sin(2 * Math.PI * u)];

function disc(z, up) {
  return grid(24, 1, (u, v) => {
    const [c, s] = around(up > 0 ? 1 - u : u);
    return { position: [v * c, v * s, z], normal: [0, 0, up] };
  });
}

/** Radius 1. */
export const SPHERE = grid(32, 16, (u, v) => {
  const [c, s] = around(u);
  const [r, z] = [Math.sin(Math.PI * v), -Math.cos(Math.PI * v)];
  return { position: [r * c, r * s, z], normal: [r * c, r * s, z] };
});

/** Radius 1, from z = 0 to 1, open. */
export const TUBE = grid(24, 1, (u, v) => {
  const [c, s] = around(u);
  return { position: [c, s, v], normal: [c, s, 0] };
});

/** The same with its ends. */
export const CYLINDER = joined(TUBE, disc(0, -1), disc(1, 1));

/** Radius 1 at z = 0, its tip at z = 1. */
export const CONE = joined(
  grid(24, 1, (u, v) => {
    const [c, s] = around(u);
    return { position: [(1 - v) * c, (1 - v) * s, v], normal: unit([c, s, 1]) };
  }),
  disc(0, -1),
);

/** Apex in the origin, radius 1 at z = 1, open: a friction cone. */
export const FUNNEL = grid(32, 1, (u, v) => {
  const [c, s] = around(u);
  return { position: [v * c, v * s, v], normal: unit([c, s, -1]) };
});

/** A ring about z of radius 1 and such a thickness, or as much of it as `share` says. */
export function ring(thickness, share = 1) {
  return grid(share < 1 ? 36 : 28, 10, (u, v) => {
    const [c, s] = around(share * u);
    const [out, up] = around(v);
    const r = 1 + thickness * out;
    return { position: [r * c, r * s, thickness * up], normal: [out * c, out * s, up] };
  });
}

/** A capsule along z: radius and half length of its straight part. */
export function capsule(radius, half) {
  const quarter = 10;
  return grid(32, 2 * quarter + 1, (u, v) => {
    const [c, s] = around(u);
    const row = Math.round(v * (2 * quarter + 1));
    const angle = ((row <= quarter ? row : row - 1) / quarter) * (Math.PI / 2);
    const [r, z] = [Math.sin(angle), -Math.cos(angle)];
    return { position: [radius * r * c, radius * r * s, radius * z + (row <= quarter ? -half : half)], normal: [r * c, r * s, z] };
  });
}

/** Unit directions that cover the sphere evenly: the corners of an icosahedron whose faces are cut in four so many times. */
export function directions(cuts) {
  const g = (1 + Math.sqrt(5)) / 2;
  const corners = [[-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0], [0, -1, g], [0, 1, g], [0, -1, -g], [0, 1, -g],
    [g, 0, -1], [g, 0, 1], [-g, 0, -1], [-g, 0, 1]].map(unit);
  let faces = [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6],
    [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]];
  for (let cut = 0; cut < cuts; cut++) {
    const middles = new Map();
    const middle = (a, b) => {
      const key = a < b ? `${a} ${b}` : `${b} ${a}`;
      if (!middles.has(key)) middles.set(key, corners.push(unit(add(corners[a], corners[b]))) - 1);
      return middles.get(key);
    };
    faces = faces.flatMap(([a, b, c]) => {
      const [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
      return [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]];
    });
  }
  return { corners, faces };
}

/** The mesh of faces (triples of points) with a normal a point, the mean of its faces', and a colour a point. */
export function surface(points, faces, colours) {
  const normals = points.map(() => [0, 0, 0]);
  for (const [a, b, c] of faces) {
    const normal = cross(subtract(points[b], points[a]), subtract(points[c], points[a]));
    for (const i of [a, b, c]) normals[i] = add(normals[i], normal);
  }
  const whole = normals.map((normal) => (norm(normal) > 0 ? scaled(normal, 1 / norm(normal)) : [0, 0, 1]));
  return { positions: points.flat(), normals: whole.flat(), indices: faces.flat(), colours: colours.flat() };
}
