// Curves over the steps of the experiment: force and position, and the other values of each step.

import { chart } from "./chart.js";
import { make, options } from "./elements.js";
import { extensometer, strains } from "./extensometer.js";
import { tried } from "./server.js";
import { listen } from "./stream.js";

const VALUES = {
  step: ["step", 1], position: ["position [mm]", 1e3], force: ["force [N]", 1],
  valid_fraction: ["measured part [%]", 100], rms_displacement: ["RMS displacement [µm]", 1e6],
  strain: ["strain of the extensometer [µstrain]", 1e6],
};
const kept = { x: "position", y: "force" };

export function show(place) {
  const choice = (axis) => {
    const select = make("select", { id: `curve-${axis}`, onchange: () => { kept[axis] = select.value; paint(); } });
    options(select, Object.entries(VALUES).map(([key, [label]]) => [key, label]), kept[axis]);
    return select;
  };
  const drawn = make("div"), table = make("table");
  const hint = make("p", { class: "soft" }, "Place an extensometer on a map to see its strain here.");
  let steps = [];
  const paint = () => {
    const [[x, across], [y, up]] = [VALUES[kept.x], VALUES[kept.y]];
    const value = (step, name, factor) => step[name] === null || step[name] === undefined ? NaN : step[name] * factor;
    const sigma = (step) => (kept.y === "strain" ? value(step, "sigma_strain", up) : 0);
    drawn.replaceChildren(chart(steps.map((step) => [value(step, kept.x, across), value(step, kept.y, up), sigma(step)]), { x, y }));
    hint.hidden = ![kept.x, kept.y].includes("strain") || extensometer.points.length === 2;
    table.replaceChildren(make("tr", {}, make("th", {}, x), make("th", {}, y)),
      ...steps.map((step) => make("tr", {}, ...[[kept.x, across], [kept.y, up]].map(([name, factor]) => make("td", {}, cell(value(step, name, factor)))))));
  };
  place.replaceChildren(make("section", { class: "panel" },
    make("div", { class: "row" }, make("label", {}, "Across", choice("x")), make("label", {}, "Up", choice("y"))), drawn, hint,
    make("details", {}, make("summary", {}, "Values"), make("div", { class: "scroll" }, table))));
  return listen("steps", async (found) => {
    steps = found;
    paint();
    const readings = found.some((step) => step.mapped === 2) ? (await tried(strains())) ?? [] : [];
    if (steps !== found) return; // newer steps have arrived meanwhile
    steps = found.map((step) => ({ ...step, ...readings.find((each) => each.step === step.step) }));
    paint();
  });
}

const cell = (value) => (Number.isFinite(value) ? String(Number(value.toPrecision(6))) : "–");
