// The frame of the page: views, who drives, the hold button, and the state in one line.

import { make, repaint } from "./elements.js";
import { command, newest, say } from "./server.js";
import { connect, latest, listen } from "./stream.js";

const OF_A_RIG = { setup: "Set up", live: "Live", run: "Run", maps: "Maps", curves: "Curves", space: "3D", log: "Log" };
const OF_A_RECORDING = { maps: "Maps", curves: "Curves", space: "3D" };
const place = document.getElementById("view");
const chosen = newest();
let leave = () => {}, current = "";

function views() {
  return latest("rig")?.kind === "recording" ? OF_A_RECORDING : OF_A_RIG;
}

async function route() {
  if (!latest("rig")) return;
  const known = views(), name = location.hash.slice(1) in known ? location.hash.slice(1) : Object.keys(known)[0];
  repaint(document.getElementById("views"),
    ...Object.entries(known).map(([key, text]) => make("a", { href: `#${key}`, "aria-current": key === name ? "page" : null }, text)));
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
  const live = rig.kind === "rig";
  document.getElementById("hold").hidden = document.getElementById("hold-note").hidden = !(live && (rig.load_frame || rig.machine));
  if (!live) document.getElementById("summary").replaceChildren("recording",
    rig.report ? make("a", { href: "/files/run/report.html", target: "_blank", rel: "noopener" }, " report") : "");
  route();
}

function takeWheel(wheel) {
  const give = make("button", { onclick: () => command("wheel", { action: "give" }) }, wheel.asking ? `Hand over to ${wheel.asking}` : "Hand over");
  const ask = make("button", { onclick: () => command("wheel", { action: "ask" }), disabled: wheel.asked }, wheel.asked ? "Asked for the wheel" : "Ask for the wheel");
  const who = wheel.drives ? "You drive" : wheel.driver_present ? `${wheel.driver} drives` : "Nobody drives";
  repaint(document.getElementById("wheel"), ...(latest("rig")?.kind === "recording" ? [] : [make("span", { class: "row" }, who, wheel.drives ? give : ask)]));
}

const STATES = ["", "runs", "pauses after this step", "is paused", "stops", "has ended", "has failed"];

function takeProcedure(procedure) {
  if (!procedure) return;
  const step = procedure.procedure === "run" && procedure.steps ? `, step ${procedure.step} (last: ${procedure.steps - 1})` : "";
  document.getElementById("summary").textContent = procedure.procedure ? `${procedure.title} ${STATES[procedure.state]}${step}` : "ready";
}

document.getElementById("hold").addEventListener("click", () => command("hold"));
addEventListener("hashchange", route);
listen("rig", takeRig);
listen("wheel", takeWheel);
listen("procedure", takeProcedure);
listen("connected", (is) => say(is ? "" : "The page has lost its server. The measurement goes on without it; the page connects again by itself."));
listen("refused", say);
connect();
