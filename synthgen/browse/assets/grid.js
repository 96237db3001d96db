// The grid: one cell per shot, for any number of shots; only those near the viewport exist.
//
// Browsers limit a page to about 10 million pixels in height. A longer list scrolls a page of
// `TALLEST` pixels: small steps move the list by as many pixels, jumps (dragging the scrollbar,
// Home, End) move it in proportion, and when scrolling stops the page is realigned with the list.

import { CAPTION, Cell, GAP } from "./cell.js";
import { h } from "./dom.js";

const TALLEST = 6_000_000;
const BLOCK = 100;
const KEPT_BLOCKS = 200;

export class Grid {
  /**
   * @param {HTMLElement} element the element that scrolls
   * @param {object} callbacks `rows(offset, limit, signal)` resolves to {total, rows};
   *   `open(row, index)`, `href(row, index)`, `environment(row)` the picture's number,
   *   `caption(row)`, `picked(row)`, `pick(row, index, range)` and `failed(error)`
   */
  constructor(element, callbacks) {
    this.element = element;
    this.callbacks = callbacks;
    this.size = 160;
    this.active = 0;
    this.canvas = h("div", { class: "cells" });
    this.empty = h("div", { class: "notice", hidden: true });
    element.append(this.canvas, this.empty);
    for (const [name, value] of Object.entries({
      tabindex: "0",
      role: "listbox",
      "aria-label": "Shots",
    }))
      element.setAttribute(name, value);
    element.addEventListener("scroll", () => this.scrolled(), { passive: true });
    element.addEventListener("keydown", (event) => this.key(event));
    this.clear();
    this.measure();
  }

  /** Drops all rows and starts at the top, for another selection. */
  reset() {
    this.watch ??= new ResizeObserver(() => this.resized());
    this.watch.observe(this.element);
    this.clear();
    this.total = null;
    this.top = 0;
    this.active = 0;
    this.element.scrollTop = this.lastScroll = 0;
    this.empty.hidden = true;
    this.element.setAttribute("aria-busy", "true");
    this.layout();
  }

  /** Requests everything again at the same position: the dataset has grown. */
  refresh() {
    const { top, active, total } = this;
    this.clear();
    Object.assign(this, { top, active, total });
    this.layout();
  }

  clear() {
    this.generation = (this.generation ?? 0) + 1;
    for (const request of this.requests?.values() ?? []) request.abort();
    for (const cell of this.cells?.values() ?? []) cell.remove();
    this.blocks = new Map();
    this.requests = new Map();
    this.cells = new Map();
  }

  resize(size) {
    this.size = size;
    this.resized();
  }

  resized() {
    if (!this.element.clientHeight) return; // hidden
    const [columns, cell, pitch] = [this.columns, this.cell, this.pitch];
    this.measure();
    if (columns === this.columns && cell === this.cell) {
      this.settle();
      this.draw();
      return;
    }
    this.top = Math.floor((Math.floor(this.top / pitch) * columns) / this.columns) * this.pitch;
    for (const cell of this.cells.values()) cell.remove();
    this.cells.clear();
    this.layout();
  }

  measure() {
    const style = getComputedStyle(this.element);
    const edge = parseFloat(style.paddingLeft) || 0;
    const inside = Math.max(80, this.element.clientWidth - 2 * edge);
    this.columns = Math.max(2, Math.round((inside + GAP) / (this.size + GAP)));
    this.cell = (inside - (this.columns - 1) * GAP) / this.columns;
    this.pitch = this.cell + CAPTION + GAP;
    this.edge = edge;
  }

  /** Height of the whole list in pixels, however large. */
  get height() {
    return Math.ceil((this.total ?? this.columns * 4) / this.columns) * this.pitch;
  }

  layout() {
    this.measure();
    const page = Math.min(this.height, TALLEST);
    this.canvas.style.height = `${page}px`;
    this.settle();
    this.draw();
  }

  /** Realigns the page's scroll position with the list. */
  settle() {
    const view = this.element.clientHeight;
    this.top = Math.max(0, Math.min(this.top, this.height - view));
    if (this.height > TALLEST) {
      const share = this.top / Math.max(1, this.height - view);
      this.element.scrollTop = share * (TALLEST - view);
    } else {
      this.element.scrollTop = this.top;
    }
    this.lastScroll = this.element.scrollTop;
  }

  scrolled() {
    const { scrollTop, clientHeight: view } = this.element;
    const step = scrollTop - this.lastScroll;
    if (step === 0) return;
    this.lastScroll = scrollTop;
    if (this.height <= TALLEST) {
      this.top = scrollTop;
    } else {
      const end = TALLEST - view;
      const near = Math.abs(step) < 2 * view && scrollTop > 0 && scrollTop < end - 1;
      const last = this.height - view;
      this.top = near
        ? Math.max(0, Math.min(last, this.top + step))
        : (Math.min(scrollTop, end) / end) * last;
      clearTimeout(this.rest);
      this.rest = setTimeout(() => {
        this.settle();
        this.draw();
      }, 200);
    }
    this.fast = Math.abs(step) > view;
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.draw());
  }

  draw() {
    if (!this.element.clientHeight) return;
    const view = this.element.clientHeight;
    const count = this.total ?? Math.ceil(view / this.pitch) * this.columns;
    const from = Math.max(0, Math.floor(this.top / this.pitch) - 1) * this.columns;
    const to = Math.min(count, Math.ceil((this.top + view) / this.pitch + 1) * this.columns);
    for (const [index, cell] of this.cells) {
      if (index < from || index >= to) {
        cell.drop();
        this.cells.delete(index);
      }
    }
    const shift = this.lastScroll - this.top;
    for (let index = from; index < to; index++) {
      let cell = this.cells.get(index);
      if (!cell) {
        cell = new Cell(this, index);
        this.cells.set(index, cell);
        this.canvas.append(cell.element);
      }
      cell.place(this, shift);
      cell.show(this.known(index));
    }
    this.markActive();
    clearTimeout(this.wait);
    this.wait = setTimeout(() => this.request(from, to), this.fast ? 90 : 0);
    this.fast = false;
  }

  known(index) {
    return this.blocks.get(Math.floor(index / BLOCK))?.[index % BLOCK];
  }

  /** Requests the blocks of these cells and cancels requests for others. */
  request(from, to) {
    const first = Math.floor(from / BLOCK);
    const last = Math.floor(Math.max(from, to - 1) / BLOCK);
    for (const [block, request] of this.requests) {
      if (block < first - 1 || block > last + 1) {
        request.abort();
        this.requests.delete(block);
      }
    }
    for (let block = first; block <= last; block++) this.load(block);
  }

  async load(block) {
    if (this.blocks.has(block) || this.requests.has(block)) return;
    const request = new AbortController();
    const { generation } = this;
    this.requests.set(block, request);
    try {
      const answer = await this.callbacks.rows(block * BLOCK, BLOCK, request.signal);
      if (generation !== this.generation) return;
      this.blocks.set(block, answer.rows);
      if (this.blocks.size > KEPT_BLOCKS) this.blocks.delete(this.blocks.keys().next().value);
      const changed = this.total !== answer.total;
      this.total = answer.total;
      this.element.removeAttribute("aria-busy");
      this.callbacks.counted(answer.total);
      if (changed) this.layout();
      else this.draw();
    } catch (error) {
      if (error.name !== "AbortError" && generation === this.generation)
        this.callbacks.failed(error);
    } finally {
      if (this.requests.get(block) === request) this.requests.delete(block);
    }
  }

  /** The row at an index of the selection, fetched if need be; null beyond the ends. */
  async row(index) {
    if (index < 0 || (this.total !== null && index >= this.total)) return null;
    if (!this.known(index)) {
      const block = Math.floor(index / BLOCK);
      const answer = await this.callbacks.rows(block * BLOCK, BLOCK);
      this.blocks.set(block, answer.rows);
      this.total = answer.total;
    }
    return this.known(index) ?? null;
  }

  /** Shows a message in place of the grid. */
  notice(title, text) {
    this.empty.replaceChildren(h("h2", { text: title }), h("p", { text }));
    this.empty.hidden = false;
    this.element.removeAttribute("aria-busy");
    this.total = 0;
    this.layout();
  }

  key(event) {
    const rows = Math.max(1, Math.floor(this.element.clientHeight / this.pitch));
    const steps = {
      ArrowRight: 1,
      ArrowLeft: -1,
      ArrowDown: this.columns,
      ArrowUp: -this.columns,
      PageDown: rows * this.columns,
      PageUp: -rows * this.columns,
      Home: -Infinity,
      End: Infinity,
    };
    if (event.ctrlKey || event.metaKey || event.altKey || !this.total) return;
    if (event.key === "Enter") {
      const row = this.known(this.active);
      if (row) this.callbacks.open(row, this.active);
    } else if (event.key in steps) {
      this.activate(this.active + steps[event.key]);
    } else return;
    event.preventDefault();
  }

  /** Makes a cell the current one and scrolls it into view. */
  activate(index) {
    this.active = Math.max(0, Math.min((this.total ?? 1) - 1, index));
    const y = Math.floor(this.active / this.columns) * this.pitch;
    const view = this.element.clientHeight;
    const top = Math.min(y, Math.max(this.top, y + this.pitch - view));
    if (top !== this.top) {
      this.top = top;
      this.settle();
    }
    this.draw();
  }

  /** Shows anew which shots are picked, and their tags. */
  mark() {
    for (const cell of this.cells.values()) cell.mark();
  }

  markActive() {
    for (const [index, cell] of this.cells) {
      cell.element.setAttribute("aria-selected", String(index === this.active));
    }
    const active = this.cells.get(this.active);
    if (active) this.element.setAttribute("aria-activedescendant", active.element.id);
    else this.element.removeAttribute("aria-activedescendant");
  }
}
