// Overlays on a shot's picture: its landmarks, and the mesh of its skin as a wireframe.

import { ask, path } from "./api.js";
import { readGlb } from "./glb.js";
import { readNpz } from "./npz.js";

// iBUG's 68: first and last point of each line, and whether it is closed.
const LINES = [
  [0, 16, false],
  [17, 21, false],
  [22, 26, false],
  [27, 30, false],
  [31, 35, false],
  [36, 41, true],
  [42, 47, true],
  [48, 59, true],
  [60, 67, true],
];

const LARGEST = 4096; // pixels of a side

export class Overlay {
  /** @param shot the server's description of a shot */
  constructor(shot) {
    this.shot = shot;
    this.landmarks = false;
    this.mesh = false;
  }

  /** The posed skin, fetched once: {points (N, 3), indices}. Throws if there is none. */
  async skin() {
    const { subset, key, subject } = this.shot;
    this.loaded ??= Promise.all([
      ask(path("member", subset, key, "geometry.npz")).then((answer) => answer.arrayBuffer()),
      ask(path("subject", subset, `${subject}.glb`)).then((answer) => answer.arrayBuffer()),
    ]).then(async ([npz, glb]) => {
      const { control_points: points } = await readNpz(npz, ["control_points"]);
      // Control points are the vertices of the glTF's skin, in its order.
      const skin = readGlb(glb).find((mesh) => mesh.positions.length === points?.data.length);
      if (!skin) throw new Error("The subject's mesh and this shot have different vertices.");
      return { points: points.data, indices: skin.indices };
    });
    return this.loaded;
  }

  /** Draws into a canvas over the picture, at the resolution of the screen. */
  async draw(canvas) {
    const box = canvas.getBoundingClientRect();
    // Sharp where it is magnified, too, up to what a canvas may hold.
    const density = Math.min(
      devicePixelRatio || 1,
      2,
      LARGEST / Math.max(1, box.width, box.height),
    );
    canvas.width = Math.max(1, Math.round(box.width * density));
    canvas.height = Math.max(1, Math.round(box.height * density));
    const { width, height } = this.shot.meta.camera;
    const context = canvas.getContext("2d");
    context.scale(canvas.width / width, canvas.height / height);
    const line = (width / canvas.width) * density; // one CSS pixel
    if (this.mesh) this.wires(context, await this.skin(), line);
    if (this.landmarks) this.marks(context, line);
  }

  marks(context, line) {
    const { points, visible } = this.shot.meta.landmarks;
    context.lineWidth = line;
    context.strokeStyle = "rgba(255, 255, 255, 0.45)";
    for (const [first, last, closed] of LINES) {
      context.beginPath();
      for (let i = first; i <= last; i++) context.lineTo(...points[i]);
      if (closed) context.closePath();
      context.stroke();
    }
    points.forEach(([x, y], i) => {
      context.beginPath();
      context.arc(x, y, 2.6 * line, 0, 2 * Math.PI);
      context.fillStyle = visible[i] ? "#5ff0a0" : "#ff7a59";
      context.fill();
      context.lineWidth = 0.8 * line;
      context.strokeStyle = "rgba(0, 0, 0, 0.7)";
      context.stroke();
    });
  }

  wires(context, { points, indices }, line) {
    const {
      camera_to_world: axes,
      intrinsics: [[fx, , cx], [, fy, cy]],
    } = this.shot.meta.camera;
    const flat = new Float32Array((points.length / 3) * 2);
    for (let i = 0; 3 * i < points.length; i++) {
      const d = [0, 1, 2].map((k) => points[3 * i + k] - axes[k][3]);
      const [x, y, z] = [0, 1, 2].map(
        (j) => d[0] * axes[0][j] + d[1] * axes[1][j] + d[2] * axes[2][j],
      );
      flat[2 * i] = cx - (fx * x) / z;
      flat[2 * i + 1] = cy + (fy * y) / z;
    }
    context.beginPath();
    for (let i = 0; i < indices.length; i += 3) {
      const [a, b, c] = [indices[i], indices[i + 1], indices[i + 2]].map((v) => 2 * v);
      const area =
        (flat[b] - flat[a]) * (flat[c + 1] - flat[a + 1]) -
        (flat[c] - flat[a]) * (flat[b + 1] - flat[a + 1]);
      if (area > 0) continue; // faces away; y runs down
      context.moveTo(flat[a], flat[a + 1]);
      context.lineTo(flat[b], flat[b + 1]);
      context.lineTo(flat[c], flat[c + 1]);
    }
    context.lineWidth = 0.5 * line;
    context.strokeStyle = "rgba(120, 215, 255, 0.45)";
    context.stroke();
  }
}
