// The live view: image, pattern of the projector, figures.

import { button, notDriving } from "./buttons.js";
import { make, options, patch } from "./elements.js";
import { figuresPanel } from "./figures.js";
import { known, t } from "./language.js";
import { LiveImage } from "./live_image.js";
import { numbersField } from "./numbers.js";
import { cannotStart, isBusy, RUNNING } from "./procedure.js";
import { command, start } from "./server.js";
import { latest, listen } from "./stream.js";

const PATTERNS = [["white", t("white")], ["fringes", t("fringes")], ["focus", t("focus lines")], ["crosshair", t("crosshair")]];

let chosen = "white", part = ""; // of the image, which the figures are about; empty: all of it

export function show(place) {
  const image = new LiveImage(), figures = figuresPanel();
  const region = numbersField({ id: "part", value: part, count: 4, whole: true, placeholder: t("column, row, width, height") });
  const begin = () => {
    const values = region.found();
    if (!region.input.reportValidity()) return undefined;
    part = values?.join(",") ?? "";
    return start({ procedure: "live", pattern: chosen, options: part ? { region: part } : {} });
  };
  const pattern = make("select", { id: "pattern", onchange: () => { chosen = pattern.value; if (!cannotStart()) begin(); } });
  options(pattern, PATTERNS, chosen);
  const state = make("p", { class: "soft", id: "live-state", role: "status" }), row = make("span", { class: "row" });
  const paint = () => {
    const live = latest("live"), procedure = latest("procedure"), runs = live?.state === RUNNING;
    if (runs && live.pattern) pattern.value = chosen = live.pattern;
    const title = Object.fromEntries(PATTERNS)[live?.pattern] ?? live?.pattern;
    state.textContent = isBusy(procedure) ? t("{procedure} runs and shows its own patterns.", { procedure: known(procedure.title) })
      : live?.error || (!runs ? t("The live view does not run.") : live.activity ? t("The projector shows: {pattern}.", { pattern: title }) : t("The live view starts."));
    patch(row, button(t("Start live view"), { id: "live-start", why: cannotStart(), onclick: begin }),
      button(t("Stop"), { id: "live-stop", why: notDriving() || (runs ? "" : t("The live view does not run.")), onclick: () => command("control", { command: "stop" }) }));
  };
  place.replaceChildren(make("div", { class: "columns" }, make("section", { class: "panel" },
    make("div", { class: "row" }, make("label", {}, t("Projector shows"), pattern), make("label", {}, t("Figures of the part [px]"), region.input), row),
    image.element, state), figures.element));
  const ends = [() => image.end(), figures.end, ...["live", "procedure", "wheel", "rig"].map((topic) => listen(topic, paint))];
  return () => ends.forEach((end) => end());
}
