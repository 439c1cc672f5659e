// A curve in an SVG: points [x, y, sigma of y or nothing, state or nothing], labels of both axes, and points of another, dashed
// curve. A curve has a gap where a value is missing, and where the state changes that its values are relative to.

import { draw, make, number } from "./elements.js";
import { t } from "./language.js";

const WIDTH = 640, HEIGHT = 300, LEFT = 78, BOTTOM = 46, TOP = 12, RIGHT = 16;

export function chart(points, { x, y, dots = true, other = [] }) {
  const isKnown = ([a, b]) => Number.isFinite(a) && Number.isFinite(b), known = [...points, ...other].filter(isKnown);
  if (!known.length) return make("p", { class: "soft" }, t("There are no values yet."));
  const spread = known.map(([a, b, s]) => [a, b - 2 * (s || 0), b + 2 * (s || 0)]);
  const across = axis(spread.map((p) => p[0])), up = axis(spread.flatMap((p) => [p[1], p[2]]));
  const column = (value) => LEFT + ((value - across.low) / (across.high - across.low)) * (WIDTH - LEFT - RIGHT);
  const row = (value) => HEIGHT - BOTTOM - ((value - up.low) / (up.high - up.low)) * (HEIGHT - BOTTOM - TOP);
  const path = (pairs) => pairs.map(([a, b]) => `${column(a).toFixed(1)},${row(b).toFixed(1)}`).join(" ");
  const svg = draw("svg", { class: "chart", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": t("{y} over {x}", { x, y }) });
  for (const value of across.ticks)
    svg.append(draw("line", { class: "grid", x1: column(value), x2: column(value), y1: TOP, y2: HEIGHT - BOTTOM }),
      draw("text", { x: column(value), y: HEIGHT - BOTTOM + 17, "text-anchor": "middle" }, number(value)));
  for (const value of up.ticks)
    svg.append(draw("line", { class: "grid", x1: LEFT, x2: WIDTH - RIGHT, y1: row(value), y2: row(value) }),
      draw("text", { x: LEFT - 6, y: row(value) + 4, "text-anchor": "end" }, number(value)));
  svg.append(draw("path", { class: "axis", fill: "none", d: `M${LEFT} ${TOP}V${HEIGHT - BOTTOM}H${WIDTH - RIGHT}` }));
  for (const part of parts(points, ([a, b, s]) => Number.isFinite(a) && Number.isFinite(b) && s > 0))
    svg.append(draw("polygon", { class: "band", points: `${path(part.map(([a, b, s]) => [a, b + 2 * s]))} ${path(part.map(([a, b, s]) => [a, b - 2 * s]).reverse())}` }));
  for (const part of parts(points, isKnown)) svg.append(draw("polyline", { class: "curve", points: path(part) }));
  for (const part of parts(other, isKnown)) svg.append(draw("polyline", { class: "curve other", points: path(part) }));
  if (dots && known.length <= 100) for (const [a, b] of known) svg.append(draw("circle", { class: "dot", cx: column(a), cy: row(b), r: 3 }));
  svg.append(draw("text", { x: (LEFT + WIDTH) / 2, y: HEIGHT - 8, "text-anchor": "middle" }, x),
    draw("text", { x: 14, y: HEIGHT / 2, "text-anchor": "middle", transform: `rotate(-90 14 ${HEIGHT / 2})` }, y));
  return svg;
}

// The longest parts without a missing point, each of one state.
function parts(points, isKnown) {
  const found = [[]];
  for (const point of points) {
    const part = found.at(-1);
    if (part.length && (!isKnown(point) || part[0][3] !== point[3])) found.push([]);
    if (isKnown(point)) found.at(-1).push(point);
  }
  return found.filter((part) => part.length);
}

// Limits and round ticks around values.
function axis(values) {
  let low = Math.min(...values), high = Math.max(...values);
  if (high - low < 1e-12 * Math.max(1, Math.abs(high))) [low, high] = [low - 0.5, high + 0.5];
  const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough));
  const pace = power * [1, 2, 5, 10].find((each) => each * power >= rough);
  const ticks = [];
  for (let k = Math.ceil(low / pace); k * pace <= high; k++) ticks.push(Number((k * pace).toPrecision(12)));
  return { low, high, ticks };
}
