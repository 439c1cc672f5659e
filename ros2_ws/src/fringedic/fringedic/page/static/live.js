// The live view: image, pattern of the projector, figures.

import { make, options } from "./elements.js";
import { figuresPanel } from "./figures.js";
import { LiveImage } from "./live_image.js";
import { command } from "./server.js";
import { listen } from "./stream.js";

const PATTERNS = [["white", "white"], ["fringes", "fringes"], ["focus", "focus lines"], ["crosshair", "crosshair"]];

export function show(place) {
  const image = new LiveImage(), figures = figuresPanel();
  const pattern = make("select", { id: "pattern", onchange: () => command("start", { procedure: "live", pattern: pattern.value }) });
  options(pattern, PATTERNS);
  const state = make("p", { class: "soft", role: "status" });
  const buttons = make("div", { class: "row" }, make("label", {}, "Projector shows", pattern),
    make("button", { onclick: () => command("start", { procedure: "live", pattern: pattern.value }) }, "Start live view"),
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
