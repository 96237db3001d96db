// One shot in full: its passes, light and metadata, and the way to its neighbours.

import { askJson, path } from "./api.js";
import { button, command, h, number, segments } from "./dom.js";
import { LightPanel } from "./light.js";
import { members, metadata } from "./metadata.js";
import { Overlay } from "./overlay.js";
import { PassView } from "./passes.js";
import { badges } from "./tags.js";

export class ShotView {
  /**
   * @param address the page's `Address`, showing a view `shot`
   * @param dataset the server's description of the dataset
   * @param neighbour `neighbour(index)` resolves to the row at an index of the selection, or null
   * @param tags the page's `Tags`
   */
  constructor(element, address, dataset, neighbour, tags, fail) {
    Object.assign(this, { element, address, dataset, neighbour, tags });
    this.closed = false;
    this.start().catch((error) => {
      if (!this.closed) fail(error);
    });
  }

  async start() {
    const { subset, id, options } = this.address.view;
    const shot = await askJson(path("api", "shot", subset, id));
    if (this.closed) return;
    this.shot = shot;
    this.at = options.at === undefined ? null : Number(options.at);
    this.head = this.header(subset, id, shot.subject);
    if (shot.broken) return this.broken(shot.broken);
    this.environment = Math.min(Number(options.environment) || 0, shot.environments.length - 1);
    this.labels = new Map(this.dataset.passes.map((p) => [p.name, p.label]));
    this.passes = shot.passes.filter((p) => this.labels.get(p));
    if (this.dataset.run.length) {
      this.labels.set("run", "Model");
      this.passes.push("run");
    }
    this.pass = this.passes.includes(options.pass) ? options.pass : "image";
    this.beside = options.one !== "1";
    this.overlay = new Overlay(shot);
    this.overlay.landmarks = options.landmarks === "1";
    this.overlay.mesh = options.mesh === "1";
    this.pictures = new PassView(shot, this.dataset, this.overlay, (e) => this.pick(e));
    this.light = new LightPanel(
      shot,
      (e) => this.pictures.picture("image", e),
      this.dataset,
      this.environment,
    );
    this.element.replaceChildren(
      this.head,
      h(
        "div",
        { class: "columns" },
        h("div", { class: "main" }, this.tools(), this.pictures.element, this.light.element),
        h(
          "div",
          { class: "side" },
          this.errors(),
          this.siblings(),
          this.reproduce(),
          metadata(shot.meta),
          members(shot.members),
        ),
      ),
    );
    this.draw();
  }

  draw() {
    this.pictures.show(this.pass, this.environment, this.beside);
  }

  header(subset, id, subject) {
    this.badges = h("span", { class: "badges" });
    this.marked();
    this.previous = button("←", () => this.step(-1), { label: "Previous shot in the selection" });
    this.next = button("→", () => this.step(1), { label: "Next shot in the selection" });
    this.previous.disabled = this.next.disabled = this.at === null;
    return h(
      "header",
      { class: "viewbar" },
      button("‹ Grid", () => this.address.close(), { label: "Back to the grid" }),
      h("h1", { text: `${subset}/${id}` }),
      this.previous,
      this.next,
      this.badges,
      h("span", { class: "spring" }),
      h("span", { class: "row tagging" }, ...this.tags.buttons()),
      button("Subject in 3D", () => this.address.show("subject", subset, subject)),
      button("Play", () =>
        this.address.show("play", subset, subject, { environment: String(this.environment ?? 0) }),
      ),
    );
  }

  /** Shows the shot's tags, which have changed; `unknown` if the server must say which it has. */
  async marked(unknown = false) {
    if (unknown) {
      const { subset, key } = this.shot;
      const now = await askJson(path("api", "shot", subset, key));
      Object.assign(this.shot, { tags: now.tags, mine: now.mine });
    }
    this.badges.replaceChildren(...badges(this.shot.tags));
  }

  broken(reason) {
    this.element.replaceChildren(
      this.head,
      h(
        "div",
        { class: "notice", role: "alert" },
        h("h2", { text: "This shot is broken" }),
        h("p", { text: reason }),
        h("p", {
          class: "hint",
          text: "Run synthgen verify to see what else is wrong with its shard.",
        }),
      ),
    );
    if (this.shot.members?.length) this.element.append(members(this.shot.members));
  }

  tools() {
    this.switch = segments(
      "Pass",
      this.passes.map((p) => [p, this.labels.get(p)]),
      this.pass,
      (p) => this.show(p),
    );
    const overlay = (name, label) =>
      h(
        "label",
        { class: "check" },
        h("input", {
          type: "checkbox",
          checked: this.overlay[name],
          onchange: (event) => {
            this.overlay[name] = event.target.checked;
            this.address.setOptions({ [name]: event.target.checked ? "1" : "0" });
            this.pictures.redraw();
          },
        }),
        h("span", { text: label }),
      );
    return h(
      "div",
      { class: "tools" },
      this.switch,
      overlay("landmarks", "Landmarks"),
      overlay("mesh", "Mesh"),
      this.shot.environments.length > 1 ? this.lights() : null,
    );
  }

  /** Chooses which environments are shown: all side by side, or one of them, large. */
  lights() {
    return h(
      "select",
      {
        "aria-label": "Lights shown",
        onchange: ({ target }) => {
          this.beside = target.value === "all";
          this.address.setOptions({ one: this.beside ? "0" : "1" });
          if (this.beside) this.draw();
          else this.pick(Number(target.value));
        },
      },
      h("option", { value: "all", text: "All lights side by side", selected: this.beside }),
      ...this.shot.environments.map(({ id }, e) =>
        h("option", {
          value: String(e),
          text: `${id} only`,
          selected: !this.beside && e === this.environment,
        }),
      ),
    );
  }

  show(pass) {
    this.pass = pass;
    this.switch.select(pass);
    this.address.setOptions({ pass });
    this.draw();
  }

  /** Chooses an environment of the shot for the light panel and for play. */
  pick(environment) {
    this.environment = environment;
    this.address.setOptions({ environment: String(environment) });
    if (this.beside) this.pictures.mark(environment);
    else this.draw();
    this.light.use(environment);
  }

  /** What the run got wrong in this shot, if it was measured. */
  errors() {
    const found = Object.entries(this.shot.errors ?? {});
    if (!found.length) return null;
    return h(
      "section",
      { class: "panel", "aria-label": "Errors of the run" },
      h("h2", { text: "Errors of the run" }),
      h(
        "dl",
        { class: "table" },
        ...found.flatMap(([title, value]) => [
          h("dt", { text: title }),
          h("dd", { class: "number", text: value === null ? "none" : number(value) }),
        ]),
      ),
    );
  }

  siblings() {
    const { subset, subject } = this.shot;
    const list = this.shot.siblings.map((id) => {
      const current = id === this.shot.key;
      return h(
        "li",
        {},
        h("a", {
          href: this.address.href("shot", subset, id),
          text: id.split("_").pop(),
          title: id,
          "aria-current": current ? "true" : null,
          "aria-label": `Shot ${id}`,
          onclick: (event) => {
            if (event.ctrlKey || event.metaKey) return;
            event.preventDefault();
            this.address.show("shot", subset, id, { pass: this.pass });
          },
        }),
      );
    });
    return h(
      "section",
      { class: "panel", "aria-label": "Shots of this subject" },
      h("h2", { text: `Shots of ${subject}` }),
      h("ul", { class: "keys" }, ...list),
    );
  }

  reproduce() {
    return h(
      "section",
      { class: "panel", "aria-label": "Reproduce" },
      h("h2", { text: "Render it again" }),
      command(this.shot.command, "Copy the command that renders this shot again"),
    );
  }

  async step(by) {
    if (this.at === null) return;
    const row = await this.neighbour(this.at + by);
    if (!row || this.closed) return;
    const options = { ...this.address.view.options, at: String(this.at + by) };
    this.address.show("shot", row.subset, row.key, options);
  }

  key(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    const number = /^[1-9]$/.test(event.key) ? Number(event.key) : 0;
    const zoom = { "+": 1.5, "=": 1.5, "-": 1 / 1.5 }[event.key];
    if (step) this.step(step);
    else if (zoom) this.pictures?.zoom.by(zoom);
    else if (event.key === "0") this.pictures?.zoom.set(1, 0, 0);
    else if (number && this.passes?.[number - 1]) this.show(this.passes[number - 1]);
    else return false;
    return true;
  }

  close() {
    this.closed = true;
    this.pictures?.close();
    this.light?.close();
  }
}
