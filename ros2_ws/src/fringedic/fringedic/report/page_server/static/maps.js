// Maps of a step with their colours, the value and its standard deviation under the pointer, profile and extensometer.

import { chart } from "./chart.js";
import { make, number, options, scaled, withSigma } from "./elements.js";
import { extensometer, strains } from "./extensometer.js";
import { colourBar, MapCanvas, median, usualRange, valueAt } from "./map_canvas.js";
import { numberField } from "./numbers.js";
import { line, newest, palettes, tile, tried } from "./server.js";
import { listen } from "./stream.js";

const PREFERRED = ["v", "displacement_y", "shape_z"];
const kept = { quantity: "", palette: "viridis", tool: "look", follow: true, step: null };
const DIVERGING = "RdBu_r"; // its middle colour is zero
const LEAST_SIGMAS = 10; // of a range, so that noise alone is not spread over all colours

export function show(place) {
  const view = new MapsView();
  place.replaceChildren(view.element);
  const ends = [listen("quantities", (found) => view.takeQuantities(found)), listen("steps", (found) => view.takeSteps(found))];
  return () => ends.forEach((end) => end());
}

class MapsView {
  constructor() {
    this.quantities = [];
    this.steps = [];
    this.points = [];
    this.latestProbe = newest();
    this.map = new MapCanvas((place) => this.read(place), (place) => this.click(place));
    this.step = make("select", { id: "step", onchange: () => { kept.step = this.step.value; kept.follow = this.step.selectedIndex === this.step.length - 1; this.load(); } });
    this.quantity = make("select", { id: "quantity", onchange: () => { kept.quantity = this.quantity.value; this.auto(); this.takeSteps(this.steps); } });
    this.palette = make("select", { id: "palette", onchange: () => { kept.palette = this.palette.value; if (!this.fixed) this.auto(); this.paint(); } });
    options(this.palette, [["viridis", "viridis"], ["RdBu_r", "blue to red"], ["gray", "grey"]], kept.palette);
    const fix = () => { this.fixed = true; this.paint(); }; // the range then stays for the next steps
    this.low = numberField({ id: "low", changed: fix });
    this.high = numberField({ id: "high", changed: fix });
    for (const { input } of [this.low, this.high]) input.addEventListener("input", () => { this.fixed = true; });
    this.tool = make("select", { id: "tool", onchange: () => { kept.tool = this.tool.value; this.choosePoints(this.earlier()); } });
    options(this.tool, [["look", "read values"], ["profile", "profile along a line"], ["gauge", "extensometer between two points"]], kept.tool);
    this.readout = make("p", { class: "readout", id: "readout", role: "status" });
    this.bar = make("canvas", { width: 256, height: 1 });
    this.result = make("div", { class: "panel", id: "probe" });
    this.element = make("div", { class: "columns" },
      make("section", { class: "panel" }, this.controls(), this.map.element, this.readout, this.scale()), this.result);
    this.choosePoints(this.earlier());
  }

  // The gauge points that were chosen before.
  earlier() { return this.tool.value === "gauge" ? extensometer.points : []; }

  controls() {
    return make("div", { class: "row" },
      make("label", {}, "Step", this.step), make("label", {}, "Map", this.quantity), make("label", {}, "Colours", this.palette),
      make("label", {}, "Tool", this.tool));
  }

  scale() {
    return make("div", {},
      make("div", { class: "bar" }, this.lowText = make("span"), this.bar, this.highText = make("span")),
      make("div", { class: "row" }, make("label", {}, "from", this.low.input), make("label", {}, "to", this.high.input),
        make("button", { onclick: () => { this.auto(); this.paint(); } }, "Range of this map")));
  }

  takeQuantities(found) {
    this.quantities = found;
    const first = PREFERRED.find((name) => found.some((each) => each.name === name));
    options(this.quantity, found.map(({ name, meaning }) => [name, `${name}: ${meaning}`]), kept.quantity || first);
    this.takeSteps(this.steps);
  }

  takeSteps(steps) {
    this.steps = steps;
    const level = this.quantities.find(({ name }) => name === this.quantity.value)?.level ?? 1;
    const mapped = steps.filter((step) => step.mapped >= level).map((step) => [step.step, String(step.step)]);
    if (kept.follow) kept.step = mapped.at(-1)?.[0] ?? null;
    const isThere = kept.step === null || mapped.some(([step]) => String(step) === String(kept.step));
    options(this.step, isThere ? mapped : [...mapped, [kept.step, `${kept.step}: has no such map`]], kept.step);
    if (!mapped.length) this.readout.textContent = "No step has been measured yet.";
    else if (!isThere) this.forget(`Step ${kept.step} has no map ${this.quantity.value}.`);
    if (isThere) this.load();
  }

  // Shows no map rather than that of another step.
  forget(why) {
    [this.values, this.loaded, this.loading] = [null, null, null];
    this.map.clear();
    this.readout.textContent = why;
  }

  async load() {
    const [step, name] = [this.step.value, this.quantity.value];
    if (!step || !name) return;
    const key = `${step}/${name}`;
    if (key === this.loaded || key === this.loading) return;
    this.loading = key;
    const found = await tried(this.fetch(step, this.quantities.find((each) => each.name === name)));
    if (this.loading !== key) return; // another choice has been made meanwhile
    this.loading = null;
    if (!found) return;
    this.loaded = key;
    Object.assign(this, found);
    if (!this.fixed) this.auto();
    this.paint();
    this.probe();
  }

  // The map, those of its standard deviation and smoothing error if there are any, and the palettes.
  async fetch(step, quantity) {
    const beside = (name) => name ? tile(step, name).catch(() => null) : null;
    const [values, sigma, resolution, colours] = await Promise.all([
      tile(step, quantity.name), beside(quantity.sigma), beside(quantity.resolution), this.colours ?? palettes()]);
    return { values, sigma, resolution, colours, chosen: quantity, shown: step };
  }

  // The range of the values: with zero in its middle for two colours, and not narrower than what noise alone would fill.
  auto() {
    this.fixed = false;
    this.low.input.value = this.high.input.value = "";
    if (!this.values || this.chosen.name !== this.quantity.value) return;
    let [low, high] = usualRange(this.values.values);
    const sigma = this.sigma ? median(this.sigma.values) : NaN, least = LEAST_SIGMAS * sigma;
    if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
    if (this.palette.value === DIVERGING) [low, high] = [-Math.max(-low, high), Math.max(-low, high)];
    const text = (value) => String(Number((value / this.chosen.factor).toPrecision(4)));
    [this.low.input.value, this.high.input.value] = [text(low), text(high)];
  }

  paint() {
    const [low, high] = [this.low.found(), this.high.found()];
    if (!this.values || !Number.isFinite(low) || !Number.isFinite(high)) return;
    const { factor, unit, meaning } = this.chosen, colours = this.colours[this.palette.value];
    this.map.show(this.values, colours, low * factor, high * factor, `${meaning}, step ${this.shown}`);
    this.map.mark(this.points);
    this.lowText.textContent = `${number(low)} ${unit}`;
    this.highText.textContent = `${number(high)} ${unit}`;
    colourBar(this.bar, colours);
  }

  read(place) {
    if (!place || !this.values) { this.readout.textContent = "Point at the map: value ± standard deviation"; return; }
    const { factor, unit, name } = this.chosen, sigma = this.sigma ? valueAt(this.sigma, place) / factor : NaN;
    const smoothed = this.resolution ? valueAt(this.resolution, place) / factor : NaN;
    const value = withSigma(valueAt(this.values, place) / factor, sigma, unit);
    const errors = sigma > 0 && Number.isFinite(smoothed) ? ` noise, up to ${number(smoothed, 2)} ${unit} smoothing,` : "";
    this.readout.textContent = `${name} = ${value}${errors} at column ${place.column}, row ${place.row}`;
  }

  click({ column, row }) {
    if (this.tool.value === "look") return;
    this.choosePoints(this.points.length === 1 ? [...this.points, [column, row]] : [[column, row]]);
  }

  choosePoints(points) {
    this.points = points;
    if (this.tool.value === "gauge") extensometer.points = points;
    this.map.mark(points);
    const asked = { look: "Choose a tool to draw a profile or an extensometer.", profile: "Click both ends of the line.", gauge: "Click both gauge points." };
    this.probe();
    if (points.length < 2) this.result.replaceChildren(make("h2", {}, "Probe"), make("p", { class: "soft" }, asked[this.tool.value]));
  }

  async probe() {
    const asked = this.points.length < 2 ? null : this.tool.value === "profile" ? this.profile() : this.extensometer();
    const shown = await tried(this.latestProbe(asked));
    if (shown) this.result.replaceChildren(...shown);
  }

  async profile() {
    const { name, unit, factor, meaning } = this.chosen, found = await line(this.shown, name, ...this.points);
    const points = found.position.map((at, k) => [at, scaled(found.value[k], 1 / factor), scaled(found.sigma?.[k], 1 / factor)]);
    return [make("h2", {}, `Profile of ${name}`), make("p", { class: "soft" }, `${meaning}; the band is ± 2 standard deviations.`),
      chart(points, { x: "distance [px]", y: `${name} [${unit}]` })];
  }

  async extensometer() {
    const found = await strains();
    const points = found.map(({ step, strain, sigma_strain }) => [step, scaled(strain, 1e6), scaled(sigma_strain, 1e6)]);
    const { strain, sigma_strain, length } = found.find(({ step }) => step === Number(this.shown)) ?? {};
    return [make("h2", {}, "Extensometer"),
      make("p", { id: "strain" }, `Step ${this.shown}: ${withSigma(scaled(strain, 1e6), scaled(sigma_strain, 1e6), "µstrain")}, length ${number(scaled(length, 1e3), 5)} mm`),
      chart(points, { x: "step", y: "strain [µstrain]" })];
  }
}
