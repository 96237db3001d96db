// The toolbar above the grid: the dataset's name, the SQL condition, the order, the active filters.

import { Completion } from "./complete.js";
import { button, h, number, segments } from "./dom.js";
import { said } from "./facets.js";

const SIZES = [
  [110, "S"],
  [160, "M"],
  [240, "L"],
];

export class Toolbar {
  /** @param callbacks `resize(pixels)`, `filters(shown)`, `take()`, `help()` */
  constructor(element, chips, address, callbacks) {
    Object.assign(this, { element, chips, address, callbacks });
  }

  build(dataset) {
    const { selection } = this.address;
    this.columns = new Map(dataset.columns.map((column) => [column.name, column]));
    this.total = h("span", { class: "total number", "aria-live": "polite" });
    this.state = h("span", { class: "state" });
    this.where = h("input", {
      type: "text",
      class: "where",
      spellcheck: "false",
      autocomplete: "off",
      placeholder: "SQL condition, e.g. person_age_years > 60 AND head_yaw < 0",
      "aria-label": "SQL condition on the manifest",
      "aria-describedby": "where-problem",
      onkeydown: (event) => {
        if (event.key === "Enter") this.address.select({ where: this.where.value.trim() });
      },
      onchange: () => {
        const where = this.where.value.trim();
        if (where !== this.address.selection.where) this.address.select({ where });
      },
    });
    this.completion = new Completion(this.where, dataset.columns);
    this.problem = h("p", { class: "problem", id: "where-problem", role: "alert", hidden: true });
    this.sort = h(
      "select",
      { "aria-label": "Sort by", onchange: () => this.address.select({ sort: this.sort.value }) },
      h("option", { value: "", text: "as stored" }),
      ...this.orders(dataset.columns),
    );
    this.direction = button("↑", () => {
      this.address.select({ descending: !this.address.selection.descending });
    });
    this.filters = button("Filters", () => this.filter(!this.filtering), { class: "filters" });
    this.element.replaceChildren(
      h("div", { class: "brand" }, h("h1", { text: dataset.name }), this.total, this.state),
      h(
        "div",
        { class: "search" },
        h("span", { class: "prompt", "aria-hidden": "true", text: "WHERE" }),
        this.where,
        h("kbd", { text: "/", "aria-hidden": "true" }),
        this.completion.list,
        this.problem,
      ),
      h(
        "div",
        { class: "order" },
        this.filters,
        this.sort,
        this.direction,
        segments("Picture size", SIZES, 160, this.callbacks.resize),
        button("Export", () => this.callbacks.take(), { label: "Take this selection along" }),
        button("?", () => this.callbacks.help(), { label: "Keyboard shortcuts" }),
      ),
    );
    this.where.value = selection.where;
    this.show();
  }

  /** Columns to sort by, grouped. */
  orders(columns) {
    const groups = new Map();
    for (const column of columns.filter(({ listed }) => !listed)) {
      if (!groups.has(column.group))
        groups.set(column.group, h("optgroup", { label: column.group }));
      groups
        .get(column.group)
        .append(h("option", { value: column.name, text: this.label(column.name) }));
    }
    return groups.values();
  }

  /** Switches between filters and grid where there is no room for both. */
  filter(shown) {
    this.filtering = shown;
    this.filters.textContent = shown ? "Show pictures" : "Filters";
    this.callbacks.filters(shown);
  }

  /** Shows the selection: condition, order and a chip per filter. */
  show() {
    const { where, sort, descending, facets, ranges, tags } = this.address.selection;
    if (document.activeElement !== this.where) this.where.value = where;
    this.sort.value = sort;
    this.direction.textContent = descending ? "↓" : "↑";
    const label = descending
      ? "Descending; switch to ascending"
      : "Ascending; switch to descending";
    this.direction.setAttribute("aria-label", label);
    this.direction.title = label;
    this.direction.disabled = !sort;
    const chips = [
      ...Object.entries(facets).map(([name, values]) => [
        `${this.label(name)}: ${values.map((v) => said(v, this.columns.get(name))).join(", ")}`,
        () => this.address.setFacet(name, []),
      ]),
      ...Object.entries(ranges).map(([name, [low, high]]) => [
        `${this.label(name)}: ${span(low, high)}`,
        () => this.address.setRange(name, null, null),
      ]),
    ];
    for (const tag of tags)
      chips.push([
        tag.startsWith("-") ? `without ${tag.slice(1)}` : `tagged ${tag}`,
        () => this.address.select({ tags: tags.filter((other) => other !== tag) }),
      ]);
    if (where)
      chips.push([
        where,
        () => {
          this.where.value = "";
          this.address.select({ where: "" });
        },
      ]);
    this.chips.hidden = !chips.length;
    const clear = button(
      "Clear all",
      () => {
        this.where.value = "";
        this.address.select({ facets: {}, ranges: {}, where: "", tags: [] });
      },
      { class: "clear" },
    );
    this.chips.replaceChildren(
      ...chips.map(([text, remove]) =>
        h(
          "span",
          { class: "chip" },
          h("span", { class: "words", text, title: text }),
          button("×", remove, { label: `Remove ${text}` }),
        ),
      ),
      ...(chips.length > 1 ? [clear] : []),
    );
  }

  label(name) {
    return this.columns.get(name)?.title || name;
  }

  count(total, of) {
    const all = of && total !== of ? ` of ${number(of)}` : "";
    this.total.textContent = `${number(total)}${all} shots`;
  }

  /** Shows one line below the condition; null removes it. */
  showProblem(problem) {
    this.problem.textContent = problem ?? "";
    this.problem.hidden = !problem;
    this.where.setAttribute("aria-invalid", String(Boolean(problem)));
  }
}

function span(low, high) {
  if (low === null) return `≤ ${number(high)}`;
  if (high === null) return `≥ ${number(low)}`;
  return `${number(low)} – ${number(high)}`;
}
