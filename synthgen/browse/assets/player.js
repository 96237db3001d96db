// Plays a subject's shots in order as a clip, under one environment or all of them at once.

import { askJson, path, query } from "./api.js";
import { button, h, segments, slider } from "./dom.js";

export class Player {
  /** @param address the page's `Address`, showing a view `play` whose id is a subject */
  constructor(element, address, fail) {
    this.element = element;
    this.address = address;
    this.at = 0;
    this.playing = false;
    this.start().catch(fail);
  }

  async start() {
    const { subset, id, options } = this.address.view;
    const subject = await askJson(path("api", "subject", subset, id));
    this.subset = subset;
    this.shots = subject.shots;
    if (!this.shots.length) throw new Error(`${subset}/${id} has no shots.`);
    this.environments = subject.environments.map((id) => ({ id }));
    this.wall = options.wall === "1";
    this.environment = Math.min(Number(options.environment) || 0, this.environments.length - 1);
    this.build(id);
    this.screens();
    this.ready = this.load();
    await this.ready;
    this.seek(Math.min(Number(options.at) || 0, this.shots.length - 1));
    if (options.paused !== "1" && !this.closed) this.play(true);
  }

  build(id) {
    this.screen = h("div", { class: "screens" });
    this.progress = h("p", { class: "hint", role: "status" });
    this.problem = h("p", { class: "problem", role: "alert", hidden: true });
    this.toggle = button("Pause", () => this.play(!this.playing), { class: "primary" });
    this.scrub = slider("Frame", {
      min: 0,
      max: this.shots.length - 1,
      step: 1,
      value: 0,
      write: (i) => `${i + 1} / ${this.shots.length}`,
      oninput: (i) => {
        this.play(false);
        this.seek(i);
      },
    });
    this.rate = slider("Frames per second", {
      min: 1,
      max: 30,
      step: 1,
      value: 8,
      write: (v) => String(v),
      oninput: () => {},
    });
    const light = h(
      "select",
      {
        "aria-label": "Environment",
        onchange: (event) => this.set({ environment: Number(event.target.value) }),
      },
      ...this.environments.map((use, i) => h("option", { value: String(i), text: use.id })),
    );
    light.value = String(this.environment);
    const layout = segments(
      "Screens",
      [
        [false, "One light"],
        [true, "All lights"],
      ],
      this.wall,
      (wall) => this.set({ wall }),
    );
    const open = button("Open this frame", () => {
      this.address.show("shot", this.subset, this.shots[this.at]);
    });
    this.element.replaceChildren(
      h(
        "header",
        { class: "viewbar" },
        button("‹ Grid", () => this.address.close(), { label: "Back to the grid" }),
        h("h1", { text: `${this.subset}/${id}` }),
        h("span", { class: "spring" }),
        open,
      ),
      h(
        "div",
        { class: "player" },
        this.problem,
        this.screen,
        this.progress,
        h(
          "div",
          { class: "controls row" },
          this.toggle,
          this.scrub.element,
          this.rate.element,
          layout,
          light,
        ),
      ),
    );
  }

  set(changes) {
    Object.assign(this, changes);
    this.address.setOptions({ environment: String(this.environment), wall: this.wall ? "1" : "0" });
    this.screens();
    this.load().then(() => this.seek(this.at));
  }

  /** Makes one screen per environment shown. */
  screens() {
    this.shown = this.wall ? this.environments.map((_, e) => e) : [this.environment];
    this.screen.style.setProperty("--count", String(this.shown.length));
    this.screen.replaceChildren(
      ...this.shown.map((e) =>
        h("figure", {}, h("img", { alt: "" }), h("figcaption", { text: this.environments[e].id })),
      ),
    );
  }

  /** Loads all frames of the screens shown, so that the clip does not stutter. */
  async load() {
    const { shown } = this;
    this.frames ??= new Map();
    const wanted = this.shots
      .flatMap((_, i) => shown.map((e) => [i, e]))
      .filter(([i, e]) => !this.frames.has(`${i} ${e}`));
    this.element.dataset.loaded = "no";
    let left = wanted.length;
    await Promise.all(
      wanted.map(async ([i, e]) => {
        const image = h("img", { alt: `Frame ${i + 1} under ${this.environments[e].id}` });
        image.src = path("pass", this.subset, this.shots[i], "image") + query({ environment: e });
        this.frames.set(`${i} ${e}`, image);
        try {
          await image.decode();
        } catch {
          this.frames.set(`${i} ${e}`, null);
          this.problem.textContent = `${this.shots[i]} could not be read and is skipped.`;
          this.problem.hidden = false;
        }
        left -= 1;
        this.progress.textContent = left ? `Loading ${left} more frames` : "";
      }),
    );
    this.element.dataset.loaded = "yes";
  }

  seek(i) {
    this.at = i;
    this.scrub.set(i);
    this.element.dataset.frame = String(i);
    this.shown.forEach((e, n) => {
      const frame = this.frames.get(`${i} ${e}`);
      // Reuse the decoded element: another with the same address would be fetched again.
      if (frame) this.screen.children[n].firstChild.replaceWith(frame);
    });
  }

  play(on) {
    this.playing = on;
    this.toggle.textContent = on ? "Pause" : "Play";
    clearTimeout(this.timer);
    if (on) this.tick();
  }

  tick() {
    this.timer = setTimeout(() => {
      this.seek((this.at + 1) % this.shots.length);
      this.tick();
    }, 1000 / Number(this.rate.input.value));
  }

  key(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (event.key === " ") this.play(!this.playing);
    else if (step) {
      this.play(false);
      this.seek((this.at + step + this.shots.length) % this.shots.length);
    } else return false;
    return true;
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
    this.playing = false;
  }
}
