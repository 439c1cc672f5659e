// Draws the region to be measured on the live image: corners are set, moved and removed; polygons and holes.

import { button, notDriving } from "./buttons.js";
import { make, patch } from "./elements.js";
import { t } from "./language.js";
import { LiveImage } from "./live_image.js";
import { cannotStart, RUNNING } from "./procedure.js";
import { say, start } from "./server.js";
import { latest, listen } from "./stream.js";

const NEAR_PX = 12; // on the screen, from a corner or an edge that is meant
// Outlasts the view; of: the region in force when it was begun; white: the last image in white light.
const drawn = { polygons: null, open: null, of: "", white: null };
const isWhite = () => latest("live")?.state === RUNNING && latest("live").pattern === "white";
const showWhite = () => start({ procedure: "live", pattern: "white" });

export class RegionEditor {
  constructor() {
    this.image = new LiveImage();
    const { canvas } = this.image;
    this.image.sized = () => this.paint();
    this.image.accepts = (image) => this.isShown(image);
    if (drawn.white) this.image.take(drawn.white);
    if (!isWhite() && !cannotStart()) showWhite();
    canvas.tabIndex = 0;
    canvas.style.cursor = "crosshair";
    canvas.addEventListener("pointerdown", (event) => this.take(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    canvas.addEventListener("pointerup", (event) => this.release(event));
    canvas.addEventListener("dblclick", () => this.finish());
    canvas.addEventListener("keydown", (event) => this.key(event));
    this.cursor = null;
    this.chosen = null; // the corner that was clicked last: [polygon, number]
    this.tools = make("div", { class: "row" });
    this.words = make("p", { class: "soft", role: "status" });
    this.element = make("div", { class: "region" }, this.tools, this.image.element, this.words);
    this.ends = [listen("rig", (rig) => this.takeRegion(rig.region ?? [])), ...["procedure", "wheel", "live"].map((topic) => listen(topic, () => this.paint()))];
  }

  // Images in white light; the last of them stays while something else is projected.
  isShown(image) {
    if (isWhite()) drawn.white = image;
    return isWhite() || !drawn.white;
  }

  end() { this.image.end(); this.ends.forEach((end) => end()); }

  // Begins with the region in force, until something is drawn.
  takeRegion(region) {
    const of = JSON.stringify(region);
    if (drawn.polygons === null || (drawn.of !== of && !this.isChanged())) {
      [drawn.polygons, drawn.open, drawn.of] = [JSON.parse(of), null, of];
      if (!region.length) this.begin({});
    }
    this.paint();
  }

  isChanged() { return JSON.stringify(drawn.polygons) !== drawn.of || Boolean(drawn.open?.points.length); }

  begin({ hole = false, rectangle = false }) {
    if (!this.close()) return;
    this.chosen = null;
    drawn.open = { points: [], hole, rectangle, open: true };
  }

  // Sets a corner of the open polygon.
  add(point) {
    const { open } = drawn;
    open.points.push(point);
    if (open.rectangle && open.points.length === 2) {
      const [[a, b], [c, d]] = open.points;
      open.points = [[a, b], [c, b], [c, d], [a, d]];
      this.close();
    }
    this.paint();
  }

  // Closes the open polygon; one that crosses itself, whose inside is not defined, stays open.
  close() {
    const { open } = drawn;
    if (open?.points.length >= 3) {
      if (crossesItself(open.points)) {
        say(t("The polygon crosses itself: move or undo a corner."));
        return false;
      }
      drawn.polygons.push({ points: open.points, hole: Boolean(open.hole) });
    }
    drawn.open = null;
    return true;
  }

  // A double click sets its corner once, and closes.
  finish() {
    if (!drawn.open) return;
    const { points } = drawn.open, [last, before] = [points.at(-1), points.at(-2)];
    if (before && this.distance(last, before) < NEAR_PX) points.pop();
    this.close();
    this.paint();
  }

  undo() {
    if (drawn.open?.points.length) drawn.open.points.pop();
    else if (drawn.open && drawn.polygons.length) drawn.open = null;
    else { const last = drawn.polygons.pop(); drawn.open = last ? { ...last, points: last.points.slice(0, -1), open: true } : drawn.open; }
    this.chosen = null;
  }

  remove() {
    const [polygon, number] = this.chosen ?? [];
    if (!polygon) return;
    polygon.points.splice(number, 1);
    if (!polygon.open && polygon.points.length < 3) drawn.polygons = drawn.polygons.filter((each) => each !== polygon);
    this.chosen = null;
    this.paint();
  }

  clear() { [drawn.polygons, drawn.open, this.chosen] = [[], null, null]; this.begin({}); }

  // the pointer: a corner is dragged, a click on an edge of a closed polygon adds a corner there

  distance([a, b], [c, d]) {
    const scale = this.image.canvas.clientWidth / (this.image.size?.[0] ?? 1);
    return scale * Math.hypot(a - c, b - d);
  }

  shapes() { return [...drawn.polygons, ...(drawn.open ? [drawn.open] : [])]; }

  take(event) {
    if (event.button !== 0 || !this.image.size) return;
    const place = this.image.place(event);
    const corners = this.shapes().flatMap((polygon) => polygon.points.map((point, k) => [polygon, k, this.distance(point, place)]));
    const nearest = corners.filter(([polygon, , far]) => far < NEAR_PX && !(polygon.open && polygon.rectangle)).sort((a, b) => a[2] - b[2])[0];
    this.held = nearest ? { corner: nearest.slice(0, 2), before: [...nearest[0].points[nearest[1]]], from: place, moved: false } : { from: place, moved: false };
    this.image.canvas.setPointerCapture(event.pointerId);
  }

  drag(event) {
    if (!this.held) return;
    const place = this.image.place(event);
    this.held.moved ||= this.distance(place, this.held.from) > NEAR_PX / 3;
    if (this.held.corner && this.held.moved) {
      const [polygon, number] = this.held.corner;
      polygon.points[number] = place;
      this.paint();
    }
  }

  release(event) {
    const { held } = this, place = this.image.size ? this.image.place(event) : null;
    this.held = null;
    if (!held || !place) return;
    if (held.corner) {
      const [polygon, number] = held.corner, { open } = drawn;
      if (held.moved && !polygon.open && crossesItself(polygon.points)) {
        polygon.points[number] = held.before;
        say(t("The polygon would cross itself: the corner stays where it was."));
      } else if (!held.moved && polygon === open && number === 0 && open.points.length >= 3) {
        this.close(); // a click on the first corner
      } else if (!held.moved && polygon === open) return this.add(place); // the second click of a double click
      this.chosen = polygon.points[number] ? [polygon, number] : null;
    } else if (drawn.open) return this.add(place);
    else this.insert(place);
    return this.paint();
  }

  insert(place) {
    const edges = drawn.polygons.flatMap((polygon) => polygon.points.map((point, k) => [polygon, k, this.distance(place, nearestOn(place, point, polygon.points[(k + 1) % polygon.points.length]))]));
    const [nearest] = edges.filter(([, , far]) => far < NEAR_PX).sort((a, b) => a[2] - b[2]);
    if (!nearest) return;
    const [polygon, number] = nearest;
    polygon.points.splice(number + 1, 0, place);
    this.chosen = [polygon, number + 1];
  }

  // The arrow keys move a cursor, Enter sets a corner there, Backspace undoes, Delete removes the corner under the cursor.
  key(event) {
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }, [width, height] = this.image.size ?? [1, 1];
    const pace = event.shiftKey ? 1 : Math.max(Math.round(width / 40), 1);
    this.cursor ??= [Math.round(width / 2), Math.round(height / 2)];
    if (event.key in moves) this.cursor = this.cursor.map((value, k) => Math.min(Math.max(value + pace * moves[event.key][k], 0), [width, height][k] - 1));
    else if (event.key === "Enter") { if (!drawn.open) this.begin({}); this.add([...this.cursor]); }
    else if (event.key === "Backspace") this.undo();
    else if (event.key === "Delete") this.remove();
    else return;
    event.preventDefault();
    this.paint();
  }

  paint() {
    const chosen = this.chosen ? [{ points: [this.chosen[0].points[this.chosen[1]]], open: true, chosen: true }] : [];
    const cursor = this.cursor ? [{ points: [this.cursor], open: true }] : [];
    this.image.sketch([...this.shapes(), ...chosen, ...cursor].filter((each) => each.points.length));
    const { open } = drawn, tool = (id, text, action, why = "") => button(text, { id, why, onclick: () => { action(); this.paint(); } });
    const isOpen = (hole, rectangle) => (Boolean(open) && Boolean(open.hole) === hole && Boolean(open.rectangle) === rectangle ? { "aria-pressed": "true" } : {});
    const kind = (id, text, hole, rectangle) => button(text, { id, ...isOpen(hole, rectangle), onclick: () => { this.begin({ hole, rectangle }); this.paint(); } });
    patch(this.tools, kind("polygon", t("Polygon"), false, false), kind("rectangle", t("Rectangle"), false, true), kind("hole", t("Hole"), true, false),
      tool("undo", t("Undo"), () => this.undo()), tool("remove-corner", t("Delete corner"), () => this.remove(), this.chosen ? "" : t("Click a corner first.")),
      tool("clear", t("Clear"), () => this.clear()),
      isWhite() ? null : button(t("Show white light"), { id: "region-white", why: cannotStart(), onclick: showWhite }),
      button(t("Use this region"), { id: "save-region", class: "main", why: cannotStart() || notDriving(), onclick: () => this.save() }));
    const corners = open?.points.length ?? 0, what = open?.hole ? t("Hole") : open?.rectangle ? t("Rectangle") : t("Polygon");
    const how = open?.rectangle ? t("click two opposite corners") : t("click the corners, and double-click the last one");
    const still = isWhite() ? "" : drawn.white ? `${t("This is the last image in white light.")} ` : `${t("The corners are seen best in white light.")} `;
    this.words.textContent = !this.image.size ? t("Start the live view, which shows the image to draw on.") : still + (open ? t("{shape}, corners: {corners}. Now {how}; or use the arrow keys and Enter.", { shape: what, corners, how })
      : t("Polygons: {count}. Drag a corner to move it, click an edge to add one.", { count: drawn.polygons.length }));
  }

  async save() {
    if (!this.image.size) return say(t("There is no image yet: start the live view."));
    if (!this.close()) return undefined;
    this.paint();
    if (!drawn.polygons.some(({ hole }) => !hole)) return say(t("The region has no polygon of three corners yet: click its corners on the image."));
    const [width, height] = this.image.size, saved = JSON.stringify(drawn.polygons);
    const answer = await start({ procedure: "region", text: JSON.stringify({ width, height, polygons: drawn.polygons }) });
    if (answer !== null) drawn.of = saved;
    return answer;
  }
}

// The point of an edge that is nearest to a place.
function nearestOn([x, y], [a, b], [c, d]) {
  const length = (c - a) ** 2 + (d - b) ** 2, along = length ? Math.min(Math.max(((x - a) * (c - a) + (y - b) * (d - b)) / length, 0), 1) : 0;
  return [a + along * (c - a), b + along * (d - b)];
}

// Whether two edges of a polygon that are not neighbours cross.
export function crossesItself(points) {
  const side = ([a, b], [c, d], [x, y]) => Math.sign((c - a) * (y - b) - (d - b) * (x - a));
  const cross = (p, q, r, s) => side(p, q, r) * side(p, q, s) < 0 && side(r, s, p) * side(r, s, q) < 0;
  const edges = points.map((point, k) => [point, points[(k + 1) % points.length]]);
  return edges.some(([p, q], i) => edges.some(([r, s], k) => k > i + 1 && !(i === 0 && k === edges.length - 1) && cross(p, q, r, s)));
}
