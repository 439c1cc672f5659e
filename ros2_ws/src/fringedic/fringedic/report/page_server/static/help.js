// What a view is for, in one paragraph, with its page of the manual, which this server has.

import { make, patch } from "./elements.js";
import { t } from "./language.js";

const HELP = {
  tests: [t("The tests of this rig. The name of a test opens its maps, curves and 3D. A series has one button for each specimen."), "operator#tests"],
  setup: [t("The list shows what a rig needs before a test, in order. Open an item, measure or adjust it, and use its result. What depends on a later change is out of date and says so."), "operator#set-up"],
  live: [t("The image of the camera with focus, grey levels and advice. Red pixels are saturated: shorten the exposure or close the aperture."), "operator#live"],
  run: [t("Choose or write a programme, look at its table and curve, and start it. It can be paused after each step; Request hold asks the machine to stop and is no emergency stop."), "operator#run"],
  maps: [t("Point at the map to read a value with its standard deviation. A profile and an extensometer need two points. Grey or chequered parts are not measured."), "operator#maps-curves-3d"],
  curves: [t("Any signal and value of the steps over another one. A curve is interrupted where the reference changes."), "operator#maps-curves-3d"],
  space: [t("The surface with its displacement, which is magnified. Drag to turn it, and use the wheel to come closer."), "operator#maps-curves-3d"],
  evaluate: [t("Change window, region, reference or gauge, preview one step, and compute a named evaluation beside the results. A larger window has less noise and shows smaller features too flat."), "command#evaluate"],
  compare: [t("Two tests beside each other: what was entered, a curve of both, and a map of each with the same colours."), "operator#tests"],
  log: [t("Messages of the nodes, their states, the disk and the load frame. A warning says what to do."), "troubleshooting"],
};
const shown = make("button", { id: "help", type: "button", "aria-expanded": "false", "aria-controls": "help-text", "aria-label": t("Help for this view"), onclick: () => toggle(text.hidden) }, "?");
const text = make("p", { id: "help-text", class: "panel", hidden: true });

function toggle(open) {
  text.hidden = !open;
  shown.setAttribute("aria-expanded", String(open));
  if (!open) return;
  const view = document.querySelector("#views a[aria-current]")?.dataset.key ?? "maps";
  const [words, page] = HELP[view] ?? ["", "index"];
  patch(text, `${words} `, make("a", { href: `/manual/${page}`, target: "_blank", rel: "noopener" }, t("Page of the manual")));
}

document.getElementById("views").after(shown);
document.getElementById("top").after(text);
addEventListener("hashchange", () => toggle(false));
addEventListener("keydown", ({ key }) => { if (key === "Escape") toggle(false); });
