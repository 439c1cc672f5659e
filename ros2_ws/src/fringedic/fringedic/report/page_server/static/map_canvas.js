// A map as an image: float32 values coloured in the browser, with the pixel under the pointer.

import { draw, make } from "./elements.js";
import { t } from "./language.js";

const LARGEST = 40; // magnification
const DRAGGED_PX = 4; // on the screen, from which a press moves the map and is no click

export class MapCanvas {
  // `pointed` is called with the place {column, row} in pixels of the reference image, or null; `clicked` with a click's.
  constructor(pointed, clicked) { // also with the number of clicks at one place
    this.canvas = make("canvas", { class: "map", tabindex: 0, role: "img" });
    this.below = make("canvas", { class: "below", hidden: true, "aria-hidden": "true" });
    this.marks = draw("svg", { preserveAspectRatio: "none" });
    this.moved = make("div", { class: "moved" }, this.below, this.canvas, this.marks);
    this.element = make("div", { class: "picture zoomed" }, this.moved);
    this.pointed = pointed;
    this.index = null;
    [this.scale, this.offset, this.pressed] = [1, [0, 0], null];
    this.drawn = { points: [], kept: [], lines: "" };
    this.canvas.addEventListener("pointermove", (event) => { this.drag(event); this.point(this.indexOf(event)); });
    this.canvas.addEventListener("pointerleave", () => this.point(null));
    this.canvas.addEventListener("pointerdown", (event) => { this.pressed = { at: [event.clientX, event.clientY], offset: this.offset, isDrag: false }; });
    this.canvas.addEventListener("click", (event) => {
      const isDrag = this.pressed?.isDrag;
      this.pressed = null;
      this.point(this.indexOf(event));
      if (!isDrag && this.place()) clicked(this.place(), event.detail);
    });
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const box = this.element.getBoundingClientRect();
      this.zoom(Math.exp(-0.002 * event.deltaY), [event.clientX - box.left, event.clientY - box.top]);
    }, { passive: false });
    this.canvas.addEventListener("keydown", (event) => this.key(event, clicked));
  }

  // Magnifies about a place of the element, or its middle; a factor of 0 shows the whole map.
  zoom(factor, at = [this.element.clientWidth / 2, this.element.clientHeight / 2]) {
    const scale = Math.min(Math.max(this.scale * factor, 1), LARGEST), ratio = scale / this.scale;
    this.scale = scale;
    this.move(this.offset.map((value, k) => at[k] - ratio * (at[k] - value)));
    this.redraw();
  }

  move(offset) {
    const size = [this.element.clientWidth, this.element.clientHeight];
    this.offset = offset.map((value, k) => Math.min(Math.max(value, size[k] * (1 - this.scale)), 0));
    this.moved.style.transform = `translate(${this.offset[0]}px, ${this.offset[1]}px) scale(${this.scale})`;
  }

  drag(event) {
    if (!this.pressed || !(event.buttons & 1) || this.scale === 1) return;
    const way = [event.clientX - this.pressed.at[0], event.clientY - this.pressed.at[1]];
    if (Math.hypot(...way) > DRAGGED_PX) this.pressed.isDrag = true;
    if (this.pressed.isDrag) this.move(this.pressed.offset.map((value, k) => value + way[k]));
  }

  // Shows a tile in grey below the map, which is then transparent; null: none.
  showBelow(tile, [low, high] = [0, 1]) {
    this.below.hidden = !tile;
    this.canvas.classList.toggle("over", Boolean(tile));
    if (!tile) return;
    [this.below.width, this.below.height] = [tile.columns, tile.rows];
    const image = new ImageData(tile.columns, tile.rows);
    tile.values.forEach((value, i) => {
      const grey = Math.min(Math.max((255 * (value - low)) / (high - low || 1), 0), 255);
      image.data.set([grey, grey, grey, Number.isNaN(value) ? 0 : 255], 4 * i);
    });
    this.below.getContext("2d").putImageData(image, 0, 0);
  }

  // Colours a tile; `colours` are 256 times red, green, blue from `low` to `high`.
  show(tile, colours, low, high, label) {
    this.tile = tile;
    const { canvas } = this, { values, rows, columns } = tile;
    [canvas.width, canvas.height] = [columns, rows];
    this.element.style.setProperty("--aspect", columns / rows);
    canvas.setAttribute("aria-label", t("{map}; the arrow keys move the pointer, Enter selects a point, plus and minus magnify", { map: label }));
    this.marks.setAttribute("viewBox", `0 0 ${columns * tile.spacing} ${rows * tile.spacing}`);
    const image = new ImageData(columns, rows), scale = 256 / (high - low || 1);
    for (let i = 0; i < values.length; i++) {
      if (Number.isNaN(values[i])) continue; // transparent: not measured
      const at = 3 * colourIndex(values[i], low, scale);
      image.data.set([colours[at], colours[at + 1], colours[at + 2], 255], 4 * i);
    }
    canvas.getContext("2d").putImageData(image, 0, 0);
    this.pointed(this.place());
  }

  clear() {
    this.tile = null;
    this.canvas.removeAttribute("aria-label");
    this.canvas.getContext("2d").clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.marks.replaceChildren();
  }

  // Draws the points [column, row] that are chosen, the marks that are kept, and isolines (a path) over the map.
  mark(points, { kept = this.drawn.kept, lines = this.drawn.lines, closed = false } = {}) {
    this.drawn = { points, kept, lines, closed };
    this.redraw();
  }

  redraw() {
    const { points, kept, lines, closed } = this.drawn, half = (this.tile?.spacing ?? 1) / 2, place = ([column, row]) => `${column + half},${row + half}`;
    const shape = (corners, isClosed, style) => [
      draw(isClosed ? "polygon" : "polyline", { class: `overlay ${style}`, points: corners.map(place).join(" ") }),
      ...corners.map(([column, row]) => draw("circle", { class: `overlay corner ${style}`, cx: column + half, cy: row + half, r: this.radius() }))];
    const named = ({ name, points: [[column, row]] }) => draw("text", { class: "overlay name", x: column + half + 2 * this.radius(), y: row + half - 2 * this.radius(), "font-size": 3.5 * this.radius() }, name);
    this.marks.replaceChildren(...(lines ? [draw("path", { class: "isoline", d: lines })] : []),
      ...kept.flatMap((mark) => [...shape(mark.points, mark.kind === "area", "kept"), named(mark)]), ...(points.length ? shape(points, closed, "") : []));
  }

  radius() {
    return (4 * this.canvas.width * (this.tile?.spacing ?? 1)) / Math.max(this.canvas.clientWidth, 1) / this.scale;
  }

  indexOf(event) {
    const box = this.canvas.getBoundingClientRect();
    return this.limited(Math.floor(((event.clientX - box.left) / box.width) * this.canvas.width),
      Math.floor(((event.clientY - box.top) / box.height) * this.canvas.height));
  }

  limited(column, row) {
    const inside = (value, size) => Math.min(Math.max(value, 0), size - 1);
    return [inside(column, this.canvas.width), inside(row, this.canvas.height)];
  }

  point(index) {
    this.index = index;
    this.pointed(this.place());
  }

  place() {
    if (!this.index || !this.tile) return null;
    const [column, row] = this.limited(...this.index), { spacing } = this.tile;
    return { column: column * spacing, row: row * spacing };
  }

  key(event, clicked) {
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const pace = event.shiftKey ? 10 : 1;
    if (event.key === "Enter" && this.place()) clicked(this.place(), 1);
    else if (event.key === "+" || event.key === "-") this.zoom(event.key === "+" ? 1.5 : 1 / 1.5);
    else if (event.key in moves) {
      const [column, row] = this.index ?? [this.canvas.width >> 1, this.canvas.height >> 1];
      this.point(this.limited(column + pace * moves[event.key][0], row + pace * moves[event.key][1]));
    } else return;
    event.preventDefault();
  }
}

const colourIndex = (value, low, scale) => Math.min(Math.max(Math.floor((value - low) * scale), 0), 255);

export const valueAt = (tile, { column, row }) =>
  tile.values[Math.floor(row / tile.spacing) * tile.columns + Math.floor(column / tile.spacing)];

// Limits that leave out two percent of the values at each end.
export function usualRange(values) {
  const known = values.filter((value) => !Number.isNaN(value)).sort();
  if (!known.length) return [0, 1];
  return [known[Math.floor(0.02 * (known.length - 1))], known[Math.ceil(0.98 * (known.length - 1))]];
}

// The middle one of the values that are known, NaN without any.
export function median(values) {
  const known = values.filter((value) => !Number.isNaN(value)).sort();
  return known.length ? known[known.length >> 1] : NaN;
}

// Draws the colours of a palette from left to right.
export function colourBar(canvas, colours) {
  const image = new ImageData(256, 1);
  for (let i = 0; i < 256; i++) image.data.set([...colours.slice(3 * i, 3 * i + 3), 255], 4 * i);
  canvas.getContext("2d").putImageData(image, 0, 0);
}
