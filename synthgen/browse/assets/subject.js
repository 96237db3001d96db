// A subject in 3D: its canonical mesh, its shots' cameras, and its expressions as sliders.

import { ask, askArray, askJson, path } from "./api.js";
import { button, h, slider } from "./dom.js";
import { readGlb } from "./glb.js";
import { Scene } from "./scene.js";

const FRUSTUM = 0.18; // length as drawn, metres
const CLEAR = /^(cornea|tear)_|lens/; // transparent surfaces would hide what is behind them

export class SubjectView {
  /** @param address the page's `Address`, showing a view `subject` */
  constructor(element, address, fail) {
    this.element = element;
    this.address = address;
    this.weights = new Map();
    this.start().catch(fail);
  }

  async start() {
    const { subset, id } = this.address.view;
    this.canvas = h("canvas", {
      class: "scene",
      tabindex: "0",
      role: "img",
      "aria-label":
        "The subject's mesh and cameras; drag or use the arrow keys to turn, + and − to zoom",
    });
    this.problem = h("p", { class: "problem", role: "alert", hidden: true });
    this.shots = h("ul", { class: "keys" });
    this.sliders = h("div", { class: "sliders" });
    this.element.replaceChildren(
      h(
        "header",
        { class: "viewbar" },
        button("‹ Grid", () => this.address.close(), { label: "Back to the grid" }),
        h("h1", { text: `${subset}/${id}` }),
        h("span", { class: "spring" }),
        button("Play", () => this.address.show("play", subset, id)),
      ),
      h(
        "div",
        { class: "columns" },
        h(
          "div",
          { class: "main" },
          this.problem,
          this.canvas,
          h(
            "div",
            { class: "row" },
            button("With cameras", () => this.fit(this.everything)),
            button("Bust only", () => this.fit(this.bust)),
            h("p", {
              class: "hint",
              text: "Drag to turn, scroll to zoom. Neck and head are at rest.",
            }),
          ),
        ),
        h(
          "div",
          { class: "side" },
          h("section", { class: "panel" }, h("h2", { text: "Shots" }), this.shots),
          h("section", { class: "panel" }, h("h2", { text: "Expression" }), this.sliders),
        ),
      ),
    );
    const subject = await askJson(path("api", "subject", subset, id));
    this.list(subset, subject);
    await this.show(subset, id, subject).catch((error) => this.fail(error));
    await this.expressions(subset, id, subject);
  }

  list(subset, { shots, cameras, broken }) {
    const places = new Map(cameras.map(({ key }, i) => [key, i]));
    const reasons = new Map(broken.map(({ key, reason }) => [key, reason]));
    this.shots.append(
      ...shots.map((shot) => {
        const place = places.get(shot) ?? -1;
        return h(
          "li",
          {},
          h("a", {
            href: this.address.href("shot", subset, shot),
            text: shot.split("_").pop(),
            class: reasons.has(shot) ? "broken" : null,
            title: reasons.has(shot) ? `${shot}, broken: ${reasons.get(shot)}` : shot,
            "aria-label": `Shot ${shot}`,
            onclick: (event) => {
              if (event.ctrlKey || event.metaKey) return;
              event.preventDefault();
              this.address.show("shot", subset, shot);
            },
            onmouseenter: () => this.mark(place),
            onfocus: () => this.mark(place),
            onmouseleave: () => this.mark(-1),
            onblur: () => this.mark(-1),
          }),
        );
      }),
    );
  }

  async show(subset, id, { cameras }) {
    const answer = await ask(path("subject", subset, `${id}.glb`));
    const meshes = readGlb(await answer.arrayBuffer()).filter(({ name }) => !CLEAR.test(name));
    this.scene = new Scene(this.canvas);
    const eyes = cameras.map(({ camera_to_world: axes }) => [0, 1, 2].map((i) => axes[i][3]));
    this.bust = bounds(meshes.map(({ positions }) => positions));
    this.everything = bounds([...meshes.map(({ positions }) => positions), eyes.flat()]);
    this.fit(this.everything);
    this.meshes = meshes.map((mesh) => ({ ...mesh, thing: this.scene.mesh(mesh) }));
    this.frusta = cameras.map((camera) =>
      [
        [120, 130, 145],
        [47, 129, 247],
      ].map((colour) => {
        const thing = this.scene.lines(frustum(camera), colour);
        return thing;
      }),
    );
    this.mark(-1);
    this.canvas.dataset.cameras = String(cameras.length);
  }

  /** Fits a sphere {centre, radius} into the view. */
  fit({ centre, radius }) {
    if (!this.scene) return;
    this.scene.target = centre;
    this.scene.distance = 3 * radius;
    this.scene.draw();
  }

  /** Draws one camera in the accent colour. */
  mark(chosen) {
    this.frusta?.forEach(([plain, bright], i) => {
      plain.visible = i !== chosen;
      bright.visible = i === chosen;
    });
    this.scene?.draw();
  }

  /** Sliders of the expressions. */
  async expressions(subset, id, { expression_names: names }) {
    let deltas;
    try {
      // (names, vertices of the skin, 3) metres in world axes.
      deltas = await askArray(path("subject", subset, id, "expressions"));
    } catch (error) {
      this.sliders.replaceChildren(h("p", { class: "hint", text: error.message }));
      return;
    }
    const skin = this.meshes?.find(({ positions }) => positions.length === deltas.shape[1] * 3);
    if (!skin) {
      this.sliders.replaceChildren(
        h("p", { class: "hint", text: "The expressions belong to a different mesh." }),
      );
      return;
    }
    const parts = names.slice(0, deltas.shape[0]).map((name, i) =>
      slider(name, {
        min: 0,
        max: 1,
        step: 0.01,
        value: 0,
        write: (v) => v.toFixed(2),
        oninput: (value) => {
          this.weights.set(i, value);
          this.morph(skin, deltas);
        },
      }),
    );
    const neutral = button("Neutral", () => {
      this.weights.clear();
      for (const part of parts) part.set(0);
      this.morph(skin, deltas);
    });
    this.sliders.replaceChildren(neutral, ...parts.map((part) => part.element));
  }

  morph(skin, { data, shape }) {
    const size = shape[1] * 3;
    const positions = skin.positions.slice();
    for (const [i, weight] of this.weights) {
      if (weight) for (let k = 0; k < size; k++) positions[k] += weight * data[i * size + k];
    }
    this.scene.move(skin.thing, positions);
    this.scene.draw();
  }

  fail(error) {
    this.problem.textContent = error.message;
    this.problem.hidden = false;
    this.canvas.hidden = true;
  }

  close() {
    this.scene?.close();
  }
}

/** The sphere around the bounding box of points in arrays (3N). */
function bounds(arrays) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (const positions of arrays) {
    for (let i = 0; i < positions.length; i++) {
      low[i % 3] = Math.min(low[i % 3], positions[i]);
      high[i % 3] = Math.max(high[i % 3], positions[i]);
    }
  }
  return {
    centre: low.map((v, i) => (v + high[i]) / 2),
    radius: 0.5 * Math.hypot(...low.map((v, i) => high[i] - v)),
  };
}

/** Line segments of a camera: its centre, its image plane at `FRUSTUM` and a tick above it. */
function frustum({ camera_to_world: axes, intrinsics: [[fx, , cx], [, fy, cy]], width, height }) {
  const point = (x, y, z) =>
    [0, 1, 2].map((i) => axes[i][0] * x + axes[i][1] * y + axes[i][2] * z + axes[i][3]);
  const corner = (u, v) => point(((u - cx) / fx) * FRUSTUM, -((v - cy) / fy) * FRUSTUM, -FRUSTUM);
  const eye = point(0, 0, 0);
  const corners = [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)];
  const tick = corner(width / 2, -0.2 * height);
  const lines = corners.flatMap((c, i) => [eye, c, c, corners[(i + 1) % 4]]);
  lines.push(corners[0], tick, tick, corners[1]);
  return Float32Array.from(lines.flat());
}
