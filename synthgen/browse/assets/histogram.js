// A histogram in which a range is chosen by dragging, or by typing two numbers.

import { h, number, svg } from "./dom.js";

const span = (low, high) => `${number(low)} – ${number(high)}`;
const WIDTH = 240;
const HEIGHT = 44;

export class Histogram {
  /** @param {(low: number|null, high: number|null) => void} onrange called with a new range */
  constructor(label, onrange) {
    this.onrange = onrange;
    this.range = [null, null];
    this.bars = svg("g", { class: "bars" });
    this.brush = svg("rect", {
      class: "brush",
      y: "0",
      height: String(HEIGHT),
      visibility: "hidden",
    });
    this.plot = svg(
      "svg",
      {
        class: "histogram",
        viewBox: `0 0 ${WIDTH} ${HEIGHT}`,
        preserveAspectRatio: "none",
        role: "img",
        "aria-label": `Histogram of ${label}; drag to choose a range`,
        onpointerdown: (event) => this.start(event),
        onpointermove: (event) => this.move(event),
        onpointerup: (event) => this.end(event),
      },
      this.bars,
      this.brush,
    );
    const field = (name, at) =>
      h("input", {
        type: "number",
        step: "any",
        inputmode: "decimal",
        "aria-label": `${label}, ${name}`,
        onchange: (event) => this.typed(at, event.target),
      });
    this.fields = [field("from", 0), field("to", 1)];
    this.element = h(
      "div",
      { class: "range" },
      this.plot,
      h("div", { class: "bounds" }, this.fields[0], h("span", { text: "–" }), this.fields[1]),
    );
  }

  /** Shows counts (N,) between edges (N + 1,), and the range chosen. */
  show({ edges, counts }, [low, high]) {
    this.edges = edges;
    this.range = [low, high];
    const [first, last] = this.ends();
    const most = Math.max(1, ...counts);
    const step = WIDTH / Math.max(1, counts.length);
    this.bars.replaceChildren(
      ...counts.map((count, i) => {
        // The square root keeps the tails visible.
        const height = count ? Math.max(1.5, Math.sqrt(count / most) * (HEIGHT - 2)) : 0;
        const middle = (edges[i] + edges[i + 1]) / 2;
        const inside = (low === null || middle >= low) && (high === null || middle <= high);
        return svg(
          "rect",
          {
            x: String(i * step),
            width: String(Math.max(0.5, step - 1)),
            y: String(HEIGHT - height),
            height: String(height),
            class: inside ? "in" : "out",
          },
          svg("title", { text: `${span(edges[i], edges[i + 1])}: ${number(count)}` }),
        );
      }),
    );
    const bounds = [first, last];
    this.fields.forEach((field, i) => {
      field.placeholder = bounds[i] === undefined ? "" : number(bounds[i]);
      if (document.activeElement !== field) field.value = this.range[i] ?? "";
    });
  }

  ends() {
    return this.edges?.length ? [this.edges[0], this.edges[this.edges.length - 1]] : [];
  }

  typed(at, field) {
    const value = field.value === "" ? null : Number(field.value);
    const range = [...this.range];
    range[at] = value;
    this.onrange(...range);
  }

  at(event) {
    const box = this.plot.getBoundingClientRect();
    return Math.max(0, Math.min(1, (event.clientX - box.left) / box.width));
  }

  start(event) {
    if (!this.edges?.length) return;
    this.plot.setPointerCapture(event.pointerId);
    this.from = this.at(event);
    this.move(event);
  }

  move(event) {
    if (this.from === undefined) return;
    const [a, b] = [this.from, this.at(event)].sort((x, y) => x - y);
    this.brush.setAttribute("visibility", "visible");
    this.brush.setAttribute("x", String(a * WIDTH));
    this.brush.setAttribute("width", String((b - a) * WIDTH));
  }

  end(event) {
    if (this.from === undefined) return;
    const [a, b] = [this.from, this.at(event)].sort((x, y) => x - y);
    this.from = undefined;
    this.brush.setAttribute("visibility", "hidden");
    // A click without a drag clears the range.
    if (b - a < 0.01) return this.onrange(null, null);
    const [first, last] = this.ends();
    const bound = (share) => Number((first + share * (last - first)).toPrecision(4));
    this.onrange(a <= 0 ? null : bound(a), b >= 1 ? null : bound(b));
  }
}
