// Draws the region to be measured on the live image: polygon, rectangle, hole, undo.

import { make } from "./elements.js";
import { LiveImage } from "./live_image.js";
import { command, say } from "./server.js";

export class RegionEditor {
  constructor() {
    this.image = new LiveImage();
    this.polygons = [];
    this.open = null; // the polygon that is being drawn
    this.image.canvas.tabIndex = 0;
    this.image.canvas.style.cursor = "crosshair";
    this.image.canvas.addEventListener("click", (event) => this.add(this.image.place(event)));
    this.image.canvas.addEventListener("keydown", (event) => this.key(event));
    const tool = (id, text, action) => make("button", { id, onclick: () => { action(); this.paint(); } }, text);
    this.cursor = null;
    this.element = make("div", {}, make("div", { class: "row" },
      tool("polygon", "Polygon", () => this.begin({})), tool("rectangle", "Rectangle", () => this.begin({ rectangle: true })),
      tool("hole", "Hole", () => this.begin({ hole: true })), tool("undo", "Undo", () => this.undo()),
      make("button", { id: "save-region", class: "main", onclick: () => this.save() }, "Use this region")), this.image.element,
    this.words = make("p", { class: "soft", role: "status" }));
    this.begin({});
    this.paint();
  }

  end() { this.image.end(); }

  begin({ hole = false, rectangle = false }) {
    this.close();
    this.open = { points: [], hole, rectangle, open: true };
  }

  add(point) {
    if (!this.open) this.begin({});
    this.open.points.push(point);
    if (this.open.rectangle && this.open.points.length === 2) {
      const [[a, b], [c, d]] = this.open.points;
      this.open.points = [[a, b], [c, b], [c, d], [a, d]];
      this.close();
    }
    this.paint();
  }

  close() {
    if (this.open?.points.length >= 3) this.polygons.push({ points: this.open.points, hole: this.open.hole });
    this.open = null;
  }

  undo() {
    if (this.open?.points.length) this.open.points.pop();
    else { const last = this.polygons.pop(); this.open = last ? { ...last, points: last.points.slice(0, -1), open: true } : null; }
  }

  // The arrow keys move a cursor, Enter sets a corner there, Backspace removes the last one.
  key(event) {
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }, [width, height] = this.image.size ?? [1, 1];
    const pace = event.shiftKey ? 1 : Math.max(Math.round(width / 40), 1);
    this.cursor ??= [Math.round(width / 2), Math.round(height / 2)];
    if (event.key in moves) this.cursor = this.cursor.map((value, k) => Math.min(Math.max(value + pace * moves[event.key][k], 0), [width, height][k] - 1));
    else if (event.key === "Enter") this.add([...this.cursor]);
    else if (event.key === "Backspace") this.undo();
    else return;
    event.preventDefault();
    this.paint();
  }

  paint() {
    const shown = [...this.polygons, ...(this.open ? [this.open] : []), ...(this.cursor ? [{ points: [this.cursor], open: true }] : [])];
    this.image.sketch(shown.filter((each) => each.points.length));
    const corners = this.open?.points.length ?? 0;
    this.words.textContent = this.open ? `${this.open.hole ? "Hole" : this.open.rectangle ? "Rectangle: click two opposite corners" : "Polygon"}, ${corners} corners. Click, or use the arrow keys and Enter.` : `${this.polygons.length} polygons`;
  }

  async save() {
    this.close();
    this.paint();
    if (!this.polygons.length || !this.image.size) return say("The region has no polygon of three corners yet: click its corners on the image.");
    const [width, height] = this.image.size;
    await command("start", { procedure: "region", text: JSON.stringify({ width, height, polygons: this.polygons }) });
  }
}
