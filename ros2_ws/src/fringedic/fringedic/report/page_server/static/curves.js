// Curves over the steps of the experiment: its signals, and the other values of each step.

import { chart } from "./chart.js";
import { make, options, patch, scaled } from "./elements.js";
import { extensometer, strains } from "./extensometer.js";
import { decimal, known, t } from "./language.js";
import { tried } from "./server.js";
import { listenShown, shown } from "./shown.js";

const VALUES = {
  step: [t("step"), 1], valid_fraction: [t("measured part [%]"), 100], rms_displacement: [t("RMS displacement [µm]"), 1e6],
  strain: [t("strain of the extensometer [µstrain]"), 1e6],
};
const RELATIVE = ["rms_displacement", "strain"]; // to the reference step
const SIGNAL = "signal ";
const kept = { x: `${SIGNAL}position`, y: `${SIGNAL}force` };

// The label of an axis, and the value of a step; a signal of another rig, or that has not come, has none.
function axis(key) {
  if (!key.startsWith(SIGNAL)) return [VALUES[key][0], (step) => scaled(step[key], VALUES[key][1])];
  const name = key.slice(SIGNAL.length), signal = (shown("signals") ?? []).find((each) => each.name === name);
  return [signal ? `${known(name)} [${signal.unit}]` : known(name), (step) => scaled(step.signals?.[name], 1 / (signal?.factor ?? 1))];
}

export function show(place) {
  const choice = (name) => {
    const select = make("select", { id: `curve-${name}`, onchange: () => { kept[name] = select.value; paint(); } });
    return select;
  };
  const choices = { x: choice("x"), y: choice("y") };
  let offeredNames = "";
  const offer = (signals) => {
    const names = JSON.stringify(signals.map(({ name, unit, source }) => [name, unit, source]));
    if (names === offeredNames) return; // values alone have changed: a list that a person has opened stays
    offeredNames = names;
    const offered = signals.map(({ name, unit, source }) => [SIGNAL + name, `${known(name)} [${unit}]${source && ` (${source})`}`]);
    for (const [name, select] of Object.entries(choices)) {
      options(select, [...offered, ...Object.entries(VALUES).map(([key, [label]]) => [key, label])], kept[name]);
    }
  };
  const drawn = make("div"), table = make("table");
  const hint = make("p", { class: "soft" }, t("Place an extensometer on a map to see its strain here."));
  let steps = [];
  const paint = () => {
    const [[x, across], [y, up]] = [axis(kept.x), axis(kept.y)];
    const sigma = (step) => (kept.y === "strain" ? scaled(step.sigma_strain, VALUES.strain[1]) : NaN);
    const relative = [kept.x, kept.y].some((key) => RELATIVE.includes(key)), state = (step) => (relative ? step.reference_step : undefined);
    patch(drawn, chart(steps.map((step) => [across(step), up(step), sigma(step), state(step)]), { x, y }));
    hint.hidden = ![kept.x, kept.y].includes("strain") || extensometer.points.length === 2;
    const columns = relative ? [[x, across], [y, up], [t("relative to step"), (step) => step.reference_step ?? NaN]] : [[x, across], [y, up]];
    patch(table, make("tr", {}, ...columns.map(([name]) => make("th", {}, name))),
      ...steps.map((step) => make("tr", {}, ...columns.map(([, value]) => make("td", {}, cell(value(step)))))));
  };
  place.replaceChildren(make("section", { class: "panel" },
    make("div", { class: "row" }, make("label", {}, t("Across"), choices.x), make("label", {}, t("Up"), choices.y)), drawn, hint,
    make("details", {}, make("summary", {}, t("Values")), make("div", { class: "scroll" }, table))));
  offer([]);
  const ends = [listenShown("signals", (signals) => { offer(signals); paint(); }), listenShown("steps", async (found) => {
    steps = found;
    paint();
    const readings = found.some((step) => step.mapped === 2) ? (await tried(strains())) ?? [] : [];
    if (steps !== found) return; // newer steps have arrived meanwhile
    steps = found.map((step) => ({ ...step, ...readings.find((each) => each.step === step.step) }));
    paint();
  })];
  return () => ends.forEach((end) => end());
}

const cell = (value) => (Number.isFinite(value) ? decimal(Number(value.toPrecision(6))) : "–");
