// The passes of a shot as pictures, environments side by side, with values under the pointer.

import { askArray, path, query } from "./api.js";
import { h } from "./dom.js";
import { Zoom } from "./zoom.js";

export class PassView {
  /**
   * @param shot the server's description of a shot
   * @param dataset its description of the dataset: `part_names` [{id, name, colour}], with colours
   *   [r, g, b] in bytes; `passes` [{name, axes, unit, lit}], lit: differs by environment
   * @param overlay the shot's `Overlay`  @param picked called with an environment's index
   */
  constructor(shot, dataset, overlay, picked) {
    this.shot = shot;
    this.parts = new Map(dataset.part_names.map((part) => [part.id, part]));
    this.passes = new Map(dataset.passes.map((pass) => [pass.name, pass]));
    this.dataset = dataset;
    this.overlay = overlay;
    this.picked = picked;
    this.values = new Map();
    this.figures = h("div", { class: "figures" });
    this.readout = h("dl", { class: "readout", "aria-label": "Values under the pointer" });
    this.legend = h("ul", { class: "legend", hidden: true, "aria-label": "Parts" });
    this.element = h("div", { class: "passes" }, this.figures, this.legend, this.readout);
    this.zoom = new Zoom(this.figures, () => {
      clearTimeout(this.still);
      this.still = setTimeout(() => this.redraw(), 120);
    });
    this.resizing = new ResizeObserver(() => this.redraw());
    this.resizing.observe(this.figures);
    this.idle();
  }

  /** The address of a pass as a picture. */
  picture(pass, environment = 0) {
    const { subset, key } = this.shot;
    return path("pass", subset, key, pass) + query({ environment });
  }

  /** Shows a pass; with `beside`, the image under all environments side by side. */
  show(pass, environment, beside) {
    this.pass = pass;
    const { environments } = this.shot;
    if (pass === "run") return this.run(environment);
    const many = beside && pass === "image" && environments.length > 1;
    const shown = many ? environments.map((_, e) => e) : [environment];
    this.figures.replaceChildren(...shown.map((e) => this.figure(pass, e, many)));
    this.figures.style.setProperty("--count", String(shown.length));
    this.legend.hidden = pass !== "parts";
    if (pass === "parts") this.showLegend();
    this.mark(environment);
    this.redraw();
  }

  /** Shows what a trained run makes of the shot, beside the truth. */
  run(environment) {
    const pictures = this.dataset.run;
    const figures = pictures.map((name) => {
      const figure = this.figure(`run_${name}`, environment, false);
      const words = name === "difference" ? "difference ×4" : name;
      figure.append(h("figcaption", {}, h("b", { text: words })));
      return figure;
    });
    this.figures.replaceChildren(...figures);
    this.figures.style.setProperty("--count", String(pictures.length));
    this.legend.hidden = true;
  }

  figure(pass, e, many) {
    const { environments } = this.shot;
    const use = environments[e];
    const image = h("img", {
      alt: pass === "image" ? `Picture under ${use?.id}` : `${pass} of ${this.shot.key}`,
      draggable: "false",
    });
    const figure = h(
      "figure",
      {},
      h(
        "div",
        {
          class: "plate",
          onpointermove: (event) => this.read(event, image, e),
          onpointerdown: (event) => this.read(event, image, e),
          onpointerleave: () => this.idle(),
        },
        h(
          "div",
          { class: "magnified" },
          image,
          h("canvas", { class: "overlay", "aria-hidden": "true" }),
        ),
      ),
      pass === "image" ? this.caption(use, e, many) : null,
    );
    figure.dataset.environment = String(e);
    image.addEventListener("load", () => this.redraw());
    image.addEventListener("error", () => {
      image.replaceWith(h("p", { class: "problem", text: `The ${pass} could not be read.` }));
    });
    image.src = this.picture(pass, e);
    return figure;
  }

  caption(use, e, many) {
    const words = [h("b", { text: use?.id ?? `environment ${e}` })];
    if (Number.isFinite(use?.rotation)) {
      words.push(
        h("span", { class: "number", text: `${Math.round((use.rotation * 180) / Math.PI)}°` }),
      );
    }
    if (Number.isFinite(use?.exposure)) {
      const sign = use.exposure >= 0 ? "+" : "−";
      words.push(
        h("span", { class: "number", text: `${sign}${Math.abs(use.exposure).toFixed(2)} stops` }),
      );
    }
    if (!many) return h("figcaption", {}, ...words);
    const pick = h(
      "button",
      {
        type: "button",
        class: "pick",
        "aria-label": `Use ${use?.id} for the light panel and for play`,
        onclick: () => this.picked(e),
      },
      ...words,
    );
    return h("figcaption", {}, pick);
  }

  mark(environment) {
    for (const figure of this.figures.children) {
      figure.classList.toggle("current", figure.dataset.environment === String(environment));
    }
  }

  /** Redraws the overlays; a failure is shown in the readout. */
  async redraw() {
    try {
      for (const canvas of this.figures.querySelectorAll("canvas.overlay")) {
        await this.overlay.draw(canvas);
      }
    } catch (error) {
      this.readout.replaceChildren(h("dt", { class: "problem", text: error.message }));
    }
  }

  showLegend() {
    if (this.legend.childElementCount) return;
    this.legend.append(
      ...[...this.parts.values()].map(({ id, name, colour }) => {
        const key = h("span", { class: "swatch", "aria-hidden": "true" });
        key.style.background = `rgb(${colour.join(" ")})`;
        return h(
          "li",
          {},
          key,
          h("span", { class: "number", text: String(id) }),
          h("span", { text: name }),
        );
      }),
    );
  }

  idle() {
    this.readout.replaceChildren(
      h("dt", { class: "hint", text: "Point at a picture to read its values." }),
    );
  }

  /** The array of a pass, fetched on first use. */
  array(pass, environment) {
    const name = this.passes.get(pass).lit ? `${pass} ${environment}` : pass;
    if (!this.values.has(name)) {
      const { subset, key } = this.shot;
      const address = path("values", subset, key, pass) + query({ environment });
      const waiting = { array: null };
      this.values.set(name, waiting);
      askArray(address).then(
        (array) => {
          waiting.array = array;
          this.again?.();
        },
        (error) => {
          waiting.error = error.message;
          this.again?.();
        },
      );
    }
    return this.values.get(name);
  }

  read(event, image, environment) {
    if (this.pass === "run") return; // of another size, and not stored
    const box = image.getBoundingClientRect();
    const { width, height } = this.shot.meta.camera;
    const x = Math.floor(((event.clientX - box.left) / box.width) * width);
    const y = Math.floor(((event.clientY - box.top) / box.height) * height);
    if (x < 0 || y < 0 || x >= width || y >= height) return this.idle();
    const lit = [...this.passes.values()].filter((pass) => pass.lit).map((pass) => pass.name);
    const shown = this.pass === "image" ? lit : [this.pass];
    const passes = [...new Set([...shown, "parts", "depth", "alpha"])].filter((pass) =>
      this.shot.values.includes(pass),
    );
    this.again = () => this.write(x, y, passes, environment);
    this.again();
  }

  write(x, y, passes, environment) {
    const lines = [h("dt", { text: "pixel" }), h("dd", { class: "number", text: `${x}, ${y}` })];
    for (const pass of passes) {
      const { array, error } = this.array(pass, environment);
      const text = error ?? (array ? this.value(pass, array, x, y) : "…");
      lines.push(h("dt", { text: pass }), h("dd", { class: "number", text }));
    }
    this.readout.replaceChildren(...lines);
  }

  value(pass, { data, shape, type }, x, y) {
    const [, width, channels = 1] = shape;
    const at = (y * width + x) * channels;
    const values = [...data.slice(at, at + channels)];
    if (pass === "parts") {
      return `${values[0]} ${this.parts.get(values[0])?.name ?? ""}`;
    }
    const digits = type === "uint8" ? 0 : 4;
    const written = values.map((value) => value.toFixed(digits));
    const { axes, unit } = this.passes.get(pass);
    const text = written.map((v, i) => (axes[i] ? `${axes[i]} ${v}` : v)).join("  ");
    return unit ? `${text} ${unit}` : text;
  }

  close() {
    this.resizing.disconnect();
    clearTimeout(this.still);
    this.again = null;
  }
}
