// The light panel: a canvas shaded live, with light to move, beside the rendered picture.

import { ask, askArray, path, query } from "./api.js";
import { button, h } from "./dom.js";
import { LightControls } from "./light_controls.js";
import { Shading } from "./shading.js";

export class LightPanel {
  /**
   * @param shot the server's description of a shot
   * @param pictures `pictures(e)` is the address of the rendered picture under environment e
   * @param dataset the server's description of the dataset
   * @param environment index of the shot's environment to start with
   */
  constructor(shot, pictures, dataset, environment) {
    Object.assign(this, { shot, dataset });
    this.pictures = pictures;
    this.sliders = new LightControls(() => this.draw());
    this.own = null;
    this.canvas = h("canvas", {
      class: "light",
      tabindex: "0",
      role: "img",
      "aria-label": "Shaded with the environment's light; drag or use the arrow keys to turn it",
      onpointerdown: (event) => this.grab(event),
      onpointermove: (event) => this.pull(event),
      onpointerup: () => {
        this.held = null;
      },
      onpointerleave: () => {
        this.reading.textContent = "";
      },
      onkeydown: (event) => this.key(event),
    });
    this.rendered = h("img", { alt: "As rendered" });
    this.waiting = h("p", { class: "waiting", text: "Baking the light…" });
    this.reading = h("output", { class: "reading number" });
    this.problem = h("p", { class: "problem", role: "alert", hidden: true });
    this.element = h(
      "section",
      {
        class: "panel lightpanel",
        "aria-label": "Light",
        ondragover: (event) => this.over(event),
        ondragleave: () => this.out(),
        ondrop: (event) => this.drop(event),
      },
      h("h2", { text: "Light" }),
      h(
        "div",
        { class: "pair" },
        h(
          "figure",
          {},
          this.canvas,
          this.waiting,
          h("figcaption", {}, h("span", { text: "Shaded live" }), this.reading),
        ),
        h("figure", {}, this.rendered, h("figcaption", { text: "As rendered" })),
      ),
      this.problem,
      this.controls(dataset.environments),
    );
    this.start(environment);
  }

  controls(catalogue) {
    const { environments } = this.shot;
    const mine = environments.map((use, i) => h("option", { value: `shot:${i}`, text: use.id }));
    const others = catalogue.filter(({ id }) => !environments.some((use) => use.id === id));
    this.select = h(
      "select",
      { "aria-label": "Environment", onchange: () => this.chosen() },
      h("optgroup", { label: "This shot" }, ...mine),
      others.length
        ? h(
            "optgroup",
            { label: "Others in this dataset" },
            ...others.map(({ id }) => h("option", { value: `other:${id}`, text: id })),
          )
        : null,
    );
    this.file = h("input", {
      type: "file",
      accept: ".exr,.hdr",
      class: "hidden",
      "aria-label": "Panorama file",
      onchange: () => this.file.files[0] && this.upload(this.file.files[0]),
    });
    const open = button("Open .exr or .hdr…", () => this.file.click());
    return h(
      "div",
      { class: "controls" },
      h("div", { class: "row" }, this.select, open, this.file, ...this.sliders.switches),
      ...this.sliders.elements,
    );
  }

  async start(environment) {
    const { subset, shot } = this.place();
    try {
      this.shading = new Shading(this.canvas);
      const [albedo, normal, alpha] = await Promise.all(
        ["albedo", "normal", "alpha"].map((pass) => askArray(path("values", subset, shot, pass))),
      );
      this.shading.setShot(albedo, normal, alpha, this.shot.meta.camera, this.dataset.format);
    } catch (error) {
      return this.fail(error);
    }
    await this.use(environment);
  }

  place() {
    const { subset, key } = this.shot;
    return { subset, shot: key };
  }

  /** Lights the shot with its environment e. */
  async use(e) {
    const use = this.shot.environments[e];
    this.select.value = `shot:${e}`;
    this.rendered.src = this.pictures(e);
    await this.load(use.id);
    this.sliders.setBase(use.rotation, use.factor);
  }

  async chosen() {
    const [kind, ...rest] = this.select.value.split(":");
    const name = rest.join(":");
    if (kind === "shot") return this.use(Number(name));
    if (kind === "other") await this.load(name);
    else this.light(this.own);
    this.draw();
  }

  async load(id) {
    try {
      this.light(await askArray(path("lightmaps", id) + query({ height: 32 })));
    } catch (error) {
      this.fail(error);
    }
  }

  light(maps) {
    this.maps = maps;
    this.shading?.setLightmaps(maps);
    this.problem.hidden = true;
  }

  async upload(file) {
    this.out();
    try {
      const response = await ask("/lightmaps", { method: "POST", body: file });
      const shape = response.headers.get("X-Shape").match(/\d+/g).map(Number);
      this.own = { data: new Float32Array(await response.arrayBuffer()), shape, type: "float32" };
      this.select.querySelector(".own")?.remove();
      this.select.append(h("option", { class: "own", value: "own:", text: file.name }));
      this.select.value = "own:";
      // The exposure of a foreign panorama is unknown: map its mean light to middle grey.
      const plane = this.own.data.subarray(0, this.own.data.length / 5);
      const mean = plane.reduce((sum, v) => sum + v, 0) / plane.length;
      this.light(this.own);
      this.sliders.setBase(0, mean > 0 ? 0.5 / mean : 1);
    } catch (error) {
      this.fail(error);
    }
  }

  draw() {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => {
      if (this.shading?.draw(this.sliders.settings)) {
        this.waiting.hidden = true;
        this.canvas.dataset.drawn = String(Number(this.canvas.dataset.drawn ?? 0) + 1);
      }
    });
  }

  grab(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.held = { x: event.clientX, turn: this.sliders.degrees };
  }

  pull(event) {
    const box = this.canvas.getBoundingClientRect();
    if (this.held) {
      // The background follows the pointer: the width of the canvas is half a turn.
      const turn = this.held.turn - ((event.clientX - this.held.x) / box.width) * 180;
      return this.sliders.turn(turn);
    }
    const x = Math.floor(((event.clientX - box.left) / box.width) * this.canvas.width);
    const y = Math.floor(((event.clientY - box.top) / box.height) * this.canvas.height);
    if (x < 0 || y < 0 || x >= this.canvas.width || y >= this.canvas.height) return;
    const found = this.shading?.read(x, y);
    this.reading.textContent = found ? `linear ${found.map((v) => v.toFixed(3)).join(" ")}` : "";
  }

  key(event) {
    const step = { ArrowLeft: 5, ArrowRight: -5 }[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    this.sliders.turn(this.sliders.degrees + step);
  }

  over(event) {
    event.preventDefault();
    this.element.classList.add("over");
  }

  out() {
    this.element.classList.remove("over");
  }

  drop(event) {
    event.preventDefault();
    this.out();
    if (event.dataTransfer.files[0]) this.upload(event.dataTransfer.files[0]);
  }

  fail(error) {
    this.waiting.hidden = true;
    this.problem.textContent = error.message;
    this.problem.hidden = false;
  }

  close() {
    this.shading?.close();
  }
}
