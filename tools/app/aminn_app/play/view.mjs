/** A picture of meshes on a canvas, by WebGL, and the camera that looks at it. Lengths in m, z up. */

import { add, cross, dot, inverse, scaled, subtract, unit } from "./vector.mjs";

const FIELD_OF_VIEW = 0.5; // rad, of the shorter side
const [NEAR_M, FAR_M] = [0.02, 3];
const LIGHT = unit([0.5, -0.35, 0.8]);
const FINEST = 2; // pixels drawn for each of the page's, at most

const VERTEX = `
attribute vec3 position; attribute vec3 normal; attribute vec3 colour;
uniform mat4 model; uniform mat4 camera; uniform mat3 turn; uniform vec3 base; uniform float own;
varying vec3 place; varying vec3 out_; varying vec3 paint;
void main() {
  vec4 p = model * vec4(position, 1.0);
  place = p.xyz; out_ = turn * normal; paint = mix(base, colour, own);
  gl_Position = camera * p;
}`;
const FRAGMENT = `
precision mediump float;
uniform vec3 eye; uniform vec3 light; uniform float alpha;
varying vec3 place; varying vec3 out_; varying vec3 paint;
void main() {
  vec3 v = normalize(eye - place);
  vec3 n = normalize(out_);
  if (dot(n, v) < 0.0) n = -n;
  float lit = 0.58 + 0.12 * n.z + 0.34 * max(dot(n, light), 0.0);
  float shine = 0.16 * pow(max(dot(n, normalize(light + v)), 0.0), 32.0);
  float rim = pow(1.0 - abs(dot(n, v)), 2.0);
  float a = alpha < 1.0 ? alpha + (0.85 - alpha) * 0.6 * rim : 1.0;
  gl_FragColor = vec4((paint * lit + shine) * a, a);
}`;

/** A 4 x 4 matrix, column by column, from where the axes x, y, z of a shape point (with their lengths) and its origin. */
export function placed(origin, [x, y, z]) {
  return [...x, 0, ...y, 0, ...z, 0, ...origin, 1];
}

/** Numbers from 0 to 1 of a colour #rrggbb. */
export function rgb(colour) {
  return [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16) / 255);
}

/** Looks at a point from a distance; angles in rad. */
export class Camera {
  constructor(at, distance, azimuth, elevation) {
    Object.assign(this, { at, distance, azimuth, elevation, width: 1, height: 1 });
  }

  turn(right, up) {
    this.azimuth -= right;
    this.elevation = Math.max(-1.5, Math.min(1.5, this.elevation + up));
  }

  zoom(factor) {
    this.distance = Math.max(0.15, Math.min(1.2, this.distance * factor));
  }

  /** Unit vectors to the right, up and towards the eye. */
  get axes() {
    const [c, s] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    const towards = [c * Math.cos(this.azimuth), c * Math.sin(this.azimuth), s];
    const right = [-Math.sin(this.azimuth), Math.cos(this.azimuth), 0];
    return [right, cross(towards, right), towards];
  }

  get eye() {
    return add(this.at, scaled(this.axes[2], this.distance));
  }

  /** Pixels of the page for a metre at a point. */
  pixels(point) {
    const depth = dot(subtract(this.eye, point), this.axes[2]);
    return Math.min(this.width, this.height) / (2 * Math.tan(FIELD_OF_VIEW / 2) * depth);
  }

  /** Where a point is on the page: [x, y] from the canvas's upper left corner. */
  project(point) {
    const [right, up] = this.axes;
    const [off, size] = [subtract(point, this.at), this.pixels(point)];
    return [this.width / 2 + size * dot(off, right), this.height / 2 - size * dot(off, up)];
  }

  /** The matrix that WebGL projects with. */
  get matrix() {
    const [right, up, towards] = this.axes;
    const eye = this.eye;
    const f = 1 / Math.tan(FIELD_OF_VIEW / 2);
    const side = Math.min(this.width, this.height);
    const [fx, fy] = [(f * side) / this.width, (f * side) / this.height];
    const [a, b] = [(FAR_M + NEAR_M) / (FAR_M - NEAR_M), (2 * FAR_M * NEAR_M) / (FAR_M - NEAR_M)];
    const depth = dot(towards, eye);
    const columns = [0, 1, 2].map((i) => [fx * right[i], fy * up[i], -a * towards[i], -towards[i]]);
    return [...columns.flat(), -fx * dot(right, eye), -fy * dot(up, eye), a * depth - b, depth];
  }
}

/** The canvas. Items to draw are {mesh, matrix, colour: [r, g, b], alpha}; a mesh may have colours of its own. */
export class View {
  constructor(canvas) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl", { antialias: true, alpha: true, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser shows no WebGL, which the picture needs; the numbers beside it are there");
    this.gl = gl;
    this.buffers = new Map();
    this.program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(this.program, shader);
    }
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(this.program));
    gl.useProgram(this.program);
    const uniforms = ["model", "camera", "turn", "base", "own", "eye", "light", "alpha"];
    this.at = Object.fromEntries(uniforms.map((name) => [name, gl.getUniformLocation(this.program, name)]));
    this.attributes = ["position", "normal", "colour"].map((name) => gl.getAttribLocation(this.program, name));
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Draw solid items, then what one sees through, then what is in front of everything. */
  draw(camera, { solid, clear, front }) {
    const { gl, canvas } = this;
    const fine = Math.min(window.devicePixelRatio || 1, FINEST);
    [camera.width, camera.height] = [canvas.clientWidth, canvas.clientHeight];
    const size = [camera.width, camera.height].map((x) => Math.max(1, Math.round(fine * x)));
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    gl.viewport(0, 0, ...size);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.uniformMatrix4fv(this.at.camera, false, camera.matrix);
    gl.uniform3fv(this.at.eye, camera.eye);
    gl.uniform3fv(this.at.light, LIGHT);
    gl.disable(gl.BLEND);
    gl.disable(gl.CULL_FACE);
    for (const item of solid) this.item(item);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    gl.enable(gl.CULL_FACE);
    for (const face of [gl.FRONT, gl.BACK]) {
      gl.cullFace(face);
      for (const item of clear) this.item(item);
    }
    gl.depthMask(true);
    gl.disable(gl.CULL_FACE);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    for (const item of front) this.item(item);
    this.forget(new Set([...solid, ...clear, ...front].map((item) => item.mesh)));
  }

  item({ mesh, matrix, colour, alpha = 1 }) {
    const { gl } = this;
    if (!this.buffers.has(mesh)) this.buffers.set(mesh, this.upload(mesh));
    const { arrays, indices, n } = this.buffers.get(mesh);
    this.attributes.forEach((attribute, i) => {
      if (!arrays[i]) {
        gl.disableVertexAttribArray(attribute);
        gl.vertexAttrib3f(attribute, 1, 1, 1);
        return;
      }
      gl.bindBuffer(gl.ARRAY_BUFFER, arrays[i]);
      gl.enableVertexAttribArray(attribute);
      gl.vertexAttribPointer(attribute, 3, gl.FLOAT, false, 0, 0);
    });
    const linear = [0, 1, 2].flatMap((row) => [0, 1, 2].map((column) => matrix[4 * column + row]));
    gl.uniformMatrix3fv(this.at.turn, false, inverse(linear)); // row by row, which WebGL reads as the transposed
    gl.uniformMatrix4fv(this.at.model, false, matrix);
    gl.uniform3fv(this.at.base, colour ?? [1, 1, 1]);
    gl.uniform1f(this.at.own, mesh.colours ? 1 : 0);
    gl.uniform1f(this.at.alpha, alpha);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, indices);
    gl.drawElements(gl.TRIANGLES, n, gl.UNSIGNED_SHORT, 0);
  }

  upload(mesh) {
    const { gl } = this;
    const store = (kind, array) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(kind, buffer);
      gl.bufferData(kind, array, gl.STATIC_DRAW);
      return buffer;
    };
    const arrays = [mesh.positions, mesh.normals, mesh.colours];
    return {
      arrays: arrays.map((array) => array && store(gl.ARRAY_BUFFER, new Float32Array(array))),
      indices: store(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(mesh.indices)),
      n: mesh.indices.length,
    };
  }

  /** Give back the memory of meshes that are no longer drawn. */
  forget(used) {
    for (const [mesh, { arrays, indices }] of this.buffers) {
      if (used.has(mesh)) continue;
      for (const buffer of [...arrays, indices]) if (buffer) this.gl.deleteBuffer(buffer);
      this.buffers.delete(mesh);
    }
  }
}
