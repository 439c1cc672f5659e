// The procedure that runs or ran last: progress, question to the operator, result, and the buttons that control it.

import { make, repaint } from "./elements.js";
import { command } from "./server.js";
import { listen } from "./stream.js";

export const RUNNING = 1, PAUSING = 2, PAUSED = 3, STOPPING = 4, FAILED = 6;
export const isBusy = (procedure) => procedure && procedure.state >= RUNNING && procedure.state <= STOPPING;
const control = (name) => () => command("control", { command: name });

// A panel that is empty when the procedure is none of `names`.
export function procedurePanel(names) {
  const panel = make("section", { class: "panel", id: "procedure", hidden: true });
  const end = listen("procedure", (procedure) => {
    panel.hidden = !procedure || !names.includes(procedure.procedure);
    if (!panel.hidden) repaint(panel, ...content(procedure));
  });
  return { element: panel, end };
}

function content(procedure) {
  const busy = isBusy(procedure), parts = [make("h2", {}, procedure.title)];
  if (procedure.question) parts.push(make("p", { id: "question", role: "alert" }, `${procedure.question}.`),
    make("div", { class: "row" }, make("button", { class: "main", id: "confirm", onclick: control("confirm") }, "Done, continue"), make("button", { id: "refuse", onclick: control("refuse") }, "End")));
  if (busy) parts.push(make("p", { id: "activity" }, activity(procedure)), bar(procedure),
    make("div", { class: "row" }, ...buttons(procedure)));
  if (procedure.error) parts.push(make("p", { class: "bad", id: "error" }, procedure.error));
  if (procedure.words.length) parts.push(make("pre", { class: procedure.state === FAILED ? "bad" : "", id: "words" }, procedure.words.join("\n")));
  if (procedure.settings) parts.push(make("pre", { class: "soft" }, procedure.settings),
    make("button", { class: "main", id: "use", onclick: () => command("start", { procedure: "settings", text: procedure.settings }) }, "Use this in the rig file"));
  if (procedure.notes.length) parts.push(make("details", { open: busy }, make("summary", {}, "Notes"), make("pre", {}, procedure.notes.join("\n"))));
  return parts;
}

const LONG = ["run", "by_hand"];

function buttons(procedure) {
  const shown = [];
  if (procedure.procedure === "run") shown.push(procedure.state === RUNNING
    ? make("button", { id: "pause", onclick: control("pause") }, "Pause after this step")
    : make("button", { id: "resume", class: "main", disabled: procedure.state === STOPPING, onclick: control("resume") }, "Continue"));
  shown.push(make("button", { id: "stop", disabled: procedure.state === STOPPING, onclick: control("stop") }, LONG.includes(procedure.procedure) ? "Stop and write results" : "Stop"));
  return shown;
}

function activity({ procedure, activity, step, steps, frame, frames, remaining_s }) {
  const parts = [procedure === "run" && steps ? `Step ${step} (last: ${steps - 1}): ${activity}` : steps > 1 ? `${step + 1} of ${steps}: ${activity}` : activity];
  if (frames) parts.push(`frame ${frame} of ${frames}`);
  if (remaining_s !== null) parts.push(`about ${duration(remaining_s)} left`);
  return parts.join(", ");
}

const duration = (seconds) => (seconds < 100 ? `${seconds} s` : seconds < 6000 ? `${Math.round(seconds / 60)} min` : `${(seconds / 3600).toFixed(1)} h`);

function bar({ step, steps, frame, frames }) {
  return make("progress", steps ? { max: steps, value: Math.max(step + (frames ? frame / frames : 0), 0), "aria-label": "progress" } : { "aria-label": "progress" });
}
