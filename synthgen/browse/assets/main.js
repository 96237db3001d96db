// The page: assembles the parts and follows the address.

import { askJson, query } from "./api.js";
import { button, h, number } from "./dom.js";
import { Export } from "./export.js";
import { Facets, said } from "./facets.js";
import { Grid } from "./grid.js";
import { listen } from "./keyboard.js";
import { Player } from "./player.js";
import { Address, parameters } from "./selection.js";
import { ShotView } from "./shot.js";
import { SubjectView } from "./subject.js";
import { Tags } from "./tags.js";
import { Toolbar } from "./toolbar.js";

const GROWING = 5000; // milliseconds between checks of a dataset that is being rendered

const byId = (id) => document.getElementById(id);
const address = new Address();
let dataset = null;
let view = null;
let counting = null;

const grid = new Grid(byId("grid"), {
  rows: (offset, limit, signal) =>
    askJson("/api/shots" + query({ ...parameters(address.selection), offset, limit }), { signal }),
  open: (row, index) => address.show("shot", row.subset, row.key, { at: String(index) }),
  href: (row, index) => address.href("shot", row.subset, row.key, { at: String(index) }),
  environment: (row) => {
    const wanted =
      Object.entries(address.selection.facets).find(([name]) =>
        name.startsWith("environment"),
      )?.[1] ?? [];
    return Math.max(
      0,
      (row.environments ?? []).findIndex((id) => wanted.includes(id)),
    );
  },
  caption: (row) => {
    const age = row.person_age_years ? `, ${Math.round(row.person_age_years)} years` : "";
    const { sort } = address.selection;
    const column = dataset.columns.find(({ name }) => name === sort);
    const found = row[sort] ?? null;
    const shown = typeof found === "number" ? number(found) : said(found, column);
    const value = sort && sort !== "key" ? shown : "";
    const from = Object.keys(dataset.plan).length > 1 ? row.subset : "";
    return { text: row.key, from, value, label: `${row.subset}/${row.key}${age}` };
  },
  picked: (row) => tags.has(row),
  pick: (row, index, range) => tags.pick(row, index, range),
  revision: () => dataset.revision,
  counted: (total) => {
    toolbar.count(total, dataset.shots);
    toolbar.showProblem(null);
    if (total) return;
    const title = dataset.shots ? "No shots match" : "No shots yet";
    grid.notice(
      title,
      dataset.shots
        ? "No shot in this dataset meets every condition. Remove one."
        : "The dataset is being rendered; shots appear here as they finish.",
    );
  },
  failed: (error) => {
    toolbar.showProblem(error.message);
    if (grid.total === null) grid.notice("This could not be shown", error.message);
  },
});
const toolbar = new Toolbar(byId("bar"), byId("chips"), address, {
  resize: (size) => grid.resize(size),
  filters: (shown) => byId("page").classList.toggle("filtering", shown),
  take: () => taking.open(),
  help: () => byId("help").showModal(),
});
const taking = new Export(byId("export"), address, () => grid.total);
const tags = new Tags(byId("marks"), byId("tag"), address, {
  grid,
  current: () => (view ? (view.shot ?? null) : (grid.known(grid.active) ?? null)),
  changed: (all) => {
    if (all || address.selection.tags.length) grid.refresh();
    view?.marked?.(all);
    count();
  },
});
const facets = new Facets(byId("facets"), address, () => count());

/** Counts and histograms of the selection, for the columns in open groups. */
async function count() {
  counting?.abort();
  counting = new AbortController();
  const columns = facets.wanted();
  try {
    facets.show(
      await askJson(
        "/api/counts" +
          query({
            ...parameters(address.selection),
            columns: columns.join(","),
            pairs: facets.pairs().join(","),
          }),
        { signal: counting.signal },
      ),
    );
  } catch (error) {
    // The toolbar reports a wrong condition (400).
    if (error.name !== "AbortError" && error.status !== 400) facets.fail(error);
  }
}

function select() {
  toolbar.show();
  tags.clear();
  grid.reset();
  count();
}

/** Opens the view named in the address. */
function open() {
  view?.close();
  view = null;
  tags.show();
  const { name, subset, id } = address.view;
  const place = byId("view");
  const inGrid = name === "grid";
  for (const one of ["bar", "page"]) byId(one).hidden = !inGrid;
  byId("chips").hidden = !inGrid || !byId("chips").childElementCount;
  place.hidden = inGrid;
  document.title = inGrid
    ? `${dataset.name} – synthgen browse`
    : `${subset}/${id} – ${dataset.name}`;
  if (inGrid) {
    place.replaceChildren();
    grid.resized();
    if (grid.total) grid.activate(grid.active);
    byId("grid").focus({ preventScroll: true });
    return;
  }
  place.replaceChildren(h("div", { class: "notice", text: "Loading…" }));
  place.scrollTop = 0;
  const fail = (error) =>
    place.replaceChildren(
      h(
        "header",
        { class: "viewbar" },
        button("‹ Grid", () => address.close(), { label: "Back to the grid" }),
      ),
      h(
        "div",
        { class: "notice", role: "alert" },
        h("h2", { text: "This could not be shown" }),
        h("p", { text: error.message }),
      ),
    );
  if (name === "shot") {
    const neighbour = (index) => grid.row(index);
    view = new ShotView(place, address, dataset, neighbour, tags, fail);
    const at = Number(address.view.options.at);
    if (Number.isInteger(at)) grid.active = at;
  } else if (name === "subject") view = new SubjectView(place, address, fail);
  else view = new Player(place, address, fail);
}

/** Checks whether a dataset that is being rendered has grown, and shows what is new. */
async function watch() {
  try {
    const now = await askJson("/api/dataset");
    const grown = now.revision !== dataset.revision;
    const columns = JSON.stringify(dataset.columns);
    dataset = { ...now };
    if (JSON.stringify(dataset.columns) !== columns) facets.build(dataset.columns);
    toolbar.state.textContent = state(now);
    if (grown) {
      grid.refresh();
      count();
      byId("status").textContent = `${now.shots} shots`;
    }
    toolbar.state.classList.remove("lost");
  } catch (error) {
    toolbar.state.textContent = error.message;
    toolbar.state.classList.add("lost");
  }
  if (state(dataset)) setTimeout(watch, GROWING);
}

/** Why a dataset is not complete yet, in two words; "" if it is. */
function state({ complete, ready }) {
  if (!complete) return "being rendered";
  return ready === false ? "being indexed" : "";
}

async function start() {
  try {
    dataset = await askJson("/api/dataset");
  } catch (error) {
    byId("page").replaceChildren(
      h(
        "div",
        { class: "notice", role: "alert" },
        h("h2", { text: "The dataset could not be opened" }),
        h("p", { text: error.message }),
        button("Try again", () => location.reload()),
      ),
    );
    return;
  }
  toolbar.build(dataset);
  facets.build(dataset.columns);
  listen(byId("help"), {
    take: () => taking.open(),
    tag: (key) => tags.key(key),
    search: () => {
      address.close();
      toolbar.where.focus();
      toolbar.where.select();
    },
    close: () => {
      if (byId("page").classList.contains("filtering")) toolbar.filter(false);
      else address.close();
    },
    view: () => view,
  });
  tags.load().catch((error) => tags.say(error.message));
  address.addEventListener("selection", select);
  address.addEventListener("view", open);
  select();
  open();
  toolbar.state.textContent = state(dataset);
  if (state(dataset)) setTimeout(watch, GROWING);
}

start();
