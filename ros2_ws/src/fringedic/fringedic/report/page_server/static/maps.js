// Maps of a step with their colours, the value and its standard deviation under the pointer, profile and extensometer.

import { chart } from "./chart.js";
import { make, number, options, scaled, withSigma } from "./elements.js";
import { extensometer, strains } from "./extensometer.js";
import { isolines, levelsBetween } from "./isolines.js";
import { decimal, known, t } from "./language.js";
import { colourBar, MapCanvas, median, usualRange, valueAt } from "./map_canvas.js";
import { MarksPanel } from "./marks.js";
import { numberField } from "./numbers.js";
import { line, newest, palettes, tile, tried } from "./server.js";
import { listenShown, shownTest } from "./shown.js";

const PREFERRED = ["v", "displacement_y", "shape_z"];
const kept = { quantity: "", palette: "viridis", tool: "look", follow: true, step: null, test: "", over: false, lines: false };
const TOOLS = [["look", t("read values")], ["profile", t("profile along a line")], ["gauge", t("extensometer between two points")], ["point", t("point")], ["area", t("area (double click closes it)")]];
const MARK_OF = { profile: "line", gauge: "gauge", point: "point", area: "area" }; // what a tool draws
const PLAY_MS = 400; // from one step to the next
const DIVERGING = "RdBu_r"; // its middle colour is zero
const LEAST_SIGMAS = 10; // of a range, so that noise alone is not spread over all colours

export function show(place) {
  const view = new MapsView();
  place.replaceChildren(view.element);
  const ends = [listenShown("quantities", (found) => view.takeQuantities(found)), listenShown("steps", (found) => view.takeSteps(found)), () => view.end()];
  return () => ends.forEach((end) => end());
}

class MapsView {
  constructor() {
    this.quantities = [];
    this.steps = [];
    this.points = [];
    this.latestProbe = newest();
    this.tiles = {}; // of the test that is looked at, by their addresses: x and y, and images of the surface
    this.map = new MapCanvas((place) => this.read(place), (place, clicks) => this.click(place, clicks));
    this.marks = new MarksPanel(() => this.map.mark(this.points, { kept: this.marks?.marks, closed: this.closed }));
    this.step = make("select", { id: "step", onchange: () => this.goTo(this.step.selectedIndex) });
    this.slider = make("input", { type: "range", id: "slider", min: 0, max: 0, "aria-label": t("Step"), oninput: () => this.goTo(Number(this.slider.value)) });
    this.player = make("button", { type: "button", id: "play", onclick: () => this.play() }, t("Play"));
    this.quantity = make("select", { id: "quantity", onchange: () => { kept.quantity = this.quantity.value; this.auto(); this.takeSteps(this.steps); } });
    this.palette = make("select", { id: "palette", onchange: () => { kept.palette = this.palette.value; if (!this.fixed) this.auto(); this.paint(); } });
    options(this.palette, [["viridis", "viridis"], ["RdBu_r", t("blue to red")], ["gray", t("grey")]], kept.palette);
    const fix = () => { this.fixed = true; this.paint(); }; // the range then stays for the next steps
    this.low = numberField({ id: "low", changed: fix });
    this.high = numberField({ id: "high", changed: fix });
    for (const { input } of [this.low, this.high]) input.addEventListener("input", () => { this.fixed = true; });
    this.tool = make("select", { id: "tool", onchange: () => { kept.tool = this.tool.value; this.choosePoints(this.earlier()); } });
    options(this.tool, TOOLS, kept.tool);
    const box = (id, key, text, changed) => make("label", {}, make("input", { type: "checkbox", id, checked: kept[key], onchange: ({ target }) => { kept[key] = target.checked; changed(); } }), text);
    this.boxes = [box("over", "over", t("over the image"), () => this.paintBelow()), box("isolines", "lines", t("isolines"), () => this.paint())];
    this.position = make("p", { class: "soft", id: "position" });
    this.linesText = make("p", { class: "soft", id: "isoline-step" });
    this.readout = make("p", { class: "readout", id: "readout", role: "status" });
    this.bar = make("canvas", { width: 256, height: 1 });
    this.result = make("div", { class: "panel", id: "probe" });
    this.element = make("div", { class: "columns" },
      make("section", { class: "panel" }, this.controls(), this.map.element, this.readout, this.position, this.scale()),
      make("section", {}, this.result, this.marks.element));
    this.choosePoints(this.earlier());
  }

  // The gauge points that were chosen before.
  earlier() { return this.tool.value === "gauge" ? extensometer.points : []; }

  end() {
    clearInterval(this.playing);
    this.marks.end();
  }

  controls() {
    const zoom = (id, text, factor, name) => make("button", { type: "button", id, "aria-label": name, onclick: () => this.map.zoom(factor) }, text);
    return make("div", {},
      make("div", { class: "row" }, make("label", {}, t("Step"), this.step), make("label", {}, t("Map"), this.quantity),
        make("label", {}, t("Colours"), this.palette), make("label", {}, t("Tool"), this.tool)),
      make("div", { class: "row" }, this.slider, this.player, ...this.boxes, zoom("zoom-in", "+", 1.5, t("Magnify")), zoom("zoom-out", "−", 1 / 1.5, t("Reduce")), zoom("zoom-whole", t("Whole map"), 0, t("Whole map"))));
  }

  // Shows the step with this number in the list; the last one is followed.
  goTo(index) {
    this.step.selectedIndex = index;
    kept.step = this.step.value;
    kept.follow = index === this.step.length - 1;
    this.slider.value = index;
    this.load();
  }

  // Shows one step after the other to the last; a step that is still being read is waited for.
  play() {
    const isPlaying = Boolean(this.playing);
    clearInterval(this.playing);
    this.playing = null;
    this.player.textContent = t("Play");
    if (isPlaying || this.step.length < 2) return;
    this.player.textContent = t("Pause");
    if (this.step.selectedIndex === this.step.length - 1) this.goTo(0);
    this.playing = setInterval(() => {
      if (this.loading) return;
      if (this.step.selectedIndex < this.step.length - 1) this.goTo(this.step.selectedIndex + 1);
      if (this.step.selectedIndex === this.step.length - 1) this.play();
    }, PLAY_MS);
  }

  scale() {
    return make("div", {},
      make("div", { class: "bar" }, this.lowText = make("span"), this.bar, this.highText = make("span")), this.linesText,
      make("div", { class: "row" }, make("label", {}, t("from"), this.low.input), make("label", {}, t("to"), this.high.input),
        make("button", { onclick: () => { this.auto(); this.paint(); } }, t("Range of this map"))));
  }

  takeQuantities(found) {
    this.quantities = found;
    const first = PREFERRED.find((name) => found.some((each) => each.name === name));
    options(this.quantity, found.map(({ name, meaning }) => [name, `${name}: ${known(meaning)}`]), kept.quantity || first);
    this.takeSteps(this.steps);
  }

  takeSteps(steps) {
    if (kept.test !== shownTest()) [kept.test, kept.follow, kept.step, this.tiles, this.fixed] = [shownTest(), true, null, {}, false];
    if (steps.length < this.steps.length) this.tiles = {}; // another experiment begins
    this.steps = steps;
    const level = this.quantities.find(({ name }) => name === this.quantity.value)?.level ?? 1;
    const mapped = steps.filter((step) => step.mapped >= level).map((step) => [step.step, String(step.step)]);
    if (kept.follow) kept.step = mapped.at(-1)?.[0] ?? null;
    const isThere = kept.step === null || mapped.some(([step]) => String(step) === String(kept.step));
    options(this.step, isThere ? mapped : [...mapped, [kept.step, t("{step}: has no such map", { step: kept.step })]], kept.step);
    this.slider.max = Math.max(mapped.length - 1, 0);
    this.slider.value = this.step.selectedIndex;
    this.player.disabled = mapped.length < 2;
    if (!mapped.length) this.readout.textContent = t("No step has been measured yet.");
    else if (!isThere) this.forget(t("Step {step} has no map {map}.", { step: kept.step, map: this.quantity.value }));
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
    const key = `${shownTest()}/${step}/${name}`;
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
    this.paintBelow();
    this.loadPosition();
    this.marks.show({ step: Number(step), quantity: this.chosen });
  }

  // A tile that is read once for all steps that show it; null without it.
  once(step, name) {
    const key = `${step}/${name}`, { tiles } = this;
    tiles[key] ??= tile(step, name).catch(() => { delete tiles[key]; return null; }); // it may come later
    return tiles[key];
  }

  async loadPosition() {
    const step = this.shown, [x, y] = await Promise.all([this.once(step, "x"), this.once(step, "y")]);
    if (step !== this.shown) return;
    this.places = x && y ? [x, y] : null;
    this.read(this.map.place());
  }

  // The surface in the reference image, in which the maps are measured; where it is not kept, that of the step.
  async paintBelow() {
    const step = this.shown, reference = this.steps.find((each) => each.step === Number(step))?.reference_step ?? step;
    const image = kept.over && step !== undefined ? (await this.once(reference, "texture")) ?? (await this.once(step, "texture")) : null;
    if (step !== this.shown) return;
    this.map.showBelow(image, image ? usualRange(image.values) : undefined);
    if (kept.over && step !== undefined && !image) this.position.textContent = t("The image of the surface is not kept for this step.");
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
    const text = (value) => decimal(Number((value / this.chosen.factor).toPrecision(4)));
    [this.low.input.value, this.high.input.value] = [text(low), text(high)];
  }

  paint() {
    const [low, high] = [this.low.found(), this.high.found()];
    if (!this.values || !Number.isFinite(low) || !Number.isFinite(high)) return;
    const { factor, unit, meaning } = this.chosen, colours = this.colours[this.palette.value];
    this.map.show(this.values, colours, low * factor, high * factor, t("{map}, step {step}", { map: known(meaning), step: this.shown }));
    const { pace, levels } = kept.lines ? levelsBetween(low, high) : { levels: [] };
    this.linesText.textContent = levels.length ? t("Isolines every {pace}.", { pace: `${number(pace)} ${unit}` }) : "";
    const lines = levels.length ? isolines(this.values, levels.map((each) => each * factor)) : "";
    this.map.mark(this.points, { kept: this.marks.marks, lines, closed: this.closed });
    this.lowText.textContent = `${number(low)} ${unit}`;
    this.highText.textContent = `${number(high)} ${unit}`;
    colourBar(this.bar, colours);
  }

  read(place) {
    const millimetres = place && this.places ? this.places.map((each) => scaled(valueAt(each, place), 1e3)) : [];
    this.position.textContent = millimetres.every(Number.isFinite) && millimetres.length ? `x = ${number(millimetres[0], 4)} mm, y = ${number(millimetres[1], 4)} mm` : "";
    if (!place || !this.values) { this.readout.textContent = t("Point at the map: value ± standard deviation"); return; }
    const { factor, unit, name } = this.chosen, sigma = this.sigma ? valueAt(this.sigma, place) / factor : NaN;
    const smoothed = this.resolution ? valueAt(this.resolution, place) / factor : NaN;
    const value = withSigma(valueAt(this.values, place) / factor, sigma, unit);
    const read = sigma > 0 && Number.isFinite(smoothed) ? t("{value} noise, up to {error} smoothing,", { value, error: `${number(smoothed, 2)} ${unit}` }) : value;
    this.readout.textContent = `${name} = ${t("{value} at column {column}, row {row}", { value: read, ...place })}`;
  }

  click({ column, row }, clicks) {
    const tool = this.tool.value, added = [...this.points, [column, row]];
    if (tool === "look") return;
    if (tool === "point") this.choosePoints([[column, row]]);
    else if (tool === "area") this.addCorner(added, clicks);
    else this.choosePoints(this.points.length === 1 ? added : [[column, row]]);
  }

  // A double click, whose second click is at the last corner again, closes the area; the next click begins another.
  addCorner(added, clicks) {
    if (clicks > 1 && this.points.length >= 3) this.choosePoints(this.points, true);
    else if (clicks === 1) this.choosePoints(this.closed ? added.slice(-1) : added);
  }

  choosePoints(points, closed = false) {
    [this.points, this.closed] = [points, closed];
    const tool = this.tool.value, least = { profile: 2, gauge: 2, point: 1, area: 3 }[tool];
    if (tool === "gauge") extensometer.points = points;
    this.map.mark(points, { closed });
    this.marks.draw(points.length >= least ? MARK_OF[tool] : "", points);
    const asked = { look: t("Choose a tool to draw a profile, an extensometer, a point or an area."), profile: t("Click both ends of the line."), gauge: t("Click both gauge points."),
      point: t("Click a point, then keep it as a mark."), area: t("Click the corners; then keep the area as a mark.") };
    this.probe();
    if (points.length < 2 || !(tool in this.probes())) this.result.replaceChildren(make("h2", {}, t("Probe")), make("p", { class: "soft" }, asked[tool]));
  }

  probes() { return { profile: () => this.profile(), gauge: () => this.extensometer() }; }

  async probe() {
    const asked = this.points.length < 2 || !this.values ? null : this.probes()[this.tool.value]?.() ?? null;
    const shown = await tried(this.latestProbe(asked));
    if (shown) this.result.replaceChildren(...shown);
  }

  async profile() {
    const { name, unit, factor, meaning } = this.chosen, found = await line(this.shown, name, ...this.points);
    const inMillimetres = found.distance?.some((each) => each !== null), along = inMillimetres ? found.distance.map((each) => scaled(each, 1e3)) : found.position;
    const points = along.map((at, k) => [at, scaled(found.value[k], 1 / factor), scaled(found.sigma?.[k], 1 / factor)]);
    return [make("h2", {}, t("Profile of {map}", { map: name })), make("p", { class: "soft" }, t("{map}; the band is ± 2 standard deviations.", { map: known(meaning) })),
      chart(points, { x: t("distance [{unit}]", { unit: inMillimetres ? "mm" : "px" }), y: `${name} [${unit}]` })];
  }

  async extensometer() {
    const found = await strains();
    const points = found.map(({ step, strain, sigma_strain }) => [step, scaled(strain, 1e6), scaled(sigma_strain, 1e6)]);
    const { strain, sigma_strain, length } = found.find(({ step }) => step === Number(this.shown)) ?? {};
    return [make("h2", {}, t("Extensometer")),
      make("p", { id: "strain" }, t("Step {step}: {strain}, length {length} mm", { step: this.shown, strain: withSigma(scaled(strain, 1e6), scaled(sigma_strain, 1e6), "µstrain"), length: number(scaled(length, 1e3), 5) })),
      chart(points, { x: t("step"), y: t("strain [µstrain]") })];
  }
}
