// A small 3D view in WebGL2: coloured meshes and lines, seen by a camera that orbits a point.

import { link } from "./shading.js";

const VERTEX = `#version 300 es
uniform mat4 camera;
in vec3 position;
in vec3 normal;
in vec4 colour;
out vec3 facing;
out vec4 shade;
void main() {
  gl_Position = camera * vec4(position, 1.0);
  facing = normal;
  shade = colour;
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform bool lit;
uniform vec3 key;
in vec3 facing;
in vec4 shade;
out vec4 result;
void main() {
  vec3 n = facing / max(length(facing), 1e-6);
  if (!gl_FrontFacing) n = -n;
  float light = lit ? 0.38 + 0.62 * max(0.0, dot(n, key)) + 0.12 * n.z : 1.0;
  result = vec4(shade.rgb * light, 1.0);
}`;

export class Scene {
  /** Throws an error of one line where WebGL2 is not available. */
  constructor(
    canvas,
    gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true }),
  ) {
    if (!gl) throw new Error("The 3D view needs WebGL2, which this browser does not offer.");
    this.canvas = canvas;
    this.gl = gl;
    this.program = link(gl, VERTEX, FRAGMENT);
    this.place = (name) => gl.getUniformLocation(this.program, name);
    this.things = [];
    this.target = [0, 0, 0];
    Object.assign(this, { yaw: 0.9, pitch: 0.25, distance: 1 });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.held = true;
    });
    canvas.addEventListener("pointerup", () => {
      this.held = false;
    });
    canvas.addEventListener("pointermove", (event) => {
      if (this.held) this.orbit(-event.movementX * 0.008, event.movementY * 0.008);
    });
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoom(Math.exp(event.deltaY * 0.001));
      },
      { passive: false },
    );
    canvas.addEventListener("keydown", (event) => this.key(event));
    this.resizing = new ResizeObserver(() => this.draw());
    this.resizing.observe(canvas);
  }

  orbit(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.max(-1.5, Math.min(1.5, this.pitch + pitch));
    this.draw();
  }

  zoom(factor) {
    this.distance = Math.max(0.15, Math.min(20, this.distance * factor));
    this.draw();
  }

  key(event) {
    const turns = {
      ArrowLeft: [-0.1, 0],
      ArrowRight: [0.1, 0],
      ArrowUp: [0, 0.1],
      ArrowDown: [0, -0.1],
    };
    if (event.key in turns) this.orbit(...turns[event.key]);
    else if (event.key === "+" || event.key === "=") this.zoom(0.9);
    else if (event.key === "-") this.zoom(1.1);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  /** Adds triangles: positions (3N), colours (4N bytes), indices; returns what `move` takes. */
  mesh({ positions, colours, indices }) {
    return this.add(this.gl.TRIANGLES, positions, colours, indices, normals(positions, indices));
  }

  /** Adds line segments: positions (3N), two per segment, and one colour [r, g, b] in bytes. */
  lines(positions, colour) {
    const count = positions.length / 3;
    const colours = new Uint8Array(4 * count);
    for (let i = 0; i < count; i++) colours.set([...colour, 255], 4 * i);
    const indices = Uint32Array.from({ length: count }, (_, i) => i);
    return this.add(this.gl.LINES, positions, colours, indices, new Float32Array(3 * count));
  }

  add(mode, positions, colours, indices, facing) {
    const { gl } = this;
    const thing = {
      mode,
      count: indices.length,
      indices,
      array: gl.createVertexArray(),
      visible: true,
    };
    gl.bindVertexArray(thing.array);
    const attribute = (name, data, size, type, scaled) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
      const at = gl.getAttribLocation(this.program, name);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, type, scaled, 0, 0);
      return buffer;
    };
    thing.positions = attribute("position", positions, 3, gl.FLOAT, false);
    thing.normals = attribute("normal", facing, 3, gl.FLOAT, false);
    attribute("colour", colours, 4, gl.UNSIGNED_BYTE, true);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    this.things.push(thing);
    return thing;
  }

  /** Moves a mesh to new positions (3N). */
  move(thing, positions) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, thing.positions);
    gl.bufferData(gl.ARRAY_BUFFER, positions, gl.DYNAMIC_DRAW);
    gl.bindBuffer(gl.ARRAY_BUFFER, thing.normals);
    gl.bufferData(gl.ARRAY_BUFFER, normals(positions, thing.indices), gl.DYNAMIC_DRAW);
  }

  draw() {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.drawNow());
  }

  drawNow() {
    const { gl, canvas } = this;
    const density = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth * density, canvas.clientHeight * density].map(
      Math.round,
    );
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height)
      Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.useProgram(this.program);
    const { matrix, right, back } = this.view(width / height);
    gl.uniformMatrix4fv(this.place("camera"), false, matrix);
    // The key light is to the left of the viewer, and above.
    const key = [0, 1, 2].map((i) => back[i] * 0.8 - right[i] * 0.45);
    key[2] += 0.4;
    gl.uniform3f(this.place("key"), ...unit(key));
    for (const thing of this.things.filter(({ visible }) => visible)) {
      gl.uniform1i(this.place("lit"), Number(thing.mode === gl.TRIANGLES));
      gl.bindVertexArray(thing.array);
      gl.drawElements(thing.mode, thing.count, gl.UNSIGNED_INT, 0);
    }
    gl.bindVertexArray(null);
  }

  /** Projection times view, column-major; at yaw 0 the camera looks at the face from -Y. */
  view(aspect) {
    const back = [
      Math.sin(this.yaw) * Math.cos(this.pitch),
      -Math.cos(this.yaw) * Math.cos(this.pitch),
      Math.sin(this.pitch),
    ];
    const right = unit(cross([0, 0, 1], back));
    const up = cross(back, right);
    const eye = this.target.map((t, i) => t + this.distance * back[i]);
    const [near, far] = [this.distance * 0.05, this.distance * 20];
    const f = 1 / Math.tan(0.5 * 0.6) / Math.max(1, 1 / aspect);
    const rows = [right, up, back].map((axis) => [...axis, -dot(axis, eye)]);
    const z = rows[2].map(
      (v, i) => ((far + near) / (near - far)) * v + (i === 3 ? (2 * far * near) / (near - far) : 0),
    );
    const clip = [
      rows[0].map((v) => (v * f) / aspect),
      rows[1].map((v) => v * f),
      z,
      rows[2].map((v) => -v),
    ];
    return {
      matrix: [0, 1, 2, 3].flatMap((column) => clip.map((row) => row[column])),
      right,
      back,
    };
  }

  close() {
    this.resizing.disconnect();
    cancelAnimationFrame(this.frame);
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const unit = (a) => a.map((v) => v / Math.max(1e-12, Math.hypot(...a)));
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/** Vertex normals (3N), not of unit length: sums of the triangles' area vectors. */
function normals(p, indices) {
  const result = new Float32Array(p.length);
  for (let i = 0; i < indices.length; i += 3) {
    const [a, b, c] = [3 * indices[i], 3 * indices[i + 1], 3 * indices[i + 2]];
    const [ux, uy, uz] = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
    const [vx, vy, vz] = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
    const n = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (const at of [a, b, c]) for (let k = 0; k < 3; k++) result[at + k] += n[k];
  }
  return result;
}
