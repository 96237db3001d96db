// Keyboard shortcuts of the whole page, and the dialog that lists them.

import { button, h } from "./dom.js";

const KEYS = [
  ["/", "type an SQL condition"],
  ["Esc", "close, or leave a field"],
  ["← ↑ → ↓", "move in the grid; previous and next shot; turn the light"],
  ["Enter", "open the shot"],
  ["1, 2, …", "pass of the shot"],
  ["+, -, 0", "magnify the pictures of a shot; Ctrl and the wheel, then drag, do it too"],
  ["x", "pick a shot; Shift and a click pick all up to it"],
  ["s, r, t", "star, reject or tag what is picked, else the current shot"],
  ["u", "undo the last change of tags"],
  ["e", "take the selection along: Python, keys, CSV, Parquet"],
  ["Space", "play and pause a clip"],
  ["?", "show this list"],
];

/**
 * Listens for keys. `callbacks`: `search()` focuses the SQL field, `close()` leaves the view,
 * `take()` hands the selection on, `tag(key)` returns whether a key was one of tags,
 * `view()` returns the open view or null. A view's `key(event)` returns whether it handled the key.
 */
export function listen(help, callbacks) {
  help.append(
    h("h2", { text: "Keyboard shortcuts" }),
    h(
      "dl",
      {},
      ...KEYS.flatMap(([keys, text]) => [h("dt", {}, h("kbd", { text: keys })), h("dd", { text })]),
    ),
    button("Close", () => help.close()),
  );
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    if (document.querySelector("dialog[open]")) return;
    const field = event.target.closest?.("input, select, textarea");
    const writing = field && field.type !== "checkbox" && field.type !== "range";
    if (event.key === "Escape") {
      if (writing) field.blur();
      else callbacks.close();
    } else if (writing) {
      return;
    } else if (event.key === "/") {
      event.preventDefault();
      callbacks.search();
    } else if (event.key === "e" && !callbacks.view()) {
      event.preventDefault();
      callbacks.take();
    } else if (callbacks.tag(event.key)) {
      event.preventDefault();
    } else if (event.key === "?") {
      help.showModal();
    } else if (field && event.key.startsWith("Arrow")) {
      return; // a slider handles its own arrows
    } else if (event.key === " " && event.target.closest?.("button, summary, input")) {
      return;
    } else if (callbacks.view()?.key?.(event)) {
      event.preventDefault();
    }
  });
}
