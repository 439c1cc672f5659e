// The live view: image, pattern of the projector, figures.

import { make, options } from "./elements.js";
import { figuresPanel } from "./figures.js";
import { LiveImage } from "./live_image.js";
import { command } from "./server.js";
import { listen } from "./stream.js";

const PATTERNS = [["white", "white"], ["fringes", "fringes"], ["focus", "focus lines"], ["crosshair", "crosshair"]];

let part = ""; // of the image, which the figures are about; empty: all of it

export function show(place) {
  const image = new LiveImage(), figures = figuresPanel();
  const region = make("input", { type: "text", id: "part", value: part, placeholder: "column,row,width,height", pattern: "\\d+(,\\d+){3}" });
  const start = () => {
    part = region.value;
    if (region.reportValidity()) command("start", { procedure: "live", pattern: pattern.value, options: part ? { region: part } : {} });
  };
  const pattern = make("select", { id: "pattern", onchange: start });
  options(pattern, PATTERNS);
  const state = make("p", { class: "soft", role: "status" });
  const buttons = make("div", { class: "row" }, make("label", {}, "Projector shows", pattern), make("label", {}, "Figures of the part [px]", region),
    make("button", { onclick: start }, "Start live view"),
    make("button", { onclick: () => command("control", { command: "stop" }) }, "Stop"));
  place.replaceChildren(make("div", { class: "columns" }, make("section", { class: "panel" }, buttons, image.element, state), figures.element));
  const ends = [
    () => image.end(), figures.end,
    listen("live", (live) => {
      if (live?.pattern) pattern.value = live.pattern;
      state.textContent = live?.error || (live?.state === 1 ? live.activity : "The live view does not run.");
    }),
  ];
  return () => ends.forEach((end) => end());
}
