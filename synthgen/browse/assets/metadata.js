// Everything a shot records, as a tree that the browser's own find can search.

import { bytes, h, number } from "./dom.js";

/** A section with all of meta.json, folded by key. */
export function metadata(meta) {
  const simple = Object.entries(meta).filter(([, value]) => !isTree(value));
  const trees = Object.entries(meta).filter(([, value]) => isTree(value));
  return h(
    "section",
    { class: "panel", "aria-label": "Metadata" },
    h("h2", { text: "Metadata" }),
    table(simple),
    ...trees.map(([name, value]) => branch(name, value)),
  );
}

/** Members of a shot as downloads, with name and size. */
export function members(list) {
  return h(
    "section",
    { class: "panel", "aria-label": "Files" },
    h("h2", { text: "Files" }),
    h(
      "ul",
      { class: "members" },
      ...list.map(({ name, bytes: size, url }) =>
        h(
          "li",
          {},
          h("a", { href: local(url), download: name, text: name }),
          h("span", { class: "number", text: bytes(size) }),
        ),
      ),
    ),
  );
}

/** An address on this server, or null: a dataset never links elsewhere. */
function local(url) {
  const address = new URL(url, location.origin);
  return address.origin === location.origin ? address.pathname + address.search : null;
}

function isTree(value) {
  return value !== null && typeof value === "object" && !isShort(value);
}

function isShort(value) {
  return (
    Array.isArray(value) &&
    value.length <= 4 &&
    value.every((v) => v === null || typeof v !== "object")
  );
}

function branch(name, value) {
  const size = Array.isArray(value) ? value.length : Object.keys(value).length;
  const details = h(
    "details",
    { class: "branch" },
    h("summary", {}, h("span", { text: name }), h("span", { class: "number", text: String(size) })),
  );
  // Filled when first opened: a shot records thousands of numbers.
  details.addEventListener("toggle", () => {
    if (!details.open || details.children.length > 1) return;
    const entries = Object.entries(value);
    details.append(
      table(entries.filter(([, item]) => !isTree(item))),
      ...entries.filter(([, item]) => isTree(item)).map(([key, item]) => branch(key, item)),
    );
  });
  return details;
}

function table(entries) {
  return h(
    "dl",
    { class: "table" },
    ...entries.flatMap(([name, value]) => [
      h("dt", { text: name }),
      h("dd", { class: typeof value === "string" ? "" : "number", text: write(value) }),
    ]),
  );
}

function write(value) {
  if (Array.isArray(value)) return value.map(write).join(", ");
  // Seeds and ids are names, not amounts: no thousands separators.
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : number(value);
  return String(value);
}
