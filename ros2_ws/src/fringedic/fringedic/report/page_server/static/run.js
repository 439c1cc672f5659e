// Runs a programme: chosen, checked and shown before it can be started; then its steps; state of machine and recorder.

import { alarmsPanel } from "./alarms.js";
import { button, notDriving } from "./buttons.js";
import { chart } from "./chart.js";
import { keep, make, number, patch, scaled } from "./elements.js";
import { decimal, known, spoken, t } from "./language.js";
import { LiveImage } from "./live_image.js";
import { cannotStart, duration, FAILED, isBusy, procedurePanel } from "./procedure.js";
import { ProgrammeForm } from "./programme_form.js";
import { checkProgramme, command, composeProgramme, newest, start, tried } from "./server.js";
import { latest, listen } from "./stream.js";
import { formParts, testAnswers } from "./test_form.js";

const WRITTEN_MS = 400; // without a key, after which a programme that is being written is checked
const FIRST = "experiment: test\nramp:\n  to_mm: 1.0\n  steps: 11\n";
const MANY = "…"; // in place of the numbers of steps from a measured move on, whose number of stacks is not known before
const MODES = { fringes: t("fringes"), white: t("white"), moving: t("moving") };
const STEPS_S = 0.5; // between two steps of the curve that are done at the same place

export function show(place) {
  const image = new LiveImage(), procedure = procedurePanel(["run", "by_hand"]), alarms = alarmsPanel();
  const panel = make("div", { class: "panel", id: "start" }), steps = make("div", { class: "panel scroll" }, make("table", { id: "steps" }));
  const facts = make("dl", { class: "panel", id: "facts" });
  place.replaceChildren(make("div", { class: "columns" },
    make("section", {}, panel, procedure.element, steps), make("section", {}, facts, alarms.element, image.element)));
  const paint = () => {
    patch(panel, ...startParts());
    patch(steps.firstChild, ...rows());
    steps.hidden = steps.firstChild.childElementCount < 2;
    patch(facts, ...factList());
  };
  repaint = paint;
  const topics = ["rig", "procedure", "steps", "step", "load", "signals", "recorder", "hand", "nodes", "wheel", "tests"];
  const ends = [() => image.end(), procedure.end, alarms.end, () => { repaint = () => {}; }, ...topics.map((topic) => listen(topic, paint)), listen("rig", checkAgain)];
  return () => ends.forEach((end) => end());
}

// The one programme that is shown, checked and started: that of the rig file, or the text.
let repaint = () => {}, isOwn = false, checked = null, of = null, writing = 0;
let planned = { rows: [], count: 0 }; // by the last check: its place is kept during the next one, so that what is below stays
const inTurn = newest();
const text = keep(make("textarea", { id: "programme", "aria-label": t("Programme in place of that of the rig file"), placeholder: "ramp: {to_mm: 1.0, steps: 11}" }));
text.addEventListener("input", () => {
  inTurn(null); // the answer about the text before is not about this one
  checked = null;
  form.isBehind = true;
  repaint();
  clearTimeout(writing);
  writing = setTimeout(check, WRITTEN_MS);
});

// The form and the text are two views of one programme; the server writes the text of a changed form, and reads each text.
const form = new ProgrammeForm(async (programme) => {
  inTurn(null);
  checked = null;
  repaint();
  const composed = await tried(inOrder(composeProgramme(programme)));
  if (composed === null) return;
  text.value = composed;
  check();
});
const inOrder = newest();
keep(form.element);

const selected = () => (isOwn ? text.value : "");

function choose(own) {
  isOwn = own;
  check();
}

// Checks the programme again when the rig file has changed.
function checkAgain(rig) {
  const state = `${rig.file} ${rig.changed} ${rig.file_error}`;
  if (state !== of && rig.operated) {
    of = state;
    check();
  }
}

async function check() {
  checked = null;
  repaint();
  if (isOwn && !selected().trim()) checked = { rows: [], count: 0, words: "", programme: null, problem: t("Write a programme, or choose that of the rig file.") };
  else checked = await inTurn(checkProgramme(selected())).catch((error) => ({ rows: [], count: 0, words: "", problem: error.message })) ?? checked;
  if (checked) planned = checked;
  if (isOwn && checked?.programme !== undefined) form.show(checked.programme);
  repaint();
}

// Begins a programme of one's own with that of the rig file, or with a ramp.
async function chooseOwn() {
  if (!text.value.trim()) text.value = checked?.text?.trim() ? checked.text : FIRST;
  choose(true);
}

const cannotRun = () => cannotStart() || (!checked ? t("The programme is being checked.") : checked.problem);

function startParts() {
  const rig = latest("rig") ?? {}, procedure = latest("procedure"), busy = isBusy(procedure), operated = rig.operated;
  // a stop, or a fault of the machine, ends a programme: only a person may go on with it
  const ended = !busy && procedure?.procedure === "run" && procedure.state === FAILED && procedure.words.length && procedure.folder;
  return [
    make("h2", {}, t("Test")),
    rig.file_error ? make("p", { class: "bad", id: "file-error", lang: "en" }, rig.file_error) : null,
    ...(operated && !busy ? [...formParts(), ...programmeParts()] : []), // else the table of the steps is what one looks at
    rig.load_frame && !busy ? make("p", { class: "care" }, t("Before the start: the limits of the machine are set, its emergency stop was tested, and nobody is in the frame.")) : null,
    make("div", { class: "row", "data-key": "begin" },
      button(t("Start the programme"), { class: "main", id: "run", why: cannotRun(), onclick: () => begin({ procedure: "run", text: selected() }) }),
      ended ? button(t("Go on with the last run"), { id: "go-on", why: cannotRun(), onclick: () => start({ procedure: "run", text: selected(), options: { continue_run: procedure.folder } }) }) : null,
      button(t("Measure by hand"), { id: "by-hand", why: cannotStart(), onclick: () => begin({ procedure: "by_hand" }) }),
      button(t("Measure one step"), { id: "measure", class: busy && procedure.procedure === "by_hand" ? "main" : "", why: cannotMeasure(), onclick: () => command("measure", {}) })),
    operated && !busy ? seriesFold() : null,
    ended && rig.load_frame ? make("p", { class: "care" }, t("Before you go on with a run that was stopped: find out why, look at machine and specimen, and reset the machine at its own controls.")) : null,
    latest("hand") ? make("p", { id: "hand", role: "status", lang: spoken(latest("hand")) }, known(latest("hand"))) : null,
    operated ? null : make("p", { class: "soft", id: "elsewhere" }, elsewhere(rig)),
  ];
}

// Starts a test of the specimen of the form.
function begin(content) {
  const test = testAnswers();
  return test && start(Object.keys(test).length ? { ...content, options: { test } } : content);
}

// Plans one test per line with the form and the programme that are shown.
function planSeries() {
  const test = testAnswers();
  return test && command("series", { specimens: names.value.split("\n").map((name) => name.trim()).filter(Boolean), answers: test, text: selected() });
}

const names = keep(make("textarea", { id: "series-names", "aria-label": t("Specimens of the series, one per line"), placeholder: "plate 1\nplate 2\nplate 3" }));

const seriesFold = () => make("details", { id: "series-fold" }, make("summary", {}, t("Series of specimens")),
  make("p", { class: "soft" }, t("One specimen per line. Each gets a test with this form and programme, by one click in Tests.")), names,
  button(t("Plan the series"), { id: "plan-series", why: notDriving(), onclick: planSeries }));

function cannotMeasure() {
  const rig = latest("rig") ?? {}, procedure = latest("procedure"), by_hand = isBusy(procedure) && procedure.procedure === "by_hand";
  if (rig.operated && !by_hand) return t("First start measuring by hand.");
  if (rig.operated && procedure.step < 0) return t("The nodes are not ready yet: {activity}.", { activity: known(procedure.activity) || t("they start") });
  if (!rig.measures) return t("No experiment node runs.");
  return notDriving();
}

// The choice of the programme, and what it will do as a table and as a curve.
function programmeParts() {
  const rig = latest("rig") ?? {};
  const choice = (id, own, label) => make("label", {}, make("input", { type: "radio", name: "programme", id, checked: isOwn === own, onchange: () => (own ? chooseOwn() : choose(false)) }), label);
  const found = checked ?? { ...planned, words: "", problem: "" };
  return [
    make("fieldset", { class: "row" }, make("legend", {}, t("Programme")), choice("of-file", false, rig.file ? t("of {file}", { file: rig.file }) : t("of the rig file")), choice("own", true, t("written here"))),
    isOwn ? form.element : null,
    isOwn ? make("details", { id: "yaml", open: true }, make("summary", {}, t("The same as text (YAML)")), text) : null,
    found.problem && found.problem === rig.file_error ? null : found.problem ? make("p", { class: "bad", id: "problem", role: "status", lang: spoken(found.problem) }, known(found.problem))
      : make("p", { class: "soft", id: "forecast", role: "status", lang: spoken(found.words) }, checked ? found.words : t("The programme is being checked.")),
    found.rows.length ? make("div", { class: `plan${checked ? "" : " unknown"}`, "data-key": "plan" }, planCurve(found.rows), make("details", { id: "plan" },
      make("summary", {}, t("Steps: {count}", { count: found.count })), make("div", { class: "scroll" }, make("table", {}, ...planRows(found))))) : null,
  ];
}

function planRows({ rows, count }) {
  const head = [t("step"), t("target [mm]"), t("speed [mm/s]"), t("hold [s]")].map((name) => make("th", {}, name));
  let measured = 0;
  const lines = rows.map(({ position_mm, speed_mm_per_s, hold_s, mode, set_reference, until }) => {
    const words = [mode === "none" ? t("not measured") : MODES[mode] ?? mode, set_reference ? t("new reference") : "", until ? t("ends earlier by its condition") : ""];
    const values = [position_mm, position_mm === null ? null : speed_mm_per_s, hold_s].map((value) => make("td", {}, number(value, 6)));
    const name = mode === "none" ? "–" : mode === "moving" && measured !== MANY ? `${measured}, ${MANY}` : String(measured);
    if (mode === "moving") measured = MANY;
    else if (mode !== "none" && measured !== MANY) measured++;
    return make("tr", {}, make("td", {}, name), ...values, make("td", { class: "words" }, words.filter(Boolean).join(", ")));
  });
  const more = count > rows.length ? [make("tr", {}, make("td", { class: "words", colspan: 5 }, t("and {count} more", { count: count - rows.length })))] : [];
  return [make("tr", {}, ...head, make("th", { class: "words" }, t("measurement"))), ...lines, ...more];
}

// Crosshead position over time; the time of the measurements is not in it.
function planCurve(rows) {
  if (!rows.some((row) => row.position_mm !== null)) return null;
  let time = 0, position = 0;
  const points = [[0, 0]];
  for (const { position_mm, speed_mm_per_s, hold_s } of rows) {
    if (position_mm !== null) {
      time += Math.abs(position_mm - position) / speed_mm_per_s;
      position = position_mm;
      points.push([time, position]);
    }
    time += hold_s + STEPS_S;
    points.push([time, position]);
  }
  return chart(points, { x: t("time without measurements [s]"), y: t("crosshead [mm]"), dots: false });
}

function elsewhere(rig) {
  return (latest("nodes") ?? []).length || rig.measures ? t("This rig was started elsewhere: its procedures run there.")
    : t("No node of this rig runs: start it, for example with fringedic run or ros2 launch, or end this page and start it without --attach.");
}

const STATES = { failed: "bad", measured: "good" };

// The steps of the programme that runs, or ran last, or of the session by hand; a new list of steps is chosen above.
function rows() {
  const planned = (latest("rig")?.running ?? []).filter(({ mode }) => mode !== "none"), steps = latest("steps") ?? [], procedure = latest("procedure");
  const running = isBusy(procedure) && procedure.procedure === "run";
  const reports = procedure?.procedure === "run" ? procedure.reports : [];
  const head = make("tr", {}, ...[t("step"), t("target [mm]"), t("position [mm]"), t("force [N]"), t("measured [%]")].map((name) => make("th", {}, name)), make("th", { class: "words" }, t("state")));
  // a programme with another number of steps is not the one whose targets are known: another page has started it
  const programme = reports.length > planned.length || (running && procedure.steps && procedure.steps !== planned.length) ? [] : planned;
  const count = Math.max(running ? procedure.steps : 0, reports.length);
  if (procedure?.procedure === "by_hand" || !count) return [head, ...steps.map((step) => row(step.step, null, step, step.error || known(step.stage), false))];
  // reports come in the order of the programme; a move that failed has one without a number, which the next step gets
  const next = Math.max(0, running ? procedure.step : 0, ...reports.map(({ step }) => step + 1));
  return [head, ...Array.from({ length: count }, (_, k) => {
    const done = reports[k], is_now = running && k === reports.length;
    const words = done ? done.error || t("measured") : is_now ? stage(procedure) : "";
    return row(done ? (done.step < 0 ? "–" : done.step) : next + k - reports.length, programme[k]?.position_mm, done, words, is_now);
  })];
}

const stage = ({ activity, frame, frames }) => (frames ? `${known(activity)}, ${t("frame {frame} of {frames}", { frame, frames })}` : known(activity));

function row(name, target, done, words, now) {
  const value = (found, factor) => number(scaled(found, factor), 4);
  return make("tr", { class: now ? "now" : "" }, make("td", {}, String(name)), make("td", {}, number(target ?? NaN, 4)),
    make("td", {}, value(done?.signals?.position, 1e3)), make("td", {}, value(done?.signals?.force, 1)), make("td", {}, value(done?.valid_fraction, 100)),
    make("td", { class: `words ${done?.error ? STATES.failed : done ? STATES.measured : ""}`, lang: done?.error ? "en" : null }, words));
}

function factList() {
  const load = latest("load"), recorder = latest("recorder"), rig = latest("rig") ?? {}, step = latest("step");
  const left = recorder?.minutes_left === null || recorder?.minutes_left === undefined ? "" : `, ${t("for {duration}", { duration: duration(60 * recorder.minutes_left) })}`;
  const entries = [
    [t("machine"), load ? known(load.mode) : t("not connected")],
    [t("signals"), (latest("signals") ?? []).map(({ name, value, factor, unit }) => `${known(name)} ${number(scaled(value, 1 / factor), 4)} ${unit}`).join(", ") || t("none")],
    [t("step"), step ? `${step.step}: ${stage({ activity: step.stage, ...step })}` : t("none yet")],
    [t("recorder"), recorder ? t("{state}, images: {images}, lost: {lost}", { state: known(recorder.state), images: recorder.images, lost: recorder.missing_images }) + (recorder.error ? `: ${recorder.error}` : "") : t("not connected")],
    [t("disk"), recorder?.free_gb ? `${t("{size} GB free", { size: decimal(recorder.free_gb) })}${left}` : "–"],
    [t("calibration"), (rig.calibration ?? []).join(" ") || "–", "en"],
  ];
  return entries.flatMap(([name, value, lang = null]) => [make("dt", {}, name), make("dd", { lang }, value)]);
}
