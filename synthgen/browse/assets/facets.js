// The filters beside the grid, in groups of columns. A column is a list of values with their
// counts, or a histogram. Only columns in open groups are requested.

import { Coverage } from "./coverage.js";
import { h, number } from "./dom.js";
import { Histogram } from "./histogram.js";
import { TagFilter } from "./tags.js";

const SHOWN = 8;
const OPEN = ["people", "dataset"]; // groups that are open initially
// Two columns that are covered, or not, together.
const MAPS = {
  light: ["light_azimuth", "light_elevation", "Where the key is"],
  camera: ["camera_yaw", "camera_pitch", "Where it is seen from"],
  head: ["head_yaw", "head_pitch", "How the head is turned"],
};

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
    const { facets, ranges } = this.address.selection;
    const chosen = ({ name }) => name in facets || name in ranges;
    const grouped = new Map();
    for (const column of columns) {
      // What all shots have in common is no choice.
      if (column.kind === "other" || (column.constant && !chosen(column))) continue;
      if (!grouped.has(column.group)) grouped.set(column.group, []);
      grouped.get(column.group).push(column);
    }
    const open = new Map(this.groups.map(({ name, details }) => [name, details.open]));
    this.parts.clear();
    this.maps = [];
    this.groups = [...grouped].map(([name, members]) => {
      const map = this.map(name, new Set(members.map((column) => column.name)));
      const parts = members.map((column) => this.part(column));
      const details = h(
        "details",
        {
          class: "group",
          open: open.get(name) ?? (OPEN.includes(name) || members.some(chosen)),
          ontoggle: () => this.onopen(),
        },
        h("summary", {}, h("span", { text: name }), h("span", { class: "chosen" })),
        map?.element,
        ...parts,
      );
      return { name, details, members, map };
    });
    this.problem = h("p", { class: "problem", role: "alert", hidden: true });
    this.element.replaceChildren(
      this.problem,
      this.tags.element,
      ...this.groups.map((group) => group.details),
    );
  }

  /** The map of a group's two angles, if it has both. */
  map(group, names) {
    const [x, y, title] = MAPS[group] ?? [];
    if (!names.has(x) || !names.has(y)) return null;
    const map = new Coverage(title, x, y, (ranges) => {
      this.address.select({
        ranges: { ...without(this.address.selection.ranges, x, y), ...ranges },
      });
    });
    this.maps.push(map);
    return map;
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

  /** Pairs of columns in open groups, of which maps are drawn. */
  pairs() {
    return this.groups
      .filter(({ details, map }) => details.open && map)
      .map(({ map }) => `${map.x}:${map.y}`);
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
    for (const pair of counts.pairs ?? []) {
      this.maps.find(({ x, y }) => x === pair.x && y === pair.y)?.show(pair, ranges);
    }
    for (const { details, members } of this.groups) {
      const chosen = members.filter((c) => c.name in facets || c.name in ranges).length;
      details.querySelector(".chosen").textContent = chosen ? String(chosen) : "";
    }
  }
}

/** A value in words: "south asian", "yes", "none". */
export function said(value, column) {
  if (value === null) return "none";
  if (value === "") return "(empty)";
  if (typeof value === "boolean") return value ? "yes" : "no";
  return column?.words ? String(value).replaceAll("_", " ") : String(value);
}

function without(ranges, ...names) {
  return Object.fromEntries(Object.entries(ranges).filter(([name]) => !names.includes(name)));
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
      const text = said(value, this.column);
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
