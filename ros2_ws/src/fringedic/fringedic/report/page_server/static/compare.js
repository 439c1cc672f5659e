// Two tests beside each other: what was entered, their curves in one chart, and a map of each with the same colours.

import { chart } from "./chart.js";
import { make, number, options, patch, scaled, withSigma } from "./elements.js";
import { date, decimal, known, t } from "./language.js";
import { colourBar, MapCanvas, usualRange, valueAt } from "./map_canvas.js";
import { newest, palettes, testTopics, tile, tried } from "./server.js";
import { latest, listen } from "./stream.js";
import { compared } from "./tests.js";

const PREFERRED = ["v", "displacement_y", "shape_z"];
const kept = { names: ["", ""], quantity: "", x: "position", y: "force" };

export function show(place) {
  const view = new CompareView();
  place.replaceChildren(view.element);
  const end = listen("tests", () => view.offer());
  return end;
}

const entered = (value) => (typeof value === "number" ? decimal(value) : value);

class CompareView {
  constructor() {
    if (compared().length === 2) kept.names = [...compared()];
    this.topics = [null, null];
    this.turns = [newest(), newest()];
    this.drawn = newest();
    this.choices = kept.names.map((_, k) => make("select", { id: `test-${k}`, onchange: () => { kept.names[k] = this.choices[k].value; this.open(k); } }));
    const choice = (name, changed) => make("select", { id: `compare-${name}`, onchange: ({ target }) => { kept[name] = target.value; changed(); } });
    this.quantity = choice("quantity", () => this.draw());
    [this.x, this.y] = ["x", "y"].map((name) => choice(name, () => this.paint()));
    this.steps = kept.names.map((_, k) => make("select", { id: `step-${k}`, "aria-label": t("Step of test {number}", { number: k + 1 }), onchange: () => this.draw() }));
    this.maps = kept.names.map(() => new MapCanvas((at) => this.read(at), () => {}));
    this.words = kept.names.map(() => make("p", { class: "readout" }));
    this.curves = make("div");
    this.entries = make("table", { id: "entries" });
    this.bar = make("canvas", { width: 256, height: 1 });
    [this.low, this.high] = [make("span"), make("span")];
    const shownMap = (k) => make("div", {}, make("label", {}, t("Step of test {number}", { number: k + 1 }), this.steps[k]), this.maps[k].element, this.words[k]);
    this.element = make("div", { class: "stack" },
      make("section", { class: "panel" }, make("div", { class: "row" }, ...this.choices.map((select, k) => make("label", {}, t("Test {number}", { number: k + 1 }), select))),
        make("div", { class: "scroll" }, this.entries)),
      make("section", { class: "panel" }, make("div", { class: "row" }, make("label", {}, t("Across"), this.x), make("label", {}, t("Up"), this.y)), this.curves),
      make("section", { class: "panel" }, make("label", {}, t("Map"), this.quantity), make("div", { class: "two" }, shownMap(0), shownMap(1)),
        make("div", { class: "bar" }, this.low, this.bar, this.high)));
    this.offer();
    [0, 1].forEach((k) => this.open(k));
  }

  offer() {
    const tests = (latest("tests") ?? []).filter(({ results }) => results);
    const entries = [["", t("choose a test")], ...tests.map(({ name, specimen }) => [name, specimen ? `${specimen} (${name})` : name])];
    this.choices.forEach((select, k) => { if (document.activeElement !== select) options(select, entries, kept.names[k]); });
    this.paintEntries();
  }

  async open(k) {
    this.topics[k] = kept.names[k] ? await tried(this.turns[k](testTopics(kept.names[k]))) : null;
    const names = (key) => [...new Set(this.topics.flatMap((topics) => (topics?.[key] ?? []).map(({ name }) => name)))];
    const signals = names("signals"), quantities = names("quantities");
    options(this.x, [["step", t("step")], ...signals.map((name) => [name, known(name)])], kept.x);
    options(this.y, signals.map((name) => [name, known(name)]), kept.y);
    options(this.quantity, quantities.map((name) => [name, name]), kept.quantity || PREFERRED.find((name) => quantities.includes(name)));
    this.topics.forEach((topics, number) => {
      const measured = (topics?.steps ?? []).filter(({ mapped }) => mapped).map(({ step }) => [step, String(step)]);
      options(this.steps[number], measured, number === k ? measured.at(-1)?.[0] : undefined);
    });
    this.paint();
    this.draw();
  }

  paint() {
    this.paintEntries();
    const axis = (name) => {
      const signal = this.topics.flatMap((topics) => topics?.signals ?? []).find((each) => each.name === name);
      return [signal ? `${known(name)} [${signal.unit}]` : known(name), (step) => (name === "step" ? step.step : scaled(step.signals?.[name], 1 / (signal?.factor ?? 1)))];
    };
    const [[x, across], [y, up]] = [axis(this.x.value), axis(this.y.value)];
    const [points, other] = this.topics.map((topics) => (topics?.steps ?? []).map((step) => [across(step), up(step)]));
    patch(this.curves, this.topics.some(Boolean) ? chart(points, { x, y, other }) : make("p", { class: "soft" }, t("Choose two tests.")),
      make("p", { class: "soft" }, t("Test 1: full line; test 2: dashed line.")));
  }

  paintEntries() {
    const tests = kept.names.map((name) => (latest("tests") ?? []).find((each) => each.name === name));
    const rows = [[t("result"), (test) => known(test.verdict)], [t("date"), (test) => date(test.when)],
      ...[...new Set(tests.flatMap((test) => Object.keys(test?.answers ?? {})))].map((name) => [known(name), (test) => entered(test.answers?.[name] ?? "–")])];
    const cells = (value) => tests.map((test) => make("td", { class: "words" }, test ? String(value(test)) : "–"));
    patch(this.entries, ...rows.map(([name, value]) => {
      const [one, two] = cells(value);
      return make("tr", { class: one.textContent === two.textContent ? "" : "differs" }, make("th", {}, name), one, two);
    }));
  }

  // Both maps with the range of both.
  async draw() {
    const name = this.quantity.value, described = this.topics.flatMap((topics) => topics?.quantities ?? []).find((each) => each.name === name);
    const asked = (map) => this.topics.map((topics, k) => (map && topics && this.steps[k].value ? tile(this.steps[k].value, map, kept.names[k]).catch(() => null) : null));
    const found = await tried(this.drawn(Promise.all([palettes(), ...asked(name), ...asked(described?.sigma)])));
    if (!found) return;
    const [colours, ...maps] = found, tiles = maps.slice(0, 2), known = tiles.filter(Boolean);
    [this.tiles, this.sigmas, this.described] = [tiles, maps.slice(2), described];
    if (!known.length) { // no map rather than the one of another choice
      this.maps.forEach((each) => each.clear());
      this.low.textContent = this.high.textContent = "";
      return;
    }
    const ranges = known.map(({ values }) => usualRange(values)), low = Math.min(...ranges.map(([each]) => each)), high = Math.max(...ranges.map(([, each]) => each));
    tiles.forEach((each, k) => (each ? this.maps[k].show(each, colours.viridis, low, high, t("{map} of {test}, step {step}", { map: name, test: kept.names[k], step: this.steps[k].value })) : this.maps[k].clear()));
    const { factor, unit } = described;
    [this.low.textContent, this.high.textContent] = [low, high].map((value) => `${number(value / factor)} ${unit}`);
    colourBar(this.bar, colours.viridis);
  }

  // The value at the same point of both, with its standard deviation.
  read(at) {
    this.tiles?.forEach((each, k) => {
      const inside = at && each && at.column < each.columns * each.spacing && at.row < each.rows * each.spacing, { factor, unit } = this.described ?? {};
      const sigma = inside && this.sigmas[k] ? valueAt(this.sigmas[k], at) / factor : NaN;
      this.words[k].textContent = inside ? t("{value} at column {column}, row {row}", { value: withSigma(valueAt(each, at) / factor, sigma, unit), ...at }) : "";
    });
  }
}
