// The selection and the view, both kept in the address bar.
//
// The query string is the selection as the server takes it, the fragment the view:
//     /?facets={"split":["test"]}&ranges={"head_yaw":[null,0]}#shot/multiview/s000001_p00?at=12

/** The selection of everything, in stored order. */
export const NOTHING = Object.freeze({
  facets: {},
  ranges: {},
  where: "",
  sort: "",
  descending: false,
  tags: [],
});
export const GRID = Object.freeze({ name: "grid", subset: "", id: "", options: {} });
const VIEWS = ["shot", "subject", "play"];

/** The query parameters of a selection, without those at their defaults. */
export function parameters(selection) {
  const result = {};
  if (Object.keys(selection.facets).length) result.facets = JSON.stringify(selection.facets);
  if (Object.keys(selection.ranges).length) result.ranges = JSON.stringify(selection.ranges);
  if (selection.where) result.where = selection.where;
  if (selection.sort) result.sort = selection.sort;
  if (selection.sort && selection.descending) result.descending = "1";
  if (selection.tags.length) result.tags = JSON.stringify(selection.tags);
  return result;
}

/** The selection in a query string; what cannot be parsed is ignored. */
export function parseSelection(search) {
  const query = new URLSearchParams(search);
  return {
    facets: dictionary(query.get("facets"), (v) => Array.isArray(v) && v.length > 0),
    ranges: dictionary(query.get("ranges"), isRange),
    where: query.get("where") ?? "",
    sort: query.get("sort") ?? "",
    descending: query.get("descending") === "1",
    tags: list(query.get("tags")),
  };
}

function isRange(value) {
  const bound = (end) => end === null || Number.isFinite(end);
  return Array.isArray(value) && value.length === 2 && value.every(bound);
}

function dictionary(text, holds) {
  try {
    const value = JSON.parse(text ?? "{}");
    if (typeof value !== "object" || value === null || Array.isArray(value)) return {};
    return Object.fromEntries(Object.entries(value).filter(([, item]) => holds(item)));
  } catch {
    return {};
  }
}

/** The texts in a JSON list; what is none is ignored. */
function list(text) {
  try {
    const value = JSON.parse(text ?? "[]");
    return Array.isArray(value) ? value.filter((item) => typeof item === "string") : [];
  } catch {
    return [];
  }
}

/** The fragment of a view. */
export function fragment(view) {
  if (!VIEWS.includes(view.name)) return "";
  const options = new URLSearchParams(view.options).toString();
  const place = [view.name, view.subset, view.id].map(encodeURIComponent).join("/");
  return `#${place}${options && "?" + options}`;
}

/** The view in a fragment; the grid if there is none. */
export function parseView(hash) {
  const [place, options] = hash.replace(/^#/, "").split("?");
  let names;
  try {
    names = place.split("/").map(decodeURIComponent);
  } catch {
    return GRID;
  }
  const [name, subset, id] = names;
  if (names.length !== 3 || !VIEWS.includes(name) || !subset || !id) return GRID;
  return { name, subset, id, options: Object.fromEntries(new URLSearchParams(options ?? "")) };
}

/** Selection and view of this page; dispatches "selection" and "view" when they change. */
export class Address extends EventTarget {
  constructor() {
    super();
    this.read();
    // A token in the address is a cookie by now: drop it, lest it be shared along with the view.
    if (new URLSearchParams(location.search).has("token")) this.write("replaceState");
    addEventListener("popstate", () => {
      const before = JSON.stringify(parameters(this.selection));
      this.read();
      if (JSON.stringify(parameters(this.selection)) !== before) this.emit("selection");
      this.emit("view");
    });
  }

  read() {
    this.selection = parseSelection(location.search);
    this.view = parseView(location.hash);
  }

  /** Changes parts of the selection; each change is a step in the history. */
  select(changes) {
    this.selection = { ...this.selection, ...changes };
    this.write("pushState");
    this.emit("selection");
  }

  /** Sets a facet's values; an empty list removes the facet. */
  setFacet(column, values) {
    const facets = { ...this.selection.facets };
    if (values.length) facets[column] = values;
    else delete facets[column];
    this.select({ facets });
  }

  /** Sets a column's range; two nulls remove it. */
  setRange(column, low, high) {
    const ranges = { ...this.selection.ranges };
    if (low === null && high === null) delete ranges[column];
    else ranges[column] = [low, high];
    this.select({ ranges });
  }

  /** Opens a view. */
  show(name, subset, id, options = {}) {
    this.view = { name, subset, id, options };
    this.write("pushState");
    this.emit("view");
  }

  /** Sets options of the current view without a step in the history. */
  setOptions(options) {
    this.view = { ...this.view, options: { ...this.view.options, ...options } };
    this.write("replaceState");
  }

  close() {
    if (this.view.name === "grid") return;
    this.view = GRID;
    this.write("pushState");
    this.emit("view");
  }

  /** The address of a view in this selection. */
  href(name, subset, id, options = {}) {
    const search = new URLSearchParams(parameters(this.selection)).toString();
    return `/${search && "?" + search}${fragment({ name, subset, id, options })}`;
  }

  write(method) {
    const { name, subset, id, options } = this.view;
    history[method](null, "", this.href(name, subset, id, options));
  }

  emit(name) {
    this.dispatchEvent(new Event(name));
  }
}
