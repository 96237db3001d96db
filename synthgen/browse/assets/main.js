// The page: puts the parts together and follows the address.

import { askJson, query } from "./api.js";
import { Bar } from "./bar.js";
import { button, h, number } from "./dom.js";
import { Facets } from "./facets.js";
import { Grid } from "./grid.js";
import { listen } from "./keyboard.js";
import { Player } from "./player.js";
import { Address, parameters } from "./selection.js";
import { ShotView } from "./shot.js";
import { SubjectView } from "./subject.js";

const GROWING = 5000; // milliseconds between looks at a dataset that is being rendered

const part = (id) => document.getElementById(id);
const address = new Address();
let dataset = null;
let view = null;
let counting = null;

const grid = new Grid(part("grid"), {
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
    const value = sort && sort !== "key" ? number(row[sort] ?? "none") : "";
    return { text: row.key, value, label: `${row.subset}/${row.key}${age}` };
  },
  revision: () => dataset.revision,
  counted: (total) => {
    bar.count(total, dataset.shots);
    bar.say(null);
    if (total) return;
    const title = dataset.shots ? "Nothing is like that" : "No shots yet";
    grid.notice(
      title,
      dataset.shots
        ? "No shot of this dataset meets all conditions. Take one away."
        : "The dataset is being rendered; its shots appear here as they are finished.",
    );
  },
  failed: (error) => {
    bar.say(error.message);
    if (grid.total === null) grid.notice("This could not be shown", error.message);
  },
});
const bar = new Bar(part("bar"), part("chips"), address, {
  resize: (size) => grid.resize(size),
  filters: (shown) => part("page").classList.toggle("filtering", shown),
  help: () => part("help").showModal(),
});
const facets = new Facets(part("facets"), address, () => count());

/** Counts and histograms of the selection, of the columns that are in sight. */
async function count() {
  counting?.abort();
  counting = new AbortController();
  const columns = facets.wanted();
  if (!columns.length) return;
  try {
    facets.show(
      await askJson(
        "/api/counts" + query({ ...parameters(address.selection), columns: columns.join(",") }),
        { signal: counting.signal },
      ),
    );
  } catch (error) {
    // Of a wrong condition, 400, the bar speaks.
    if (error.name !== "AbortError" && error.status !== 400) facets.fail(error);
  }
}

function select() {
  bar.show();
  grid.reset();
  count();
}

/** Opens the view that the address names. */
function open() {
  view?.close();
  view = null;
  const { name, subset, id } = address.view;
  const place = part("view");
  const inGrid = name === "grid";
  for (const one of ["bar", "page"]) part(one).hidden = !inGrid;
  part("chips").hidden = !inGrid || !part("chips").childElementCount;
  place.hidden = inGrid;
  document.title = inGrid
    ? `${dataset.name} – synthgen browse`
    : `${subset}/${id} – ${dataset.name}`;
  if (inGrid) {
    place.replaceChildren();
    grid.resized();
    if (grid.total) grid.activate(grid.active);
    part("grid").focus({ preventScroll: true });
    return;
  }
  place.replaceChildren(h("div", { class: "notice", text: "Reading…" }));
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
    view = new ShotView(place, address, dataset, neighbour, fail);
    const at = Number(address.view.options.at);
    if (Number.isInteger(at)) grid.active = at;
  } else if (name === "subject") view = new SubjectView(place, address, fail);
  else view = new Player(place, address, fail);
}

/** Looks whether a dataset that is being rendered has grown, and shows what is new. */
async function watch() {
  try {
    const now = await askJson("/api/dataset");
    const grown = now.revision !== dataset.revision;
    dataset = { ...now };
    bar.state.textContent = state(now);
    if (grown) {
      grid.refresh();
      count();
      part("status").textContent = `${now.shots} shots`;
    }
    bar.state.classList.remove("lost");
  } catch (error) {
    bar.state.textContent = error.message;
    bar.state.classList.add("lost");
  }
  if (state(dataset)) setTimeout(watch, GROWING);
}

/** What is still to come of a dataset, in two words; "" of one that is whole. */
function state({ complete, ready }) {
  if (!complete) return "being rendered";
  return ready === false ? "being indexed" : "";
}

async function start() {
  try {
    dataset = await askJson("/api/dataset");
  } catch (error) {
    part("page").replaceChildren(
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
  bar.build(dataset);
  facets.build(dataset.columns);
  listen(part("help"), {
    search: () => {
      address.close();
      bar.where.focus();
      bar.where.select();
    },
    close: () => {
      if (part("page").classList.contains("filtering")) bar.filter(false);
      else address.close();
    },
    view: () => view,
  });
  address.addEventListener("selection", select);
  address.addEventListener("view", open);
  select();
  open();
  bar.state.textContent = state(dataset);
  if (state(dataset)) setTimeout(watch, GROWING);
}

start();
