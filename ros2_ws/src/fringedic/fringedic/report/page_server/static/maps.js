// Maps of a step with their colours, the value and its standard deviation under the pointer, profile and extensometer.

import { chart } from "./chart.js";
import { make, number, options, withSigma } from "./elements.js";
import { extensometer, strains } from "./extensometer.js";
import { MapCanvas, usualRange, valueAt } from "./map_canvas.js";
import { line, newest, palettes, tile, tried } from "./server.js";
import { listen } from "./stream.js";

const PREFERRED = ["v", "displacement_y", "shape_z"];
const kept = { quantity: "", palette: "viridis", tool: "look", follow: true };

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
    this.step = make("select", { id: "step", onchange: () => { kept.follow = this.step.selectedIndex === this.step.length - 1; this.load(); } });
    this.quantity = make("select", { id: "quantity", onchange: () => { kept.quantity = this.quantity.value; this.auto(); this.takeSteps(this.steps); } });
    this.palette = make("select", { id: "palette", onchange: () => { kept.palette = this.palette.value; this.paint(); } });
    options(this.palette, [["viridis", "viridis"], ["RdBu_r", "blue to red"], ["gray", "grey"]], kept.palette);
    const fix = () => { this.fixed = true; this.paint(); }; // the range then stays for the next steps
    this.low = make("input", { type: "number", step: "any", id: "low", onchange: fix });
    this.high = make("input", { type: "number", step: "any", id: "high", onchange: fix });
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
      make("div", { class: "row" }, make("label", {}, "from", this.low), make("label", {}, "to", this.high),
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
    options(this.step, mapped, kept.follow ? mapped.at(-1)?.[0] : this.step.value);
    if (!mapped.length) this.readout.textContent = "No step has been measured yet.";
    this.load();
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

  auto() {
    this.fixed = false;
    this.low.value = this.high.value = "";
    if (!this.values || this.chosen.name !== this.quantity.value) return;
    const [low, high] = usualRange(this.values.values).map((value) => value / this.chosen.factor);
    [this.low.value, this.high.value] = [Number(low.toPrecision(4)), Number(high.toPrecision(4))];
  }

  paint() {
    if (!this.values) return;
    const { factor, unit, meaning } = this.chosen, colours = this.colours[this.palette.value];
    const [low, high] = [Number(this.low.value), Number(this.high.value)];
    this.map.show(this.values, colours, low * factor, high * factor, `${meaning}, step ${this.shown}`);
    this.map.mark(this.points);
    this.lowText.textContent = `${number(low)} ${unit}`;
    this.highText.textContent = `${number(high)} ${unit}`;
    const image = new ImageData(256, 1);
    for (let i = 0; i < 256; i++) image.data.set([...colours.slice(3 * i, 3 * i + 3), 255], 4 * i);
    this.bar.getContext("2d").putImageData(image, 0, 0);
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
    const points = found.position.map((at, k) => [at, found.value[k] === null ? NaN : found.value[k] / factor, (found.sigma?.[k] ?? 0) / factor]);
    return [make("h2", {}, `Profile of ${name}`), make("p", { class: "soft" }, `${meaning}; the band is ± 2 standard deviations.`),
      chart(points, { x: "distance [px]", y: `${name} [${unit}]` })];
  }

  async extensometer() {
    const found = await strains();
    const points = found.map((each) => [each.step, 1e6 * each.strain, 1e6 * (each.sigma_strain ?? 0)]), last = found.at(-1);
    return [make("h2", {}, "Extensometer"),
      make("p", { id: "strain" }, `Step ${last.step}: ${withSigma(1e6 * last.strain, 1e6 * last.sigma_strain, "µstrain")}, length ${number(1e3 * last.length, 5)} mm`),
      chart(points, { x: "step", y: "strain [µstrain]" })];
  }
}
