// Points, extensometers, lines and areas with names, their readings on the map that is shown, and notes on its step. They are kept with the test.

import { button, notDriving } from "./buttons.js";
import { chart } from "./chart.js";
import { keep, make, number, patch, scaled, withSigma } from "./elements.js";
import { t } from "./language.js";
import { command, newest, readings, say, tried } from "./server.js";
import { listenShown, replaceShown, shown, shownTest } from "./shown.js";
import { listen } from "./stream.js";

const STRAIN = { factor: 1e-6, unit: "µstrain" };
const KINDS = { point: t("point"), gauge: t("extensometer"), line: t("line"), area: t("area") };

export class MarksPanel {
  // `changed` is called when other marks are to be drawn.
  constructor(changed) {
    this.changed = changed;
    this.marks = [];
    this.notes = {};
    this.noteOf = {}; // step and test of the note that is shown
    this.turn = newest();
    this.curveTurn = newest();
    this.name = keep(make("input", { id: "mark-name", type: "text", maxlength: 60, placeholder: t("name") }));
    this.note = keep(make("textarea", { id: "note", maxlength: 4000, class: "note", "aria-label": t("Note on this step") }));
    this.note.addEventListener("change", () => this.keepNote());
    this.table = make("div", { class: "scroll" });
    this.curve = make("div");
    this.tools = make("div", { class: "row" });
    this.noteTitle = make("h3");
    this.element = make("section", { class: "panel", id: "marks" }, make("h2", {}, t("Marks")), this.tools, this.table, this.curve, this.noteTitle, this.note);
    this.ends = [listenShown("marks", (found) => this.take(found ?? {})), listen("wheel", () => this.paint())];
  }

  end() { this.ends.forEach((end) => end()); }

  take({ marks = [], notes = {} }) {
    const isNew = JSON.stringify(marks) !== JSON.stringify(this.marks);
    [this.marks, this.notes] = [marks, notes];
    if (isNew) { this.changed(); this.read(); }
    this.paint();
  }

  // The map that is shown: its step and its quantity; and what is drawn now and could be kept.
  show({ step, quantity }) {
    [this.step, this.quantity] = [step, quantity];
    this.read();
    this.paint();
  }

  draw(kind, points) {
    this.drawn = kind && points.length ? { kind, points } : null;
    this.paint();
  }

  async read() {
    if (!this.marks.length || !this.quantity) { this.found = []; this.paint(); return; }
    const found = await tried(this.turn(readings(this.quantity.name, this.marks, [Number(this.step)])));
    if (!found) return;
    this.found = found.map(([reading]) => reading);
    this.paint();
    if (this.plotted) this.plot(this.plotted);
  }

  // The unit of a mark: an extensometer reads strain, the others the map.
  unitOf(mark) { return mark.kind === "gauge" ? STRAIN : this.quantity; }

  async plot(name) {
    this.plotted = name;
    const mark = this.marks.find((each) => each.name === name);
    if (!mark) { this.plotted = null; patch(this.curve); return; }
    const answer = await tried(this.curveTurn(readings(this.quantity.name, [mark])));
    if (!answer) return;
    const { factor, unit } = this.unitOf(mark);
    const points = answer[0].map(({ step, value, sigma }) => [step, scaled(value, 1 / factor), scaled(sigma, 1 / factor)]);
    patch(this.curve, chart(points, { x: t("step"), y: `${name} [${unit}]` }));
  }

  paint() {
    const why = notDriving() || (this.drawn ? "" : t("Draw a point, an extensometer, a line or an area first."));
    patch(this.tools, make("label", {}, t("Name"), this.name), button(t("Keep this mark"), { id: "keep-mark", why, onclick: () => this.add() }));
    const head = make("tr", {}, ...[t("name"), t("kind"), t("value"), t("minimum"), t("maximum"), t("measured")].map((name, k) => make("th", { class: k < 2 ? "words" : "" }, name)), make("th"));
    patch(this.table, this.marks.length ? make("table", {}, head, ...this.marks.map((mark, k) => this.row(mark, this.found?.[k]))) : make("p", { class: "soft" }, t("None yet: choose a tool, click the map, and keep what you have drawn.")));
    if (!this.marks.some(({ name }) => name === this.plotted)) patch(this.curve);
    const test = shownTest(), { step, ofTest } = this.noteOf, isWritten = document.activeElement === this.note && ofTest === test && this.note.value !== (this.notes[step] ?? "");
    if (!isWritten) { // a note that is being written stays that of its step while the next one is measured
      this.noteOf = { step: this.step, ofTest: test };
      this.note.value = this.notes[this.step] ?? "";
    }
    this.noteTitle.textContent = this.noteOf.step === undefined ? "" : t("Note on step {step}", { step: this.noteOf.step });
    this.note.hidden = this.noteOf.step === undefined;
    this.note.readOnly = Boolean(notDriving());
  }

  row(mark, reading) {
    const { factor = 1, unit = "" } = this.unitOf(mark) ?? {}, valueOf = (name) => (reading?.[name] === undefined ? "–" : number(scaled(reading[name], 1 / factor), 4));
    const words = !reading ? "" : reading.problem ?? withSigma(scaled(reading.value, 1 / factor), scaled(reading.sigma, 1 / factor), unit);
    const cells = [valueOf("minimum"), valueOf("maximum"), reading?.measured === undefined ? "–" : `${number(100 * reading.measured)} %`];
    return make("tr", { "data-key": mark.name }, make("td", { class: "words" }, mark.name), make("td", { class: "words" }, KINDS[mark.kind]),
      make("td", { class: reading?.problem ? "bad words" : "", lang: reading?.problem ? "en" : null }, words), ...cells.map((text) => make("td", {}, text)),
      make("td", {}, make("span", { class: "row" }, button(t("Curve"), { "data-key": "curve", onclick: () => this.plot(mark.name) }),
        button(t("Delete"), { "data-key": "delete", why: notDriving(), "aria-label": t("Delete {name}", { name: mark.name }), onclick: () => this.keep(this.marks.filter((each) => each !== mark)) }))));
  }

  add() {
    const names = this.marks.map(({ name }) => name), count = names.length + 1;
    const name = this.name.value.trim() || [...Array(count + 1).keys()].map((k) => `${KINDS[this.drawn.kind]} ${k + 1}`).find((each) => !names.includes(each));
    if (names.includes(name)) return say(t("There is a mark {name} already: give another name.", { name }));
    return this.keep([...this.marks, { name, ...this.drawn }]).then((answer) => { if (answer !== null) this.name.value = ""; return answer; });
  }

  keepNote() {
    const { step } = this.noteOf, notes = { ...this.notes, [step]: this.note.value };
    if (!this.note.value.trim()) delete notes[step];
    return this.keep(this.marks, notes);
  }

  // Keeps marks and notes with the test; shown when the server has them.
  async keep(marks, notes = this.notes) {
    const test = shownTest(), answer = await command("marks", { test, marks, notes });
    if (answer !== null && test === shownTest()) { // else another test is looked at meanwhile
      if (test) replaceShown("marks", { ...shown("marks"), marks, notes });
      else this.take({ marks, notes });
    }
    return answer;
  }
}
