// The dialog that hands a selection on: as Python, as a dataset of its own, as keys, CSV or Parquet.

import { ask, askJson, query } from "./api.js";
import { button, command, copying, h, number } from "./dom.js";
import { parameters } from "./selection.js";

const MOST_COPIED = 100_000; // keys: more are for a file

export class Export {
  /** @param address the page's `Address`  @param total returns how many rows are chosen */
  constructor(dialog, address, total) {
    Object.assign(this, { dialog, address, total });
  }

  async open() {
    const { selection } = this.address;
    const count = this.total();
    this.dialog.replaceChildren(
      h("h2", { text: `${number(count ?? 0)} shots, to take along` }),
      h("p", { class: "hint", text: "Loading…" }),
      this.close(),
    );
    this.dialog.showModal();
    let said;
    try {
      said = await askJson("/api/selection" + query(parameters(selection)));
    } catch (error) {
      this.dialog.children[1].replaceWith(h("p", { class: "problem", text: error.message }));
      return;
    }
    const file = (format) => "/rows" + query({ ...parameters(selection), format });
    const keys = copying("Copy keys", "Copy the keys of all these shots", async () => {
      if (count > MOST_COPIED) throw new Error("Too many to copy");
      return (await ask(file("keys"))).text();
    });
    const download = (format, text) =>
      h("a", { class: "button", href: file(format), download: "", text });
    this.dialog.children[1].replaceWith(
      h(
        "div",
        { class: "ways" },
        h("h3", { text: "In Python" }),
        command(said.python, "Copy the line of Python"),
        h("h3", { text: "As a dataset of its own" }),
        command(said.command, "Copy the command"),
        h("h3", { text: "As a table" }),
        h(
          "div",
          { class: "row" },
          keys,
          download("keys", "Keys"),
          download("csv", "CSV"),
          download("parquet", "Parquet"),
        ),
      ),
    );
  }

  close() {
    return button("Close", () => this.dialog.close());
  }
}
