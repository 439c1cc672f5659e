// A map as an image: float32 values coloured in the browser, with the pixel under the pointer.

import { draw, make } from "./elements.js";

export class MapCanvas {
  // `pointed` is called with the place {column, row} in pixels of the reference image, or null; `clicked` with a click's.
  constructor(pointed, clicked) {
    this.canvas = make("canvas", { class: "map", tabindex: 0, role: "img" });
    this.marks = draw("svg", { preserveAspectRatio: "none" });
    this.element = make("div", { class: "picture" }, this.canvas, this.marks);
    this.pointed = pointed;
    this.index = null;
    this.canvas.addEventListener("pointermove", (event) => this.point(this.indexOf(event)));
    this.canvas.addEventListener("pointerleave", () => this.point(null));
    this.canvas.addEventListener("click", (event) => { this.point(this.indexOf(event)); if (this.place()) clicked(this.place()); });
    this.canvas.addEventListener("keydown", (event) => this.key(event, clicked));
  }

  // Colours a tile; `colours` are 256 times red, green, blue from `low` to `high`.
  show(tile, colours, low, high, label) {
    this.tile = tile;
    const { canvas } = this, { values, rows, columns } = tile;
    [canvas.width, canvas.height] = [columns, rows];
    this.element.style.setProperty("--aspect", columns / rows);
    canvas.setAttribute("aria-label", `${label}; the arrow keys move the pointer, Enter selects a point`);
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

  // Draws lines and points [column, row] over the map.
  mark(points) {
    const half = (this.tile?.spacing ?? 1) / 2, place = ([column, row]) => `${column + half},${row + half}`;
    this.marks.replaceChildren(...(points.length
      ? [draw("polyline", { class: "overlay", points: points.map(place).join(" ") }),
        ...points.map(([column, row]) => draw("circle", { class: "overlay corner", cx: column + half, cy: row + half, r: this.radius() }))]
      : []));
  }

  radius() {
    return (4 * this.canvas.width * (this.tile?.spacing ?? 1)) / Math.max(this.canvas.clientWidth, 1);
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
    if (event.key === "Enter" && this.place()) clicked(this.place());
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
