// Other settings for a test: previewed on one step, then computed as a named evaluation beside its results; and exports.

import { button, notDriving } from "./buttons.js";
import { keep, make, options, patch } from "./elements.js";
import { decimal, known, language, spoken, t } from "./language.js";
import { numberField, numbersField } from "./numbers.js";
import { evaluations, newest, post, refused, say, tried } from "./server.js";
import { shownTest } from "./shown.js";
import { latest, listen } from "./stream.js";

const POLL_MS = 2000;
const KEYS = { window: "dic.window", spacing: "dic.spacing", strain_window: "coupling.strain_window_px", z_filter: "coupling.z_filter_px" };
const FORMATS = { png: t("pictures (PNG)"), csv: t("tables (CSV)"), gif: t("video (GIF)"), vtk: t("ParaView (VTK)"), mat: "MATLAB", tiff: t("maps (TIFF)") };
const OUT_OF_FORM = t("A field has no valid value: point at the marked one to read why.");
let kept = null; // the view stays as it was left

export function show(place) {
  kept ??= new EvaluateView();
  place.replaceChildren(kept.element);
  return kept.enter();
}

class EvaluateView {
  constructor() {
    this.known = null;
    this.opened = ""; // the earlier test that was opened last in the maps
    this.none = "";
    this.newest = newest();
    const change = () => patch(this.seen);
    this.test = keep(make("select", { id: "test", onchange: () => this.look() }));
    this.step = keep(make("select", { id: "preview-step" }));
    this.sensor = keep(make("select", { id: "sensor", onchange: () => this.look() }));
    this.sensors = make("div", { class: "row", hidden: true }, make("label", {}, t("Sensor"), " ", this.sensor));
    this.fields = {
      window: numberField({ id: "window", min: 8, max: 1000, whole: true, changed: change }),
      spacing: numberField({ id: "spacing", min: 1, max: 100, whole: true, changed: change }),
      strain_window: numberField({ id: "strain-window", min: 3, max: 5000, whole: true, changed: change }),
      z_filter: numberField({ id: "z-filter", min: 0, max: 100, changed: change }),
      reference: numberField({ id: "reference", min: 0, whole: true, changed: change }),
      region: numbersField({ id: "region", count: 4, changed: change, placeholder: t("left; top; right; bottom") }),
      gauge: numbersField({ id: "gauge", count: 4, changed: change, placeholder: t("column; row; column; row") }),
    };
    const text = (attributes) => keep(make("input", { type: "text", autocomplete: "off", ...attributes }));
    this.name = text({ id: "name", maxlength: 60, placeholder: t("fine") });
    this.note = text({ id: "note", maxlength: 500, placeholder: t("why") });
    this.actions = make("div", { class: "row" });
    this.seen = make("div", { id: "previewed" });
    this.list = make("ol", { class: "list", id: "evaluations" });
    this.format = keep(make("select", { id: "format", onchange: () => this.paint() }));
    options(this.format, Object.entries(FORMATS));
    this.exported = keep(make("select", { id: "exported", onchange: () => this.paint() }));
    this.exportedStep = keep(make("select", { id: "exported-step", onchange: () => this.paint() }));
    this.exports = make("div", { class: "row" });
    this.notes = {};
    const row = (title, key, unit) => make("label", {}, `${title} `, this.fields[key].input, unit ? ` ${unit}` : "", this.notes[key] = make("span", { class: "soft" }));
    this.element = make("div", { class: "columns" },
      make("section", {},
        make("div", { class: "panel" },
          make("div", { class: "row" }, make("label", {}, t("Test"), " ", this.test), make("label", {}, t("Preview on step"), " ", this.step)),
          this.sensors,
          make("p", { class: "soft" }, t("An empty field leaves the setting as it was recorded.")),
          make("div", { class: "row" }, row(t("Window"), "window", "px"), row(t("Spacing"), "spacing", "px"), row(t("Strain window"), "strain_window", "px"), row(t("Filter of heights"), "z_filter", "px")),
          make("div", { class: "row" }, row(t("Reference step"), "reference"), row(t("Region"), "region", "px"), row(t("Extensometer"), "gauge", "px")),
          make("div", { class: "row" }, make("label", {}, t("Name"), " ", this.name), make("label", {}, t("Note"), " ", this.note)),
          this.actions),
        this.seen),
      make("section", {},
        make("div", { class: "panel" }, make("h2", {}, t("Evaluations")), make("p", { class: "soft" }, t("The results of the run are never changed.")), this.list),
        make("div", { class: "panel" }, make("h2", {}, t("Export")),
          make("div", { class: "row" }, make("label", {}, t("Results"), " ", this.exported), make("label", {}, t("Steps"), " ", this.exportedStep), make("label", {}, t("Format"), " ", this.format), this.exports))));
  }

  enter() {
    this.tests();
    const test = shownTest();
    if (test && test !== this.opened) this.test.value = `test ${test}`;
    this.opened = test;
    this.look();
    const timer = setInterval(() => { if (this.known?.job?.state === "runs") this.look(); }, POLL_MS);
    const ends = [listen("tests", () => this.tests()), listen("wheel", () => this.paint()), () => clearInterval(timer)];
    return () => ends.forEach((end) => end());
  }

  tests() {
    const named = (latest("tests") ?? []).map(({ name }) => [`test ${name}`, name]);
    options(this.test, latest("rig")?.kind === "recording" || !named.length ? [["run", t("this test")]] : named);
  }

  async look() {
    const folder = this.test.value;
    if (this.known?.folder !== folder) { // nothing is previewed or exported of another test
      this.known = null;
      this.none = t("The results are being read.");
      patch(this.seen);
      this.paint();
    }
    const found = await tried(this.newest(evaluations(folder, this.chosenSensor())));
    if (!found) {
      if (folder === this.test.value && !this.known) { this.none = t("This test has no results."); this.paint(); }
      return;
    }
    const was = this.known?.job?.state;
    this.known = { ...found, folder };
    options(this.sensor, found.sensors.map((name) => [name, name]), found.sensor);
    this.sensors.hidden = found.sensors.length < 2;
    options(this.step, found.steps.map((step) => [step, step]), this.step.value || found.steps.at(-1));
    options(this.exported, [["", t("of the run")], ...found.evaluations.map(({ name }) => [name, name])]);
    options(this.exportedStep, [["", t("all")], ...found.steps.map((step) => [step, step])]);
    for (const [key, value] of Object.entries(found.settings)) this.notes[key].textContent = value === null ? "" : ` ${t("(was {value})", { value: decimal(value) })}`;
    if (was === "runs" && found.job.state !== "runs") say(known(found.job.words), { lang: spoken(found.job.words) ?? language });
    this.paint();
  }

  // The sensor of a test with several; another test has others.
  chosenSensor() {
    return this.known && !this.sensors.hidden ? this.sensor.value : "";
  }

  // The settings of the fields, or null when one has no valid value.
  settings() {
    const values = Object.fromEntries(Object.entries(this.fields).map(([key, { found }]) => [key, found()]));
    if (Object.values(values).includes(undefined)) { say(OUT_OF_FORM); return null; }
    const overrides = Object.fromEntries(Object.entries(KEYS).filter(([key]) => values[key] !== null).map(([key, name]) => [name, values[key]]));
    const [left, top, right, bottom] = values.region ?? [], [width, height] = this.known.size ?? [];
    const corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
    return {
      overrides,
      reference: values.reference,
      region: values.region ? JSON.stringify({ width, height, polygons: [{ points: corners, hole: false }] }) : "",
      gauges: values.gauge ? [{ name: "1", first: values.gauge.slice(0, 2), second: values.gauge.slice(2) }] : null,
      sensor: this.chosenSensor(),
      note: this.note.value.trim(),
    };
  }

  async preview() {
    const settings = this.settings();
    if (!settings) return;
    patch(this.seen, make("p", { class: "soft", role: "status" }, t("Step {step} is measured with these settings…", { step: this.step.value })));
    const found = await tried(this.send("/preview", { step: Number(this.step.value), settings }));
    if (!found) { patch(this.seen); return; }
    const picture = (name) => make("img", { src: `/preview/${name}?${found.made}`, alt: name === "before" ? t("maps before") : t("maps after") });
    patch(this.seen, make("div", { class: "panel" },
      make("div", { class: "scroll" }, make("table", {},
        make("thead", {}, make("tr", {}, ...["", t("before"), t("with the settings")].map((each) => make("th", {}, each)))),
        make("tbody", {}, ...found.rows.map(({ quantity, unit, before, after }) => make("tr", {}, make("td", { lang: "en" }, `${quantity} [${unit}]`), ...[before, after].map((each) => make("td", {}, decimal(each)))))))),
      ...(found.pictures ? [picture("before"), picture("after")] : [])));
  }

  async evaluate() {
    const settings = this.settings(), name = this.name.value.trim();
    if (!settings) return;
    const found = await tried(this.send("", { name, settings }));
    if (found) say(known(found.message), { lang: spoken(found.message) ?? language });
    await this.look();
  }

  async send(path, content) {
    const answer = await post(`/evaluations/${encodeURIComponent(this.known.folder)}${path}`, content);
    if (!answer.ok) throw await refused(answer);
    return answer.json();
  }

  paint() {
    const { evaluations: made = [], job = {}, folder = "" } = this.known ?? {};
    const none = this.known ? "" : this.none, runs = job.state === "runs" ? t("{evaluation} is being computed.", { evaluation: job.name }) : "";
    patch(this.actions,
      button(t("Preview"), { id: "preview", why: none || runs, onclick: () => this.preview() }),
      button(t("Evaluate all steps"), { id: "evaluate", class: "main", why: notDriving() || none || runs, onclick: () => this.evaluate() }));
    const at = `/evaluations/${encodeURIComponent(folder)}`;
    patch(this.list,
      job.state === "runs" ? make("li", { class: "now", "data-key": "job" }, t("{evaluation} is being computed.", { evaluation: job.name }), make("progress", { "aria-label": t("progress") })) : null,
      job.state === "failed" ? make("li", { class: "bad", "data-key": "job", lang: spoken(job.words) }, `${job.name}: ${known(job.words)}`) : null,
      ...made.map(({ name, changes, report }) => make("li", { class: "good", "data-key": `of-${name}` }, make("strong", {}, name),
        make("p", { class: "soft", lang: spoken(changes) }, changes || t("as recorded")),
        report ? make("a", { href: `${at}/${encodeURIComponent(name)}/report`, target: "_blank", rel: "noopener" }, t("Report")) : null)));
    const query = new URLSearchParams({ format: this.format.value, evaluation: this.exported.value, step: this.exportedStep.value, sensor: this.chosenSensor() });
    patch(this.exports, none ? make("span", { class: "soft" }, none)
      : make("a", { href: `/export/${encodeURIComponent(folder)}?${query}`, id: "download", download: "" }, t("Download")));
  }
}
