// The check list for setting up a rig: state of each item, its measurement, its picture, and what to do next.

import { make, repaint } from "./elements.js";
import { figuresPanel } from "./figures.js";
import { LiveImage } from "./live_image.js";
import { isBusy, procedurePanel } from "./procedure.js";
import { RegionEditor } from "./region.js";
import { command } from "./server.js";
import { latest, listen } from "./stream.js";

const LIVE = { axes: "crosshair", camera_focus: "white", projector_focus: "focus" }; // adjusted by hand with the live view
// Options of the commands with their names; one without a value is optional.
const OPTIONS = {
  timing: [
    { label: "Exposure [ms]", name: "exposure_ms", min: 0.05, max: 1000, step: "any", value: 3 },
    { label: "Longest delay [ms]", name: "longest_ms", min: 20, max: 10000, step: "any", value: 300 },
  ],
  calibrate: [{ label: "Other angles [degree]", name: "angles_deg", type: "text", placeholder: "those of the rig file" }],
  check: [
    { label: "Gauge block [mm]", name: "distance_mm", min: 0.1, max: 1000, step: "any", value: 5 },
    { label: "Acceptance test (VDI/VDE 2634) instead", name: "vdi", type: "checkbox" },
  ],
  noise: [{ label: "Steps at rest", name: "steps", min: 3, max: 1000, value: 10 }],
  advise: [
    { label: "Wanted noise [px]", name: "wanted_noise_px", min: 0, step: "any", placeholder: "none" },
    { label: "Wanted period [px]", name: "wanted_period_px", min: 0, step: "any", placeholder: "none" },
    { label: "Pixel on the specimen [mm]", name: "pixel_size_mm", min: 0, step: "any", placeholder: "unknown" },
    { label: "Strain window [points]", name: "strain_window_points", min: 3, max: 1001, step: 2, value: 5 },
  ],
};
const entered = {}; // values of the operator, which outlast every change of the list
const STATES = [["", "not done"], ["good", "done"], ["care", "out of date"], ["bad", "failed"]];
const MEASURED = ["timing", "response", "calibrate", "check", "region", "noise", "advise", "settings"];
let open = "";

export function show(place) {
  const list = make("ol", { class: "list" }), procedure = procedurePanel(MEASURED), work = make("div");
  let leave = () => {}, shown = null;
  place.replaceChildren(make("div", { class: "columns" }, make("section", {}, list), make("section", {}, procedure.element, work)));
  const choose = (item) => { open = item; paint(); };
  const paint = () => {
    repaint(list, ...(latest("setup") ?? []).map((item) => entry(item, choose)));
    if (shown === open) return;
    shown = open;
    leave();
    leave = workplace(work, open);
  };
  const ends = [procedure.end, () => leave(), listen("setup", paint), listen("procedure", paint)];
  return () => ends.forEach((end) => end());
}

function entry(item, choose) {
  const [colour, state] = STATES[item.state], when = item.done ? `, ${new Date(1000 * item.done).toLocaleString()}` : "";
  const chosen = item.item === open;
  return make("li", { class: `${colour}${chosen ? " now" : ""}`, id: `item-${item.item}` },
    make("div", { class: "row" }, make("h3", {}, item.title), make("span", { class: colour || "soft" }, `${state}${when}`),
      chosen ? null : make("button", { onclick: () => choose(item.item), "aria-label": `Open ${item.title}` }, "Open")),
    make("p", { class: "soft" }, item.next),
    chosen ? make("div", {}, ...buttons(item.item), item.words.length ? make("pre", {}, item.words.join("\n")) : null,
      item.report ? make("p", {}, make("a", { href: item.report, target: "_blank", rel: "noopener" }, "Report")) : null,
      item.picture ? make("img", { src: `${item.picture}?${item.done}`, alt: `Result: ${item.title}` }) : null) : null);
}

function buttons(item) {
  const disabled = isBusy(latest("procedure"));
  const start = (text, content) => make("button", { class: "main start", disabled, onclick: () => command("start", content) }, text);
  if (item in LIVE) return [make("div", { class: "row" }, start("Show the pattern", { procedure: "live", pattern: LIVE[item] }),
    make("button", { class: "done", onclick: () => command("start", { procedure: "confirm", pattern: item }) }, "It is adjusted"))];
  if (item === "region") return [make("p", {}, "Draw on the image, then use the region.")];
  const inputs = (OPTIONS[item] ?? []).map(optionInput);
  return [make("div", { class: "row" }, ...inputs.map(({ element }) => element), make("button", { class: "main start", disabled, onclick: () => {
    if (inputs.every(({ input }) => input.reportValidity())) command("start", { procedure: item, options: chosen(inputs) });
  } }, "Measure"))];
}

function optionInput({ label, name, type = "number", value, ...limits }) {
  const kept = entered[name] ?? value ?? "";
  const input = make("input", { type, id: name, ...limits, ...(type === "checkbox" ? { checked: kept === true } : { value: kept }),
    oninput: () => { entered[name] = type === "checkbox" ? input.checked : input.value; } });
  return { input, name, type, element: make("label", {}, label, input) };
}

function chosen(inputs) {
  const entries = inputs.map(({ input, name, type }) => [name, type === "checkbox" ? input.checked : type === "number" && input.value ? Number(input.value) : input.value]);
  return Object.fromEntries(entries.filter(([, value]) => value !== ""));
}

// The image beside an item: live with its figures, or with the editor of the region.
function workplace(place, item) {
  if (item === "region") {
    const editor = new RegionEditor();
    place.replaceChildren(make("div", { class: "panel" }, editor.element));
    return () => editor.end();
  }
  if (!(item in LIVE)) { place.replaceChildren(); return () => {}; }
  const image = new LiveImage(), figures = figuresPanel();
  place.replaceChildren(image.element, figures.element);
  return () => { image.end(); figures.end(); };
}
