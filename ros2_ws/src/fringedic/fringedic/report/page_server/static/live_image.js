// The live image of the camera with the region to be measured; saturated pixels arrive in red.

import { draw, make } from "./elements.js";
import { t } from "./language.js";
import { listen } from "./stream.js";

export class LiveImage {
  constructor() {
    this.canvas = make("canvas", { class: "camera", role: "img", "aria-label": t("Image of the camera"), width: 4, height: 3 });
    this.marks = draw("svg", { preserveAspectRatio: "none" });
    this.element = make("div", { class: "picture" }, this.canvas, this.marks);
    this.polygons = [];
    this.ends = [listen("image", (image) => this.take(image)), listen("rig", (rig) => { this.region = rig.region ?? []; this.paint(); })];
  }

  // Called when an image of another size has come; an owner replaces it.
  sized() {}

  // Whether an image is shown; an owner replaces it.
  accepts() { return true; }

  end() {
    this.ends.forEach((end) => end());
  }

  // Only the newest image is decoded.
  async take(image) {
    if (!this.accepts(image)) return;
    this.waiting = image;
    if (this.decoding) return;
    this.decoding = true;
    while (this.waiting) {
      const next = this.waiting;
      this.waiting = null;
      const picture = await createImageBitmap(next.blob);
      [this.canvas.width, this.canvas.height] = [picture.width, picture.height];
      this.canvas.getContext("2d").drawImage(picture, 0, 0);
      this.canvas.dataset.stamp = next.stamp;
      if (this.size?.[0] !== next.width || this.size?.[1] !== next.height) {
        this.size = [next.width, next.height];
        this.element.style.setProperty("--aspect", next.width / next.height);
        this.marks.setAttribute("viewBox", `-0.5 -0.5 ${next.width} ${next.height}`); // pixel centres are whole numbers
        this.paint();
        this.sized();
      }
    }
    this.decoding = false;
  }

  // Shows polygons that are being drawn instead of the region in force.
  sketch(polygons) {
    this.polygons = polygons;
    this.isSketch = true;
    this.paint();
  }

  paint() {
    const shown = this.isSketch ? this.polygons : this.region ?? [];
    this.marks.replaceChildren(...shown.flatMap(({ points, hole, open }) => [
      draw(open ? "polyline" : "polygon", { class: `overlay${hole ? " hole" : ""}`, points: points.map((p) => p.join(",")).join(" ") }),
      ...(this.isSketch ? points.map(([x, y]) => draw("circle", { class: "overlay corner", cx: x, cy: y, r: (this.size?.[0] ?? 100) / 150 })) : [])]));
  }

  // The position of a pointer event in pixels of the camera, column and row.
  place(event) {
    const box = this.canvas.getBoundingClientRect(), [width, height] = this.size ?? [1, 1];
    const inside = (value, size) => Number(Math.min(Math.max(value, -0.5), size - 0.5).toFixed(1));
    return [inside(((event.clientX - box.left) / box.width) * width - 0.5, width), inside(((event.clientY - box.top) / box.height) * height - 0.5, height)];
  }
}
