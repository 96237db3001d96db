// The selection and the view, and the address bar that holds both.
//
// The query string is the selection as the server takes it, the fragment the view:
//     /?facets={"split":["test"]}&ranges={"head_yaw":[null,0]}#shot/multiview/s000001_p00?at=12

/** What "everything, as it comes" is. */
export const NOTHING = Object.freeze({
  facets: {},
  ranges: {},
  where: "",
  sort: "",
  descending: false,
});
export const GRID = Object.freeze({ name: "grid", subset: "", id: "", options: {} });
const VIEWS = ["shot", "subject", "play"];

/** The query parameters of a selection; what is not chosen is left out. */
export function parameters(selection) {
  const result = {};
  if (Object.keys(selection.facets).length) result.facets = JSON.stringify(selection.facets);
  if (Object.keys(selection.ranges).length) result.ranges = JSON.stringify(selection.ranges);
  if (selection.where) result.where = selection.where;
  if (selection.sort) result.sort = selection.sort;
  if (selection.sort && selection.descending) result.descending = "1";
  return result;
}

/** The selection of a query string; what cannot be read counts as not chosen. */
export function parseSelection(search) {
  const query = new URLSearchParams(search);
  return {
    facets: dictionary(query.get("facets"), (v) => Array.isArray(v) && v.length > 0),
    ranges: dictionary(query.get("ranges"), isRange),
    where: query.get("where") ?? "",
    sort: query.get("sort") ?? "",
    descending: query.get("descending") === "1",
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

/** The fragment of a view. */
export function fragment(view) {
  if (!VIEWS.includes(view.name)) return "";
  const options = new URLSearchParams(view.options).toString();
  const place = [view.name, view.subset, view.id].map(encodeURIComponent).join("/");
  return `#${place}${options && "?" + options}`;
}

/** The view of a fragment; what is no view is the grid. */
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

/** Selection and view of this page; says "selection" and "view" when they have changed. */
export class Address extends EventTarget {
  constructor() {
    super();
    this.read();
    // A token in the address has become a cookie: it is not to be sent on with the view.
    if (new URLSearchParams(location.search).has("token")) this.write("replaceState");
    addEventListener("popstate", () => {
      const before = JSON.stringify(parameters(this.selection));
      this.read();
      if (JSON.stringify(parameters(this.selection)) !== before) this.say("selection");
      this.say("view");
    });
  }

  read() {
    this.selection = parseSelection(location.search);
    this.view = parseView(location.hash);
  }

  /** Changes parts of the selection; each change is a step that Back undoes. */
  select(changes) {
    this.selection = { ...this.selection, ...changes };
    this.write("pushState");
    this.say("selection");
  }

  /** Chooses a facet's values; none is no choice. */
  choose(column, values) {
    const facets = { ...this.selection.facets };
    if (values.length) facets[column] = values;
    else delete facets[column];
    this.select({ facets });
  }

  /** Bounds a column; two nulls are no bound. */
  bound(column, low, high) {
    const ranges = { ...this.selection.ranges };
    if (low === null && high === null) delete ranges[column];
    else ranges[column] = [low, high];
    this.select({ ranges });
  }

  /** Goes to a view. */
  show(name, subset, id, options = {}) {
    this.view = { name, subset, id, options };
    this.write("pushState");
    this.say("view");
  }

  /** Notes how the present view is set, without a step in the history. */
  note(options) {
    this.view = { ...this.view, options: { ...this.view.options, ...options } };
    this.write("replaceState");
  }

  close() {
    if (this.view.name === "grid") return;
    this.view = GRID;
    this.write("pushState");
    this.say("view");
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

  say(what) {
    this.dispatchEvent(new Event(what));
  }
}
