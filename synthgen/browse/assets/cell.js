// One cell of the grid: a shot's thumbnail and caption, or why there is none.

import { ask, path, query } from "./api.js";
import { button, h } from "./dom.js";
import { badges } from "./tags.js";

/** Height of a caption and gap between cells, in pixels. */
export const CAPTION = 22;
export const GAP = 6;

export class Cell {
  constructor(grid, index) {
    this.grid = grid;
    this.index = index;
    this.image = h("img", { alt: "", draggable: "false" });
    this.text = h("span", { class: "words" });
    this.from = h("span", { class: "from" });
    this.value = h("span", { class: "sorted" });
    this.pick = button("", (event) => this.picked(event), { label: "Pick", class: "pickbox" });
    this.pick.tabIndex = -1;
    this.badges = h("span", { class: "badges" });
    this.element = h(
      "a",
      {
        class: "cell",
        id: `cell-${index}`,
        role: "option",
        tabindex: "-1",
        "aria-posinset": String(index + 1),
        onclick: (event) => this.clicked(event),
      },
      h("span", { class: "picture" }, this.image),
      h("span", { class: "caption" }, this.text, this.from, this.value),
      this.badges,
      this.pick,
    );
  }

  picked(event) {
    event.preventDefault();
    event.stopPropagation();
    if (!this.row) return;
    this.grid.active = this.index;
    this.grid.callbacks.pick(this.row, this.index, event.shiftKey);
  }

  clicked(event) {
    if (event.shiftKey) return this.picked(event);
    // With a modifier the browser opens a new tab.
    if (event.ctrlKey || event.metaKey || !this.row) return;
    event.preventDefault();
    this.grid.active = this.index;
    this.grid.callbacks.open(this.row, this.index);
  }

  place({ columns, cell, pitch, edge, total }, shift) {
    const x = edge + (this.index % columns) * (cell + GAP);
    const y = Math.floor(this.index / columns) * pitch + shift;
    const { style } = this.element;
    style.transform = `translate(${x}px, ${y}px)`;
    style.width = `${cell}px`;
    style.height = `${cell + CAPTION}px`;
    this.element.setAttribute("aria-setsize", String(total ?? -1));
  }

  show(row) {
    if (!row || row === this.row) return;
    this.row = row;
    const { callbacks } = this.grid;
    this.element.setAttribute("href", callbacks.href(row, this.index));
    const { label, text, from, value } = callbacks.caption(row);
    this.from.textContent = from;
    this.element.setAttribute("aria-label", label);
    this.text.textContent = text;
    this.value.textContent = value;
    this.load();
    this.mark();
  }

  /** Shows the row's tags, and whether it is picked. */
  mark() {
    if (!this.row) return;
    const { tags = [] } = this.row;
    const picked = this.grid.callbacks.picked(this.row);
    this.element.classList.toggle("picked", picked);
    this.element.classList.toggle("rejected", tags.includes("reject"));
    this.pick.setAttribute("aria-pressed", String(picked));
    this.badges.replaceChildren(...badges(tags));
    const { label } = this.grid.callbacks.caption(this.row);
    const said = [label, ...tags, picked ? "picked" : null].filter(Boolean).join(", ");
    if (!this.element.classList.contains("broken")) this.element.setAttribute("aria-label", said);
  }

  async load() {
    const { row, grid } = this;
    const reason = row.broken ?? (row.failed ? row.reason || "failed" : null);
    if (reason) return this.broken(reason);
    this.request = new AbortController();
    const pixels = Math.ceil(grid.cell * Math.min(devicePixelRatio || 1, 2));
    const address =
      path("thumbnail", row.subset, row.key) +
      query({
        environment: grid.callbacks.environment(row),
        size: Math.min(480, pixels),
        revision: grid.callbacks.revision(),
      });
    try {
      const response = await ask(address, { signal: this.request.signal });
      const why = response.headers.get("X-Broken");
      if (why !== null) return this.broken(why);
      const blob = await response.blob();
      if (this.dropped) return;
      this.address = URL.createObjectURL(blob);
      this.image.src = this.address;
      await this.image.decode();
      this.element.classList.add("loaded");
    } catch (error) {
      if (error.name !== "AbortError" && !this.dropped) this.broken(error.message);
    }
  }

  broken(reason) {
    this.element.classList.add("broken");
    this.element.setAttribute(
      "aria-label",
      `${this.grid.callbacks.caption(this.row).label}, broken: ${reason}`,
    );
    this.image.replaceWith(
      h("span", { class: "reason" }, h("b", { text: "Broken" }), h("span", { text: reason })),
    );
  }

  /** Removes the cell from the page and cancels its request. */
  drop() {
    this.dropped = true;
    this.request?.abort();
    this.element.remove();
    if (this.address) URL.revokeObjectURL(this.address);
  }

  remove() {
    this.drop();
  }
}
