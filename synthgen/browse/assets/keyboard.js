// Keys of the whole page, and the list of them.

import { button, h } from "./dom.js";

const KEYS = [
  ["/", "write an SQL condition"],
  ["Esc", "close, or leave a field"],
  ["← ↑ → ↓", "move in the grid; previous and next shot; turn the light"],
  ["Enter", "open the shot"],
  ["1, 2, …", "pass of the shot"],
  ["Space", "play and pause a clip"],
  ["?", "this list"],
];

/**
 * Listens for keys. `calls`: `search()` focuses the SQL field, `close()` leaves the view,
 * `view()` the view that is open or null: its `key(event)` says whether it took the key.
 */
export function listen(help, calls) {
  help.append(
    h("h2", { text: "Keyboard" }),
    h(
      "dl",
      {},
      ...KEYS.flatMap(([keys, text]) => [h("dt", {}, h("kbd", { text: keys })), h("dd", { text })]),
    ),
    button("Close", () => help.close()),
  );
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented || help.open)
      return;
    const field = event.target.closest?.("input, select, textarea");
    const writing = field && field.type !== "checkbox" && field.type !== "range";
    if (event.key === "Escape") {
      if (writing) field.blur();
      else calls.close();
    } else if (writing) {
      return;
    } else if (event.key === "/") {
      event.preventDefault();
      calls.search();
    } else if (event.key === "?") {
      help.showModal();
    } else if (field && event.key.startsWith("Arrow")) {
      return; // a slider takes its own arrows
    } else if (event.key === " " && event.target.closest?.("button, summary, input")) {
      return;
    } else if (calls.view()?.key?.(event)) {
      event.preventDefault();
    }
  });
}
