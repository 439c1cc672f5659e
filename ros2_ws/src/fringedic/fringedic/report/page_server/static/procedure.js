// The procedure that runs or ran last: progress, result, and the buttons that control it; and its question.

import { button, notDriving } from "./buttons.js";
import { make, patch } from "./elements.js";
import { decimal, known, spoken, t } from "./language.js";
import { command, start } from "./server.js";
import { latest, listen } from "./stream.js";

export const RUNNING = 1, PAUSING = 2, PAUSED = 3, STOPPING = 4, FAILED = 6;
export const isBusy = (procedure) => Boolean(procedure) && procedure.state >= RUNNING && procedure.state <= STOPPING;
const control = (name) => () => command("control", { command: name });

// Why no procedure can be started now; empty when one can.
export function cannotStart() {
  const procedure = latest("procedure");
  if (!latest("rig")?.operated) return t("This rig was started elsewhere: its procedures are started there.");
  if (isBusy(procedure)) return t("{procedure} runs: wait until it has ended, or stop it.", { procedure: known(procedure.title) });
  return notDriving();
}

// A panel that is empty when the procedure is none of `names`.
export function procedurePanel(names) {
  const panel = make("section", { class: "panel", id: "procedure", hidden: true });
  const paint = () => {
    const procedure = latest("procedure");
    panel.hidden = !procedure || !names.includes(procedure.procedure);
    if (!panel.hidden) patch(panel, ...content(procedure));
  };
  const ends = ["procedure", "wheel", "rig"].map((topic) => listen(topic, paint));
  return { element: panel, end: () => ends.forEach((end) => end()) };
}

function content(procedure) {
  const busy = isBusy(procedure), parts = [make("h2", {}, known(procedure.title))];
  if (busy) parts.push(make("p", { id: "activity" }, activity(procedure)), bar(procedure),
    make("div", { class: "row" }, ...buttons(procedure)));
  if (procedure.error) parts.push(make("p", { class: "bad", id: "error", lang: "en" }, procedure.error));
  if (procedure.words.length) parts.push(make("pre", { class: procedure.state === FAILED ? "bad" : "", id: "words", lang: "en" }, procedure.words.join("\n")));
  if (procedure.settings) parts.push(make("pre", { class: "soft", id: "settings" }, procedure.settings),
    button(t("Use this in the rig file"), { class: "main", id: "use", why: cannotStart(), onclick: () => start({ procedure: "settings", text: procedure.settings }) }));
  if (procedure.notes.length) parts.push(make("details", { id: "notes", open: busy }, make("summary", {}, t("Notes")), make("pre", { lang: "en" }, procedure.notes.join("\n"))));
  return parts;
}

// The question that the procedure waits with: in every view, because nothing goes on before its answer.
export function questionParts(procedure) {
  if (!procedure?.question) return [];
  const why = notDriving();
  return [make("p", { role: "alert", lang: spoken(procedure.question) }, `${procedure.question}.`),
    make("div", { class: "row" }, button(t("Done, continue"), { class: "main", id: "confirm", why, onclick: control("confirm") }),
      button(t("End"), { id: "refuse", why, onclick: control("refuse") }))];
}

const LONG = ["run", "by_hand"];

// Every button stays where it is from begin to end; one that has no effect now says why.
function buttons(procedure) {
  const { state, steps, reports } = procedure, stopping = state === STOPPING ? t("It is being stopped.") : "";
  const ending = reports.length && !steps ? t("No step follows: the results are being written.") : "";
  const why = notDriving() || stopping;
  return [
    procedure.procedure === "run" ? button(t("Pause after this step"), { id: "pause", onclick: control("pause"),
      why: why || ending || (state === RUNNING ? "" : t("It pauses already.")) }) : null,
    procedure.procedure === "run" ? button(t("Continue"), { id: "resume", onclick: control("resume"),
      why: why || ending || (state === RUNNING ? t("It is not paused.") : "") }) : null,
    button(LONG.includes(procedure.procedure) ? t("Stop and write results") : t("Stop"), { id: "stop", why, onclick: control("stop") }),
  ].filter(Boolean);
}

function activity({ procedure, activity, step, steps, frame, frames, remaining_s }) {
  const parts = [procedure === "run" && steps ? t("Step {step} (last: {last}): {activity}", { step, last: steps - 1, activity: known(activity) }) : steps > 1 ? t("{part} of {parts}: {activity}", { part: step + 1, parts: steps, activity: known(activity) }) : known(activity)];
  if (frames) parts.push(t("frame {frame} of {frames}", { frame, frames }));
  if (remaining_s) parts.push(t("about {duration} left", { duration: duration(remaining_s) }));
  return parts.join(", ");
}

// A time for people.
export function duration(seconds) {
  if (seconds < 100) return `${Math.round(seconds)} s`;
  if (seconds < 6000) return `${Math.round(seconds / 60)} min`;
  if (seconds < 48 * 3600) return `${decimal((seconds / 3600).toFixed(1))} h`;
  return seconds < 60 * 86400 ? t("{days} days", { days: Math.round(seconds / 86400) }) : t("more than 60 days");
}

function bar({ step, steps, frame, frames }) {
  const known = steps > 1 || frames;
  return make("progress", { "aria-label": t("progress"), max: known ? steps : null, value: known ? Math.max(step + (frames ? frame / frames : 0), 0) : null });
}
