// The frame of the page: views, who drives, the hold button, the question that waits, and the state in one line.

import "./help.js";
import { button } from "./buttons.js";
import { make, options, patch } from "./elements.js";
import { choices, choose, known, language, t } from "./language.js";
import { isBusy, questionParts } from "./procedure.js";
import { command, forgetRefusal, newest, openTest, say, tried } from "./server.js";
import { shownTest } from "./shown.js";
import { connect, latest, listen, next } from "./stream.js";

const OF_A_RIG = { tests: t("Tests"), setup: t("Set up"), live: t("Live"), run: t("Run"), maps: t("Maps"), curves: t("Curves"), space: "3D", evaluate: t("Evaluate"), compare: t("Compare"), log: t("Log") };
const LOOKING = ["maps", "curves", "space"]; // the views that show an earlier test, too
const OF_A_RECORDING = { maps: t("Maps"), curves: t("Curves"), space: "3D", evaluate: t("Evaluate") };
const place = document.getElementById("view"), holdButton = document.getElementById("hold");
document.getElementById("views").setAttribute("aria-label", t("Views"));
document.getElementById("question").setAttribute("aria-label", t("Question"));
holdButton.textContent = t("Request hold");
document.getElementById("hold-note").prepend(t("The button asks the machine to stop and hold."), " ", make("strong", {}, t("It is no emergency stop: use the machine’s own.")), " ");
document.getElementById("no-hold").textContent = t("Now no node of the machine runs, so that nothing would receive it.");
const languageChoice = make("select", { id: "language", "aria-label": t("Language"), onchange: () => choose(languageChoice.value) });
options(languageChoice, choices, language);
document.getElementById("wheel").after(languageChoice);
const chosen = newest(), TEST = "&test="; // in the address of a view, before the name of an earlier test
let leave = () => {}, current = "", state = "", wantedTest = ""; // the last one: as the address names it

function views() {
  return latest("rig")?.kind === "recording" ? OF_A_RECORDING : OF_A_RIG;
}

async function route() {
  if (!latest("rig")) return;
  const shownViews = views(), [asked, wanted = ""] = location.hash.slice(1).split(TEST), name = asked in shownViews ? asked : Object.keys(shownViews)[0];
  const test = LOOKING.includes(name) ? decodeURIComponent(wanted) : "";
  patch(document.getElementById("views"), ...Object.entries(shownViews).map(([key, text]) =>
    make("a", { href: `#${key}`, "data-key": key, "aria-current": key === name ? "page" : null }, text)));
  const isNew = test !== wantedTest;
  wantedTest = test;
  takeOpened(name);
  if (name !== current) {
    current = name;
    leave();
    leave = () => {};
    say("");
    const view = await chosen(import(`/page/${name}.js`));
    if (view) leave = view.show(place);
  }
  if (isNew && test && test !== shownTest()) {
    await tried(openTest(test));
    takeOpened(name);
  }
}

// Says which earlier test is looked at, and leads back to the present one.
function takeOpened(name) {
  const bar = document.getElementById("opened"), test = shownTest();
  bar.hidden = !test || !LOOKING.includes(name);
  patch(bar, ...(bar.hidden ? [] : [make("span", {}, t("Earlier test: {test}", { test: titleOf(test) })),
    button(t("Back to the present test"), { id: "close-test", onclick: () => { openTest(""); location.hash = `#${name}`; takeOpened(name); } })]));
}

const titleOf = (name) => {
  const test = (latest("tests") ?? []).find((each) => each.name === name);
  return [test?.specimen, name].filter(Boolean).join(", ");
};

function takeRig(rig) {
  const test = (latest("tests") ?? []).find((each) => each.name === latest("procedure")?.folder);
  const title = [rig.title, test?.specimen].filter(Boolean).join(" – ");
  document.title = `${title} – fringedic`;
  document.getElementById("title").textContent = title;
  const live = rig.kind === "rig", isOffered = live && (rig.load_frame || rig.machine);
  holdButton.hidden = document.getElementById("hold-note").hidden = !isOffered;
  takeMachine();
  if (!live) patch(document.getElementById("summary"), t("recording"),
    rig.report ? make("a", { href: "/files/run/report.html", target: "_blank", rel: "noopener" }, ` ${t("report")}`) : "");
  route();
}

// Why nothing would receive a request to hold; empty while a procedure runs or the rig was started elsewhere, because the
// service of a node that has just started is seen a moment later, and while the state is not known.
function noMachine() {
  const rig = latest("rig");
  if (!latest("connected") || !rig?.operated || rig.machine || isBusy(latest("procedure"))) return "";
  return t("No node of the machine runs, so that nothing would receive the request: stop the machine at its own controls.");
}

function takeMachine() {
  const why = noMachine();
  document.getElementById("no-hold").hidden = Boolean(latest("rig")?.machine);
  holdButton.classList.toggle("off", !latest("rig")?.machine);
  holdButton.title = why;
  if (why) holdButton.setAttribute("aria-disabled", "true");
  else holdButton.removeAttribute("aria-disabled");
}

// Asks for the wheel or hands it over, and waits until the page shows it: the server sends it with its answer.
async function turnWheel(action) {
  const shown = next("wheel"), answer = await command("wheel", { action });
  if (answer !== null) await shown;
  return answer;
}

function takeWheel(wheel) {
  const give = button(wheel.asking ? t("Hand over to {browser}", { browser: known(wheel.asking) }) : t("Hand over"), { id: "give", onclick: () => turnWheel("give") });
  const waits = wheel.asked && wheel.driver_present; // a driver who has left is not waited for
  const ask = button(waits ? t("Asked for the wheel") : t("Ask for the wheel"), { id: "ask", onclick: () => turnWheel("ask"),
    why: waits ? t("{browser} has been asked: wait until the wheel is handed over.", { browser: known(wheel.driver) }) : "" });
  const who = wheel.drives ? t("You drive") : wheel.driver_present ? t("{browser} drives", { browser: known(wheel.driver) }) : t("Nobody drives");
  patch(document.getElementById("wheel"), ...(latest("rig")?.kind === "recording" && wheel.drives ? [] : [make("span", { class: "row" }, who, wheel.drives ? give : ask)]));
}

const STATES = ["", t("runs"), t("pauses after this step"), t("is paused"), t("stops"), t("has ended"), t("has failed")];

function takeProcedure(procedure) {
  const question = document.getElementById("question"), parts = questionParts(procedure);
  question.hidden = !parts.length;
  patch(question, ...parts);
  takeMachine();
  if (!procedure) return;
  const now = `${procedure.procedure} ${procedure.state}`;
  if (state && now !== state) forgetRefusal();
  state = now;
  const step = procedure.procedure === "run" && procedure.steps ? `, ${t("step {step} (last: {last})", { step: procedure.step, last: procedure.steps - 1 })}` : "";
  document.getElementById("summary").textContent = procedure.procedure ? `${known(procedure.title)} ${STATES[procedure.state]}${step}` : t("ready");
}

// For everybody, and never held back while something could receive it.
holdButton.addEventListener("click", () => (noMachine() ? say(noMachine()) : command("hold")));
addEventListener("hashchange", route);
listen("rig", takeRig);
listen("wheel", (wheel) => { takeWheel(wheel); takeProcedure(latest("procedure")); });
listen("procedure", takeProcedure);
listen("tests", () => { if (latest("rig")) takeRig(latest("rig")); });
listen("connected", (is) => say(is ? "" : t("The page has lost its server. The measurement goes on without it; the page connects again by itself.")));
listen("alarms", (alarms) => {
  const reached = document.getElementById("reached"), words = (alarms ?? []).map((each) => known(each.reached)).filter(Boolean);
  reached.hidden = !words.length;
  reached.textContent = words.join("; ");
});
listen("refused", (why) => say(known(why)));
connect();
