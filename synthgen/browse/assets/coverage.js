// How a selection covers two angles together: a map in which a rectangle chooses a range of both.

import { h } from "./dom.js";

const WIDTH = 240;
const HEIGHT = 120;

export class Coverage {
  /** @param onrange called with {x: [low, high], y: [low, high]}; {} takes both choices away */
  constructor(title, x, y, onrange) {
    Object.assign(this, { title, x, y, onrange });
    this.canvas = h("canvas", {
      class: "coverage",
      role: "img",
      "aria-label": `${title}: ${x} by ${y}; drag to choose a range of both`,
      width: String(WIDTH * 2),
      height: String(HEIGHT * 2),
      onpointerdown: (event) => this.start(event),
      onpointermove: (event) => this.move(event),
      onpointerup: (event) => this.end(event),
    });
    this.brush = h("span", { class: "rectangle", hidden: true });
    this.words = h("p", { class: "hint number" });
    this.element = h(
      "section",
      { class: "facet" },
      h("h3", { text: title }),
      h("div", { class: "covered" }, this.canvas, this.brush),
      this.words,
    );
  }

  /** Shows counts, row by row from the lowest y, and the ranges that are chosen. */
  show({ x_edges, y_edges, counts }, ranges) {
    Object.assign(this, { across: x_edges, up: y_edges });
    const wide = x_edges.length - 1;
    const high = y_edges.length - 1;
    const context = this.canvas.getContext("2d");
    const most = Math.max(1, ...counts);
    const style = getComputedStyle(this.element);
    const [empty, full] = ["--sunken", "--accent"].map((name) => style.getPropertyValue(name));
    const { width, height } = this.canvas;
    context.globalAlpha = 1;
    context.fillStyle = empty;
    context.fillRect(0, 0, width, height);
    context.fillStyle = full;
    counts.forEach((count, i) => {
      if (!count) return;
      const [column, row] = [i % wide, Math.floor(i / wide)];
      // The square root keeps what is rare visible.
      context.globalAlpha = 0.25 + 0.75 * Math.sqrt(count / most);
      const [left, top] = [(column / wide) * width, (1 - (row + 1) / high) * height];
      context.fillRect(left, top, width / wide - 1, height / high - 1);
    });
    context.globalAlpha = 1;
    const box = this.box(ranges);
    if (box) {
      context.strokeStyle = style.getPropertyValue("--ink");
      context.lineWidth = 3;
      context.strokeRect(...box);
    }
    const degrees = (edges) => `${degree(edges[0])} to ${degree(edges[edges.length - 1])}`;
    this.words.textContent = `${degrees(x_edges)} across, ${degrees(y_edges)} up`;
  }

  /** Where the chosen ranges lie on the canvas, or null. */
  box(ranges) {
    if (!(this.x in ranges) && !(this.y in ranges)) return null;
    const share = (edges, value, open) => {
      const [low, high] = [edges[0], edges[edges.length - 1]];
      return value === null ? open : Math.max(0, Math.min(1, (value - low) / (high - low || 1)));
    };
    const [x, y] = [ranges[this.x] ?? [null, null], ranges[this.y] ?? [null, null]];
    const [left, right] = [share(this.across, x[0], 0), share(this.across, x[1], 1)];
    const [bottom, top] = [share(this.up, y[0], 0), share(this.up, y[1], 1)];
    const { width, height } = this.canvas;
    return [left * width, (1 - top) * height, (right - left) * width, (top - bottom) * height];
  }

  /** The rectangle from where a drag began to the pointer, as shares: [left, right, top, bottom]. */
  dragged(event) {
    const box = this.canvas.getBoundingClientRect();
    const inside = (value) => Math.max(0, Math.min(1, value));
    const to = [
      inside((event.clientX - box.left) / box.width),
      inside((event.clientY - box.top) / box.height),
    ];
    this.from ??= to;
    return [0, 1].flatMap((i) => [this.from[i], to[i]].sort((a, b) => a - b));
  }

  start(event) {
    if (!this.across) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.dragging = true;
    this.from = undefined;
    this.move(event);
  }

  move(event) {
    if (!this.dragging) return;
    const [left, right, top, bottom] = this.dragged(event);
    this.brush.hidden = false;
    Object.assign(this.brush.style, {
      left: `${left * 100}%`,
      top: `${top * 100}%`,
      width: `${(right - left) * 100}%`,
      height: `${(bottom - top) * 100}%`,
    });
  }

  end(event) {
    if (!this.dragging) return;
    const [left, right, top, bottom] = this.dragged(event);
    this.dragging = false;
    this.brush.hidden = true;
    // A click without a drag takes both choices away.
    if (right - left < 0.02 && bottom - top < 0.02) return this.onrange({});
    const range = (edges, from, until) => {
      const [low, high] = [edges[0], edges[edges.length - 1]];
      const bound = (share) => Number((low + share * (high - low)).toPrecision(4));
      return [from <= 0 ? null : bound(from), until >= 1 ? null : bound(until)];
    };
    const chosen = {
      [this.x]: range(this.across, left, right),
      [this.y]: range(this.up, 1 - bottom, 1 - top),
    };
    this.onrange(
      Object.fromEntries(Object.entries(chosen).filter(([, ends]) => ends.some((e) => e !== null))),
    );
  }
}

const degree = (radians) => `${Math.round((radians * 180) / Math.PI)}°`;
