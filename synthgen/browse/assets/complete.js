// Completion of an SQL condition: columns by any part of their names, and values after "column = '".

import { askJson, query } from "./api.js";
import { h } from "./dom.js";

const SHOWN = 8;

export class Completion {
  /** @param field the text field  @param columns as the server describes them */
  constructor(field, columns) {
    this.field = field;
    this.columns = columns.filter(({ name }) => /^\w+$/.test(name));
    this.values = new Map();
    this.options = [];
    this.list = h("ul", { class: "completion", role: "listbox", id: "completion", hidden: true });
    for (const [name, value] of Object.entries({
      role: "combobox",
      "aria-autocomplete": "list",
      "aria-controls": "completion",
      "aria-expanded": "false",
    }))
      field.setAttribute(name, value);
    field.addEventListener("input", () => this.suggest());
    field.addEventListener("blur", () => this.close());
    // Before the field's own: Enter accepts what is suggested only once it was chosen.
    field.addEventListener("keydown", (event) => this.key(event), { capture: true });
  }

  /** Suggests what may be meant at the caret. */
  async suggest() {
    const { selectionStart: caret } = this.field;
    const before = this.field.value.slice(0, caret);
    const asked = before;
    let found = [];
    const text = before.match(/(\w+)\s*(?:=|<>|!=|in\s*\((?:\s*'[^']*'\s*,)*|like)\s*'([^']*)$/i);
    if (text) {
      const known = await this.known(text[1]);
      const wanted = text[2].toLowerCase();
      found = known
        .filter((value) => value.toLowerCase().includes(wanted) && value !== text[2])
        .map((value) => ({ text: value, hint: "", from: caret - text[2].length, close: "'" }));
    } else if ((before.match(/'/g) ?? []).length % 2 === 0) {
      const word = before.match(/[A-Za-z_]\w*$/)?.[0].toLowerCase() ?? "";
      if (word.length > 1) found = this.named(word, caret - word.length);
    }
    if (before === asked && document.activeElement === this.field) this.show(found);
  }

  /** Columns with a word in their name or title: those that begin with it first. */
  named(word, from) {
    const rank = ({ name }) => (name.startsWith(word) ? 0 : name.includes(`_${word}`) ? 1 : 2);
    return this.columns
      .filter(({ name, title }) => `${name} ${title}`.toLowerCase().includes(word))
      .filter(({ name }) => name !== word)
      .sort((a, b) => rank(a) - rank(b))
      .map(({ name, title, unit }) => ({ text: name, hint: unit || title, from, close: "" }));
  }

  /** The values of a column of texts, the most frequent first. */
  async known(name) {
    const column = this.columns.find((c) => c.name === name.toLowerCase());
    if (column?.kind !== "facet" || column.type !== "text") return [];
    if (!this.values.has(name)) {
      try {
        const { facets } = await askJson("/api/counts" + query({ columns: column.name }));
        const values = facets[column.name].map(([value]) => value);
        this.values.set(
          name,
          values.filter((value) => typeof value === "string"),
        );
      } catch {
        return []; // it is only a help
      }
    }
    return this.values.get(name);
  }

  show(found) {
    this.options = found.slice(0, SHOWN);
    this.at = -1;
    this.list.replaceChildren(
      ...this.options.map((option, i) =>
        h(
          "li",
          {
            role: "option",
            id: `completion-${i}`,
            onpointerdown: (event) => {
              event.preventDefault(); // the field keeps the focus
              this.accept(i);
            },
          },
          h("code", { text: option.text }),
          h("span", { class: "hint", text: option.hint }),
        ),
      ),
    );
    this.list.hidden = !this.options.length;
    this.field.setAttribute("aria-expanded", String(!this.list.hidden));
    this.mark();
  }

  close() {
    this.show([]);
  }

  mark() {
    [...this.list.children].forEach((element, i) => {
      element.setAttribute("aria-selected", String(i === this.at));
    });
    if (this.at >= 0) this.field.setAttribute("aria-activedescendant", `completion-${this.at}`);
    else this.field.removeAttribute("aria-activedescendant");
  }

  accept(i) {
    const { text, from, close } = this.options[i];
    const { selectionStart: caret } = this.field;
    this.field.setRangeText(text + close, from, caret, "end");
    this.close();
  }

  key(event) {
    if (this.list.hidden) return;
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (step) {
      const count = this.options.length;
      this.at = this.at < 0 && step < 0 ? count - 1 : (this.at + step + count) % count;
      this.mark();
    } else if (event.key === "Tab" || (event.key === "Enter" && this.at >= 0)) {
      this.accept(Math.max(0, this.at));
    } else if (event.key === "Escape") {
      this.close();
    } else {
      return;
    }
    event.preventDefault();
    event.stopImmediatePropagation();
  }
}
