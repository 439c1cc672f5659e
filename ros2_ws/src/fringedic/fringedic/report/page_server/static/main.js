// The frame of the page: views, who drives, the hold button, the question that waits, and the state in one line.

import "./help.js";
import { button } from "./buttons.js";
import { make, patch } from "./elements.js";
import { questionParts } from "./procedure.js";
import { command, forgetRefusal, newest, say } from "./server.js";
import { connect, latest, listen } from "./stream.js";

const OF_A_RIG = { setup: "Set up", live: "Live", run: "Run", maps: "Maps", curves: "Curves", space: "3D", evaluate: "Evaluate", log: "Log" };
const OF_A_RECORDING = { maps: "Maps", curves: "Curves", space: "3D", evaluate: "Evaluate" };
const place = document.getElementById("view"), holdButton = document.getElementById("hold");
const chosen = newest();
let leave = () => {}, current = "", state = "";

function views() {
  return latest("rig")?.kind === "recording" ? OF_A_RECORDING : OF_A_RIG;
}

async function route() {
  if (!latest("rig")) return;
  const known = views(), name = location.hash.slice(1) in known ? location.hash.slice(1) : Object.keys(known)[0];
  patch(document.getElementById("views"),
    ...Object.entries(known).map(([key, text]) => make("a", { href: `#${key}`, "data-key": key, "aria-current": key === name ? "page" : null }, text)));
  if (name === current) return;
  current = name;
  leave();
  leave = () => {};
  say("");
  const view = await chosen(import(`/page/${name}.js`));
  if (view) leave = view.show(place);
}

function takeRig(rig) {
  document.title = `${rig.title} – fringedic`;
  document.getElementById("title").textContent = rig.title;
  const live = rig.kind === "rig", isOffered = live && (rig.load_frame || rig.machine);
  holdButton.hidden = document.getElementById("hold-note").hidden = !isOffered;
  // it is sent all the same: the service of a node that has just started is seen a moment later
  document.getElementById("no-hold").hidden = rig.machine;
  holdButton.classList.toggle("off", !rig.machine);
  if (!live) patch(document.getElementById("summary"), "recording",
    rig.report ? make("a", { href: "/files/run/report.html", target: "_blank", rel: "noopener" }, " report") : "");
  route();
}

function takeWheel(wheel) {
  const give = button(wheel.asking ? `Hand over to ${wheel.asking}` : "Hand over", { id: "give", onclick: () => command("wheel", { action: "give" }) });
  const waits = wheel.asked && wheel.driver_present; // a driver who has left is not waited for
  const ask = button(waits ? "Asked for the wheel" : "Ask for the wheel", { id: "ask", onclick: () => command("wheel", { action: "ask" }),
    why: waits ? `${wheel.driver} has been asked: wait until the wheel is handed over.` : "" });
  const who = wheel.drives ? "You drive" : wheel.driver_present ? `${wheel.driver} drives` : "Nobody drives";
  patch(document.getElementById("wheel"), ...(latest("rig")?.kind === "recording" ? [] : [make("span", { class: "row" }, who, wheel.drives ? give : ask)]));
}

const STATES = ["", "runs", "pauses after this step", "is paused", "stops", "has ended", "has failed"];

function takeProcedure(procedure) {
  const question = document.getElementById("question"), parts = questionParts(procedure);
  question.hidden = !parts.length;
  patch(question, ...parts);
  if (!procedure) return;
  const now = `${procedure.procedure} ${procedure.state}`;
  if (state && now !== state) forgetRefusal();
  state = now;
  const step = procedure.procedure === "run" && procedure.steps ? `, step ${procedure.step} (last: ${procedure.steps - 1})` : "";
  document.getElementById("summary").textContent = procedure.procedure ? `${procedure.title} ${STATES[procedure.state]}${step}` : "ready";
}

// Never held back, and for everybody.
holdButton.addEventListener("click", () => command("hold"));
addEventListener("hashchange", route);
listen("rig", takeRig);
listen("wheel", (wheel) => { takeWheel(wheel); takeProcedure(latest("procedure")); });
listen("procedure", takeProcedure);
listen("connected", (is) => say(is ? "" : "The page has lost its server. The measurement goes on without it; the page connects again by itself."));
listen("refused", say);
connect();
