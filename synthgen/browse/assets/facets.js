// The filters beside the grid, in groups of columns. A column is a list of values with their
// counts, or a histogram. Only columns in open groups are requested.

import { h, number } from "./dom.js";
import { Histogram } from "./histogram.js";
import { TagFilter } from "./tags.js";

const SHOWN = 8;
const OPEN = 1; // groups that are open initially

export class Facets {
  /** @param address the page's `Address`  @param onopen called when a group opens or closes */
  constructor(element, address, onopen) {
    this.element = element;
    this.address = address;
    this.onopen = onopen;
    this.parts = new Map();
    this.groups = [];
    this.tags = new TagFilter(address);
  }

  /** Builds the filters of a dataset's columns. */
  build(columns) {
    const grouped = new Map();
    for (const column of columns) {
      if (column.kind === "other") continue;
      if (!grouped.has(column.group)) grouped.set(column.group, []);
      grouped.get(column.group).push(column);
    }
    const { facets, ranges } = this.address.selection;
    const last = (name) => Number(name === "other" || name === "cost" || name === "quality");
    const ordered = [...grouped].sort(([a], [b]) => last(a) - last(b));
    this.parts.clear();
    this.groups = ordered.map(([name, members], i) => {
      const parts = members.map((column) => this.part(column));
      const chosen = members.some((c) => c.name in facets || c.name in ranges);
      const details = h(
        "details",
        { class: "group", open: i < OPEN || chosen, ontoggle: () => this.onopen() },
        h("summary", {}, h("span", { text: name }), h("span", { class: "chosen" })),
        ...parts,
      );
      return { details, members };
    });
    this.problem = h("p", { class: "problem", role: "alert", hidden: true });
    this.element.replaceChildren(
      this.problem,
      this.tags.element,
      ...this.groups.map((group) => group.details),
    );
  }

  part(column) {
    const { label, name, unit } = column;
    const written = unit && !(label || name).endsWith(unit) ? ` (${unit})` : "";
    const heading = h("h3", { text: (label || name) + written });
    const part =
      column.kind === "range"
        ? new Histogram(column.label || column.name, (low, high) =>
            this.address.setRange(column.name, low, high),
          )
        : new Values(column, this.address);
    const section = h("section", { class: "facet" }, heading, part.element);
    this.parts.set(column.name, { show: (...found) => part.show(...found), section });
    return section;
  }

  /** Columns in open groups. */
  wanted() {
    return this.groups
      .filter(({ details }) => details.open)
      .flatMap(({ members }) => members.map((column) => column.name));
  }

  /** Says why there are no counts; those on display may belong to an earlier selection. */
  fail(error) {
    this.problem.textContent = error.message;
    this.problem.hidden = false;
    this.element.classList.add("stale");
  }

  /** Shows the counts of a selection. */
  show(counts) {
    this.problem.hidden = true;
    this.element.classList.remove("stale");
    this.tags.show(counts.tags);
    const { facets, ranges } = this.address.selection;
    for (const [name, values] of Object.entries(counts.facets)) {
      const chosen = facets[name] ?? [];
      const { show, section } = this.parts.get(name);
      show(values, chosen);
      section.hidden = !values.length && !chosen.length;
    }
    for (const [name, histogram] of Object.entries(counts.histograms)) {
      const { show, section } = this.parts.get(name);
      show(histogram, ranges[name] ?? [null, null]);
      // A column without any value cannot be a filter.
      section.hidden = !histogram.edges.length;
    }
    for (const { details, members } of this.groups) {
      const chosen = members.filter((c) => c.name in facets || c.name in ranges).length;
      details.querySelector(".chosen").textContent = chosen ? String(chosen) : "";
    }
  }
}

/** The values of one column with their counts, most frequent first. */
class Values {
  constructor(column, address) {
    this.column = column;
    this.address = address;
    this.lines = new Map();
    this.all = false;
    this.list = h("div", {
      class: "values",
      role: "group",
      "aria-label": column.label || column.name,
    });
    this.more = h("button", {
      type: "button",
      class: "more",
      hidden: true,
      onclick: () => this.toggle(),
    });
    this.element = h("div", {}, this.list, this.more);
  }

  show(counts, chosen) {
    this.counts = counts;
    // A chosen value that no longer occurs stays listed, so that it can be unchecked.
    const known = new Set(counts.map(([value]) => value));
    const missing = chosen.filter((value) => !known.has(value)).map((value) => [value, 0]);
    const ordered = [...counts, ...missing];
    const shown = ordered.filter(([value], i) => this.all || i < SHOWN || chosen.includes(value));
    const most = Math.max(1, ...counts.map(([, count]) => count));
    const wanted = shown.map(([value, count]) => {
      const line = this.line(value);
      line.box.checked = chosen.includes(value);
      line.count.textContent = number(count);
      line.element.style.setProperty("--share", String(count / most));
      return line.element;
    });
    // Move an element only if the order has changed: moving it loses the focus.
    wanted.forEach((element, i) => {
      if (this.list.children[i] !== element)
        this.list.insertBefore(element, this.list.children[i] ?? null);
    });
    while (this.list.children.length > wanted.length) this.list.lastChild.remove();
    this.more.hidden = ordered.length <= SHOWN;
    this.more.textContent = this.all ? "fewer" : `${ordered.length - shown.length} more`;
  }

  line(value) {
    const key = JSON.stringify(value);
    if (!this.lines.has(key)) {
      const box = h("input", {
        type: "checkbox",
        onchange: () => this.changed(value, box.checked),
      });
      const count = h("span", { class: "number" });
      const text = value === null ? "none" : value === "" ? "(empty)" : String(value);
      const element = h(
        "label",
        { class: value === null ? "value null" : "value" },
        box,
        h("span", { class: "name", text, title: text }),
        count,
      );
      this.lines.set(key, { element, box, count });
    }
    return this.lines.get(key);
  }

  changed(value, checked) {
    const chosen = (this.address.selection.facets[this.column.name] ?? []).filter(
      (v) => v !== value,
    );
    this.address.setFacet(this.column.name, checked ? [...chosen, value] : chosen);
  }

  toggle() {
    this.all = !this.all;
    this.show(this.counts, this.address.selection.facets[this.column.name] ?? []);
  }
}
