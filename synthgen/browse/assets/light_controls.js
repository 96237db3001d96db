// The sliders of the light: rotation, exposure, and the coefficients of Phong's model.

import { button, h, slider } from "./dom.js";
import { SHININESS } from "./shading.js";

// Plausible for skin; only a starting point.
const START = { diffuse: 1, specular: [0, 0.02, 0.01, 0] };
const DEGREE = Math.PI / 180;

export class LightControls {
  /** @param changed called when a setting has changed */
  constructor(changed) {
    this.changed = changed;
    this.rotation = 0;
    this.factor = 1;
    this.settings = { ...START, angle: 0, exposure: 1, filtered: true, backdrop: false };
    const labelled = (label, min, max, step, write, set) => {
      const oninput = (value) => {
        set(value);
        changed();
      };
      return slider(label, { min, max, step, value: 0, write, oninput });
    };
    const stops = (v) => `${v >= 0 ? "+" : "−"}${Math.abs(v).toFixed(1)} stops`;
    this.angle = labelled(
      "Rotation",
      -180,
      180,
      1,
      (v) => `${Math.round(v)}°`,
      (v) => this.rotate(v),
    );
    this.exposure = labelled("Exposure", -4, 4, 0.1, stops, (v) => this.expose(v));
    this.diffuse = labelled(
      "Diffuse k_d",
      0,
      2,
      0.01,
      (v) => v.toFixed(2),
      (v) => {
        this.settings.diffuse = v;
      },
    );
    this.specular = SHININESS.map((exponent, i) =>
      labelled(
        `Specular k_s ${exponent}`,
        0,
        0.5,
        0.005,
        (v) => v.toFixed(3),
        (v) => {
          this.settings.specular[i] = v;
        },
      ),
    );
    const sliders = [this.angle, this.exposure, this.diffuse, ...this.specular];
    this.elements = sliders.map(({ element }) => element);
    this.switches = [
      this.check(
        "Pixel filter",
        "filtered",
        "Averages neighbouring pixels, as the picture does and labels do not",
      ),
      this.check(
        "Blurred backdrop",
        "backdrop",
        "The environment as the sharpest lightmap blurs it",
      ),
      button("Reset", () => this.reset()),
    ];
    this.setDefaults();
  }

  check(text, name, title) {
    const onchange = (event) => {
      this.settings[name] = event.target.checked;
      this.changed();
    };
    const box = h("input", { type: "checkbox", checked: this.settings[name], onchange });
    return h("label", { class: "check", title }, box, h("span", { text }));
  }

  /** Makes a light's own rotation (radians) and exposure (linear factor) the sliders' zero. */
  setBase(rotation, factor) {
    this.rotation = rotation;
    this.factor = factor;
    this.reset();
  }

  reset() {
    this.setDefaults();
    this.changed();
  }

  setDefaults() {
    this.angle.set(0);
    this.rotate(0);
    this.exposure.set(0);
    this.expose(0);
    this.diffuse.set(START.diffuse);
    this.settings.diffuse = START.diffuse;
    for (const [i, dial] of this.specular.entries()) dial.set(START.specular[i]);
    this.settings.specular = [...START.specular];
  }

  rotate(degrees) {
    this.settings.angle = this.rotation + degrees * DEGREE;
  }

  expose(stops) {
    this.settings.exposure = this.factor * 2 ** stops;
  }

  /** Degrees by which the environment is turned from its own rotation. */
  get degrees() {
    return Number(this.angle.input.value);
  }

  /** Turns the environment to an angle in degrees, wrapped into [-180, 180). */
  turn(degrees) {
    this.angle.set(((((degrees + 180) % 360) + 360) % 360) - 180);
    this.rotate(this.degrees);
    this.changed();
  }
}
