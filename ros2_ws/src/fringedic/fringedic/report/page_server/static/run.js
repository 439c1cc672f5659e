// Runs a programme: its table, start, pause, stop, steps by hand; state of machine, recorder and calibration.

import { make, number, repaint } from "./elements.js";
import { LiveImage } from "./live_image.js";
import { FAILED, isBusy, procedurePanel } from "./procedure.js";
import { command } from "./server.js";
import { latest, listen } from "./stream.js";

export function show(place) {
  const image = new LiveImage(), procedure = procedurePanel(["run", "by_hand"]);
  const start = make("div", { class: "panel", id: "start" }), table = make("table", { id: "steps" });
  const facts = make("dl", { class: "panel", id: "facts" });
  place.replaceChildren(make("div", { class: "columns" },
    make("section", {}, start, procedure.element, make("div", { class: "panel scroll" }, table)),
    make("section", {}, facts, image.element)));
  const paint = () => { repaint(start, ...startPanel()); table.replaceChildren(...rows()); facts.replaceChildren(...factList()); };
  const ends = [() => image.end(), procedure.end, ...["rig", "procedure", "steps", "step", "load", "signals", "recorder", "hand", "nodes"].map((topic) => listen(topic, paint))];
  return () => ends.forEach((end) => end());
}

// One text for all states of the page: what is being written outlasts every change of them.
const text = make("textarea", { id: "programme", "aria-label": "Programme in place of that of the rig file", placeholder: "ramp: {to_mm: 1.0, steps: 11}" });
const another = make("details", {}, make("summary", {}, "Another programme"), text);
let shown = "";

function startPanel() {
  const rig = latest("rig") ?? {}, procedure = latest("procedure"), busy = isBusy(procedure);
  const state = JSON.stringify([rig.operated, rig.measures, rig.file_error, busy, procedure?.procedure, rig.programme, latest("hand"), procedure?.state, procedure?.folder, procedure?.words, rig.load_frame, (latest("nodes") ?? []).length > 0]);
  if (state === shown && text.isConnected) return [...text.closest("#start").childNodes];
  shown = state;
  another.hidden = busy; // the table of the steps is what one looks at then
  const by_hand = busy && procedure.procedure === "by_hand";
  // a stop, or a fault of the machine, ends a programme: only a person may go on with it
  const ended = procedure?.procedure === "run" && procedure.state === FAILED && procedure.words.length && procedure.folder;
  return [
    make("h2", {}, "Test"),
    rig.file_error ? make("p", { class: "bad" }, rig.file_error) : null,
    rig.load_frame ? make("p", { class: "care" }, "Before the start: the limits of the machine are set, its emergency stop was tested, and nobody is in the frame.") : null,
    make("div", { class: "row" },
      make("button", { class: "main", id: "run", disabled: busy || !rig.operated, onclick: () => command("start", { procedure: "run", text: text.value }) }, "Start the programme"),
      ended ? make("button", { id: "go-on", disabled: !rig.operated, onclick: () => command("start", { procedure: "run", text: text.value, options: { continue_run: procedure.folder } }) }, "Go on with the last run") : null,
      make("button", { id: "by-hand", disabled: busy || !rig.operated, onclick: () => command("start", { procedure: "by_hand" }) }, "Measure by hand"),
      by_hand || !rig.operated ? make("button", { id: "measure", class: "main", disabled: !rig.measures, onclick: () => command("measure", {}) }, "Measure one step") : null),
    ended && rig.load_frame ? make("p", { class: "care" }, "Before you go on with a run that was stopped: find out why, look at machine and specimen, and reset the machine at its own controls.") : null,
    latest("hand") ? make("p", { id: "hand", role: "status" }, latest("hand")) : null,
    rig.operated ? null : make("p", { class: "soft", id: "elsewhere" }, elsewhere(rig)),
    another,
    procedure?.folder && !busy ? make("p", {}, make("a", { href: "/files/run/report.html", target: "_blank", rel: "noopener" }, "Report of the last run"), ` in ${procedure.folder}, `,
      make("a", { href: "/files/run/report.html", download: `${procedure.folder}.html` }, "save it as a file")) : null,
  ].filter(Boolean);
}

function elsewhere(rig) {
  return (latest("nodes") ?? []).length || rig.measures ? "This rig was started elsewhere: its procedures run there."
    : "No node of this rig runs: start it, for example with fringedic run or ros2 launch, or end this page and start it without --attach.";
}

const STATES = { failed: "bad", measured: "good" };

function rows() {
  const known = (latest("rig")?.programme ?? []).filter(({ mode }) => mode !== "none"), steps = latest("steps") ?? [], procedure = latest("procedure");
  const running = isBusy(procedure) && procedure.procedure === "run";
  const reports = procedure?.procedure === "run" ? procedure.reports : [];
  const head = make("tr", {}, ...["step", "target [mm]", "position [mm]", "force [N]", "measured [%]"].map((name) => make("th", {}, name)), make("th", { class: "words" }, "state"));
  // a programme with another number of steps is not the one whose targets are known: another page has started it
  const programme = reports.length > known.length || (running && procedure.steps && procedure.steps !== known.length) ? [] : known;
  const count = Math.max(running ? procedure.steps : programme.length, reports.length);
  if (procedure?.procedure === "by_hand" || !count) return [head, ...steps.map((step) => row(step.step, null, step, step.error || step.stage, false))];
  // reports come in the order of the programme; a move that failed has one without a number, which the next step gets
  const next = Math.max(0, running ? procedure.step : 0, ...reports.map(({ step }) => step + 1));
  return [head, ...Array.from({ length: count }, (_, k) => {
    const done = reports[k], is_now = running && k === reports.length;
    const words = done ? done.error || "measured" : is_now ? stage(procedure) : "";
    return row(done ? (done.step < 0 ? "–" : done.step) : next + k - reports.length, programme[k]?.position_mm, done, words, is_now);
  })];
}

const stage = ({ activity, frame, frames }) => (frames ? `${activity}, frame ${frame} of ${frames}` : activity);

function row(name, target, done, words, now) {
  const value = (found, factor) => number(found === undefined || found === null ? NaN : found * factor, 4);
  return make("tr", { class: now ? "now" : "" }, make("td", {}, String(name)), make("td", {}, number(target ?? NaN, 4)),
    make("td", {}, value(done?.signals?.position, 1e3)), make("td", {}, value(done?.signals?.force, 1)), make("td", {}, value(done?.valid_fraction, 100)),
    make("td", { class: `words ${done?.error ? STATES.failed : done ? STATES.measured : ""}` }, words));
}

function factList() {
  const load = latest("load"), recorder = latest("recorder"), rig = latest("rig") ?? {}, step = latest("step");
  const entries = [
    ["machine", load ? load.mode : "not connected"],
    ["signals", (latest("signals") ?? []).map(({ name, value, factor, unit }) => `${name} ${number(value / factor, 4)} ${unit}`).join(", ") || "none"],
    ["step", step ? `${step.step}: ${step.stage}${step.frames ? `, frame ${step.frame} of ${step.frames}` : ""}` : "none yet"],
    ["recorder", recorder ? `${recorder.state}, ${recorder.images} images, ${recorder.missing_images} lost${recorder.error ? `: ${recorder.error}` : ""}` : "not connected"],
    ["disk", recorder?.free_gb ? `${recorder.free_gb} GB free${recorder.minutes_left === null ? "" : `, for ${recorder.minutes_left} minutes`}` : "–"],
    ["calibration", (rig.calibration ?? []).join(" ") || "–"],
  ];
  return entries.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]);
}
