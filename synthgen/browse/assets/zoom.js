// Zoom and pan of the pictures of a shot, all of them together: wheel or + and -, drag, double click.

const MOST = 24;

export class Zoom {
  /** @param element whose `--zoom`, `--x`, `--y` the pictures in it follow  @param moved called after */
  constructor(element, moved) {
    this.element = element;
    this.moved = moved;
    this.pointers = new Map();
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel", "pointerleave"])
      element.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    element.addEventListener("dblclick", (event) => {
      if (event.target.closest(".plate")) this.set(1, 0, 0);
    });
    this.set(1, 0, 0);
  }

  /** Scale, and offset of the centre in shares of a picture's side. */
  set(scale, x, y) {
    const room = (scale - 1) / 2;
    const inside = (value) => Math.max(-room, Math.min(room, value));
    Object.assign(this, { scale, x: inside(x), y: inside(y) });
    const { style } = this.element;
    style.setProperty("--zoom", String(scale));
    style.setProperty("--x", `${this.x * 100}%`);
    style.setProperty("--y", `${this.y * 100}%`);
    this.element.classList.toggle("zoomed", scale > 1);
    this.moved();
  }

  /** Scales by a factor about a point, given in shares of the picture from its centre. */
  by(factor, px = 0, py = 0) {
    const scale = Math.max(1, Math.min(MOST, this.scale * factor));
    const grown = scale / this.scale;
    this.set(scale, px - (px - this.x) * grown, py - (py - this.y) * grown);
  }

  place(event) {
    const box = event.target.closest(".plate").getBoundingClientRect();
    return [
      (event.clientX - box.left) / box.width - 0.5,
      (event.clientY - box.top) / box.height - 0.5,
    ];
  }

  wheel(event) {
    // A plain wheel scrolls the page until a picture is zoomed; with Ctrl, as a pinch is, it zooms.
    if (!event.target.closest(".plate") || (!event.ctrlKey && this.scale === 1)) return;
    event.preventDefault();
    this.by(2 ** (-event.deltaY / 240), ...this.place(event));
  }

  down(event) {
    if (event.target.closest(".plate")) this.pointers.set(event.pointerId, event);
  }

  move(event) {
    const last = this.pointers.get(event.pointerId);
    if (!last || this.scale === 1 || !event.target.closest(".plate")) return;
    this.pointers.set(event.pointerId, event);
    if (this.pointers.size > 1) return;
    const box = event.target.closest(".plate").getBoundingClientRect();
    const dx = (event.clientX - last.clientX) / box.width;
    const dy = (event.clientY - last.clientY) / box.height;
    this.set(this.scale, this.x + dx, this.y + dy);
  }
}
