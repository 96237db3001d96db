// Elements built without markup: text from a dataset only ever becomes a text node.

/**
 * An element with attributes, listeners and children.
 *
 * @param {string} tag
 * @param {object} options attributes by name, with `text` for the content; functions under
 *   `onclick` and the like become listeners; true sets an empty attribute, false and null set none
 * @param {...(Node|string|null)} children strings become text nodes, null is skipped
 */
export function h(tag, options = {}, ...children) {
  return fill(document.createElement(tag), options, children);
}

/** Like `h`, for an SVG element. */
export function svg(tag, options = {}, ...children) {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", tag), options, children);
}

function fill(element, options, children) {
  for (const [name, value] of Object.entries(options)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "text") element.textContent = value;
    else if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** A button; `label` is its accessible name where the text alone is not enough. */
export function button(text, onclick, { label, ...more } = {}) {
  return h("button", { type: "button", "aria-label": label, title: label, onclick, text, ...more });
}

/** A choice of one among several, as a row of buttons: an element with a method `select(value)`. */
export function segments(label, choices, current, onchange) {
  const group = h("div", { class: "segments", role: "radiogroup", "aria-label": label });
  const buttons = choices.map(([value, text]) =>
    h("button", { type: "button", role: "radio", text, onclick: () => pick(value, true) }),
  );
  const pick = (value, said) => {
    choices.forEach(([other], i) => {
      buttons[i].setAttribute("aria-checked", String(other === value));
      buttons[i].tabIndex = other === value ? 0 : -1;
    });
    if (said) onchange(value);
  };
  group.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    const at = buttons.indexOf(event.target);
    if (!step || at < 0) return;
    event.preventDefault();
    event.stopPropagation();
    const next = (at + step + buttons.length) % buttons.length;
    buttons[next].focus();
    pick(choices[next][0], true);
  });
  group.append(...buttons);
  group.select = (value) => pick(value, false);
  pick(current, false);
  return group;
}

/** A labelled slider with its value beside it; returns {element, input, set}. */
export function slider(label, { min, max, step, value, write, oninput }) {
  const output = h("output", { class: "number" });
  const input = h("input", { type: "range", min, max, step, "aria-label": label });
  const show = () => {
    output.textContent = write(Number(input.value));
    input.setAttribute("aria-valuetext", output.textContent);
  };
  input.addEventListener("input", () => {
    show();
    oninput(Number(input.value));
  });
  const set = (to) => {
    input.value = to;
    show();
  };
  set(value);
  const element = h("label", { class: "slider" }, h("span", { text: label }), input, output);
  return { element, input, set };
}

/** A number for display: grouped thousands, four significant figures. */
export function number(value) {
  if (typeof value !== "number" || !Number.isFinite(value)) return String(value);
  if (Number.isInteger(value)) return value.toLocaleString("en");
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-3) return value.toPrecision(3);
  return String(Number(value.toPrecision(4)));
}

/** A size in bytes for display. */
export function bytes(value) {
  for (const unit of ["B", "kB", "MB"]) {
    if (value < 1000) return `${Number(value.toPrecision(3))} ${unit}`;
    value /= 1000;
  }
  return `${Number(value.toPrecision(3))} GB`;
}

/** A line of code with a button that copies it; `label` says what that does. */
export function command(text, label) {
  const code = h("code", { text });
  return h(
    "div",
    { class: "command" },
    code,
    copying("Copy", label, () => text, code),
  );
}

/**
 * A button that copies what `text()` returns or resolves to; it says so for a moment.
 *
 * @param {Element} shown what is selected instead where the clipboard may not be used
 */
export function copying(name, label, text, shown = null) {
  const copy = button(
    name,
    async () => {
      copy.disabled = true;
      let said = "Copied";
      try {
        await navigator.clipboard.writeText(await text());
      } catch (error) {
        said = shown ? "Selected" : error.message;
        if (shown) getSelection().selectAllChildren(shown);
      }
      copy.textContent = said;
      copy.disabled = false;
      setTimeout(() => {
        copy.textContent = name;
      }, 1500);
    },
    { label },
  );
  return copy;
}
