// Tags: stars, rejects and words of one's own, given to the current shot, to picked ones, or to all.

import { askJson, query } from "./api.js";
import { button, h, number } from "./dom.js";
import { parameters } from "./selection.js";

const FEW = 2000; // shots that are picked at once with Shift
const LONG = 8000; // milliseconds that an answer stays
const NAMED = { star: "★", reject: "⊘" };

/** Shots as words: "1 shot", "2,340 shots". */
const shots = (count) => `${number(count)} ${count === 1 ? "shot" : "shots"}`;

/** Which picture of a cell says that a shot has these tags. */
export function badges(tags) {
  return (tags ?? []).map((tag) =>
    h("span", { class: `badge ${tag in NAMED ? tag : ""}`, text: NAMED[tag] ?? tag, title: tag }),
  );
}

export class Tags {
  /**
   * @param element where the bar of picked shots appears
   * @param dialog in which a tag is named
   * @param address the page's `Address`
   * @param callbacks `current()` the row of the current shot, or null; `grid` the `Grid`;
   *   `changed(all)` after a change, of shots that are not known singly if `all`
   */
  constructor(element, dialog, address, callbacks) {
    Object.assign(this, { element, dialog, address, ...callbacks });
    this.picked = new Map();
    this.known = [];
    this.writable = false;
  }

  async load() {
    this.learn(await askJson("/api/tags"));
    if (this.problems?.length) this.say(this.problems[0]);
  }

  learn({ person, writable, tags, problems }) {
    Object.assign(this, { person, writable, known: tags.map(([name]) => name), problems });
    document.body.classList.toggle("writable", writable);
  }

  has(row) {
    return this.picked.has(`${row.subset}/${row.key}`);
  }

  /** Picks a shot, or no longer; with `range` all from the one picked last. */
  async pick(row, index, range = false) {
    if (!this.writable || row.failed) return;
    const wanted = [];
    if (range && this.last !== undefined) {
      const [from, to] = [this.last, index].sort((a, b) => a - b);
      for (let i = from; i <= Math.min(to, from + FEW); i++) wanted.push(await this.grid.row(i));
      for (const one of wanted.filter((r) => r && !r.failed)) this.put(one);
    } else if (this.has(row)) {
      this.picked.delete(`${row.subset}/${row.key}`);
    } else {
      this.put(row);
    }
    this.last = index;
    this.show();
  }

  put(row) {
    this.picked.set(`${row.subset}/${row.key}`, row);
  }

  clear() {
    this.picked.clear();
    this.message = null;
    this.show();
  }

  /** The rows that a change is about: those picked, else the current one. */
  targets() {
    const row = this.current();
    if (this.picked.size && !this.alone()) return [...this.picked.values()];
    return row && !row.failed ? [row] : [];
  }

  /** Whether one shot is open by itself, so that what is picked does not matter. */
  alone() {
    return this.address.view.name !== "grid";
  }

  /** Gives a tag to the targets, or takes it if all of them have it from this person. */
  toggle(tag) {
    const rows = this.targets();
    if (!rows.length) return this.say("Pick a shot first.");
    const all = rows.every((row) => row.mine?.includes(tag));
    return this.change(all ? "remove" : "add", tag, rows);
  }

  async change(action, tag, rows) {
    const keys = rows.map(({ subset, key }) => `${subset}/${key}`);
    await this.send("/api/tags", { [action]: tag, shots: keys }, rows, ({ changed }) =>
      this.told(action === "add", tag, changed),
    );
  }

  /** Gives a tag to every shot of the selection. */
  async changeAll(action, tag) {
    const selection = query(parameters(this.address.selection));
    await this.send("/api/tags", { [action]: tag, selection }, null, ({ changed }) =>
      this.told(action === "add", tag, changed),
    );
  }

  async undo() {
    await this.send("/api/tags/undo", {}, null, ({ undone }) => [
      `Undone: ${this.told(undone.added, undone.tag, undone.shots)[0]}`,
      false,
    ]);
  }

  told(added, tag, count) {
    const done = { star: ["Starred", "No longer starred"], reject: ["Rejected", "Accepted again"] };
    const [yes, no] = done[tag] ?? [`Tagged “${tag}”`, `No longer “${tag}”`];
    return [`${added ? yes : no}: ${shots(count)}`, count > 0];
  }

  async send(place, body, rows, words) {
    if (!this.writable) return this.say("Tags are read-only here.");
    try {
      const answer = await askJson(place, {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify(body),
      });
      this.learn(answer);
      for (const row of rows ?? []) Object.assign(row, answer.marks?.[`${row.subset}/${row.key}`]);
      this.say(...words(answer));
      this.changed(!rows || !answer.marks);
    } catch (error) {
      this.say(error.message);
    }
  }

  /** Says what was done, for a while; `undoable` offers to take it back. */
  say(message, undoable = false) {
    this.message = { text: message, undoable };
    clearTimeout(this.wait);
    this.wait = setTimeout(() => {
      this.message = null;
      this.show();
    }, LONG);
    this.show();
  }

  /** The bar: how many shots are picked and what to do with them, and what was done last. */
  show() {
    const count = this.picked.size;
    const picking = count > 0 && !this.alone();
    this.element.hidden = !picking && !this.message;
    document.body.classList.toggle("picking", picking);
    const parts = picking
      ? [
          h("span", { class: "number", text: `${number(count)} picked` }),
          ...this.buttons(),
          button("None", () => this.clear(), { label: "Pick no shot" }),
        ]
      : [];
    if (this.message) {
      parts.push(h("span", { class: "said", role: "status", text: this.message.text }));
      if (this.message.undoable)
        parts.push(button("Undo", () => this.undo(), { label: "Undo the last change (u)" }));
    }
    this.element.replaceChildren(...parts);
    this.grid.mark();
  }

  /** Buttons that tag the targets. */
  buttons() {
    return [
      button("★ Star", () => this.toggle("star"), { label: "Star, or no longer (s)" }),
      button("⊘ Reject", () => this.toggle("reject"), { label: "Reject, or no longer (r)" }),
      button("Tag…", () => this.name(), { label: "Tag with a word of your own (t)" }),
    ];
  }

  /** Opens the dialog in which a tag is named, for the targets or the whole selection. */
  name() {
    if (!this.writable) return this.say("Tags are read-only here.");
    const rows = this.targets();
    const total = this.grid.total ?? 0;
    const field = h("input", {
      type: "text",
      list: "known-tags",
      maxlength: "40",
      pattern: "[A-Za-z0-9][A-Za-z0-9_.\\-]*",
      required: true,
      "aria-label": "Tag",
      placeholder: "such as eyes-closed",
    });
    const all = h("input", { type: "checkbox", checked: !rows.length });
    const act = (action) => {
      if (!field.reportValidity()) return;
      this.dialog.close();
      if (all.checked) this.changeAll(action, field.value);
      else if (rows.length) this.change(action, field.value, rows);
    };
    this.dialog.replaceChildren(
      h("h2", { text: "Tag" }),
      h(
        "form",
        {
          class: "ways",
          onsubmit: (event) => {
            event.preventDefault();
            act("add");
          },
        },
        field,
        h("datalist", { id: "known-tags" }, ...this.known.map((value) => h("option", { value }))),
        rows.length
          ? h("p", { class: "hint", text: rows.length > 1 ? shots(rows.length) : rows[0].key })
          : null,
        this.alone()
          ? null
          : h("label", { class: "check" }, all, `All ${shots(total)} of the selection`),
        h("p", { class: "hint", text: `Given by ${this.person}. Letters, digits, _ - and .` }),
        h(
          "div",
          { class: "row" },
          button("Tag", null, { type: "submit", class: "primary" }),
          button("Take the tag away", () => act("remove")),
          button("Cancel", () => this.dialog.close()),
        ),
      ),
    );
    this.dialog.showModal();
    field.focus();
  }

  /** Handles a key; returns whether it was one of tags. */
  key(key) {
    const act = {
      s: () => this.toggle("star"),
      r: () => this.toggle("reject"),
      t: () => this.name(),
      u: () => this.undo(),
      x: () => {
        const row = this.alone() ? null : this.current();
        if (row) this.pick(row, this.grid.active);
      },
    }[key];
    act?.();
    return Boolean(act);
  }
}

/** The filter by tags: each is asked for, ruled out, or neither. */
export class TagFilter {
  constructor(address) {
    this.address = address;
    this.list = h("div", { class: "facet tagged" });
    this.element = h(
      "details",
      { class: "group", open: true, hidden: true },
      h("summary", {}, h("span", { text: "Tags" }), h("span", { class: "chosen" })),
      this.list,
    );
  }

  show(counts = []) {
    const { tags } = this.address.selection;
    const missing = tags
      .map((t) => t.replace(/^-/, ""))
      .filter((t) => !counts.some(([n]) => n === t));
    const lines = [...counts, ...missing.map((tag) => [tag, 0])];
    this.element.hidden = !lines.length;
    this.element.querySelector(".chosen").textContent = tags.length ? String(tags.length) : "";
    this.list.replaceChildren(
      ...lines.map(([tag, count]) =>
        h(
          "div",
          { class: "value" },
          h("span", { class: "name", text: `${NAMED[tag] ?? ""} ${tag}`.trim(), title: tag }),
          h("span", { class: "number", text: number(count) }),
          this.choice("with", tag, tag),
          this.choice("without", tag, `-${tag}`),
        ),
      ),
    );
  }

  choice(text, tag, wish) {
    const { tags } = this.address.selection;
    const on = tags.includes(wish);
    return button(
      text,
      () => {
        const others = tags.filter((t) => t.replace(/^-/, "") !== tag);
        this.address.select({ tags: on ? others : [...others, wish] });
      },
      { label: `Only shots ${text} ${tag}`, "aria-pressed": String(on), class: "wish" },
    );
  }
}
