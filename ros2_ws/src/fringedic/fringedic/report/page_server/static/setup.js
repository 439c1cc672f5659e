// The check list for setting up a rig: state of each item, its measurement, its picture, and what to do next.

import { button, notDriving } from "./buttons.js";
import { keep, make, patch } from "./elements.js";
import { figuresPanel } from "./figures.js";
import { date, known, spoken, t } from "./language.js";
import { LiveImage } from "./live_image.js";
import { numberField, numbersField } from "./numbers.js";
import { cannotStart, procedurePanel } from "./procedure.js";
import { RegionEditor } from "./region.js";
import { start } from "./server.js";
import { latest, listen } from "./stream.js";

const LIVE = { axes: "crosshair", camera_focus: "white", projector_focus: "focus" }; // adjusted by hand with the live view
// Options of the commands with their names; one without a value is optional.
const OPTIONS = {
  timing: [
    { label: t("Exposure [ms]"), name: "exposure_ms", min: 0.05, max: 1000, value: 3 },
    { label: t("Longest delay [ms]"), name: "longest_ms", min: 20, max: 10000, value: 300 },
  ],
  calibrate: [{ label: t("Other angles [degree]"), name: "angles_deg", kind: "list", placeholder: t("those of the rig file, or 0; -10; 10") }],
  check: [
    { label: t("Gauge block [mm]"), name: "distance_mm", min: 0.1, max: 1000, value: 5 },
    { label: t("Acceptance test (VDI/VDE 2634) instead"), name: "vdi", kind: "choice" },
  ],
  noise: [{ label: t("Steps at rest"), name: "steps", min: 3, max: 1000, whole: true, value: 10 }],
  advise: [
    { label: t("Wanted noise [px]"), name: "wanted_noise_px", min: 0, placeholder: t("none") },
    { label: t("Wanted period [px]"), name: "wanted_period_px", min: 0, placeholder: t("none") },
    { label: t("Pixel on the specimen [mm]"), name: "pixel_size_mm", min: 0, placeholder: t("unknown") },
    { label: t("Strain window [points]"), name: "strain_window_points", min: 3, max: 1001, odd: true, value: 5 },
  ],
};
const fields = {}; // of each item, with what the operator has entered
const NOT_IN_USE = 4;
const STATES = [["", t("not done")], ["good", t("done")], ["care", t("out of date")], ["bad", t("failed")], ["care", t("not in use")]];
const MEASURED = ["timing", "response", "calibrate", "check", "region", "noise", "advise", "settings"];
let open = "";

export function show(place) {
  const list = make("ol", { class: "list" }), procedure = procedurePanel(MEASURED), work = make("div");
  let leave = () => {}, shown = null;
  place.replaceChildren(make("div", { class: "columns" }, make("section", {}, list), make("section", {}, procedure.element, work)));
  const choose = (item) => {
    open = item;
    paint();
    list.querySelector(`#item-${item} h3`).focus();
  };
  const paint = () => {
    patch(list, ...(latest("setup") ?? []).map((item) => entry(item, choose)));
    if (shown === open) return;
    shown = open;
    leave();
    leave = workplace(work, open);
  };
  const ends = [procedure.end, () => leave(), ...["setup", "procedure", "wheel", "rig"].map((topic) => listen(topic, paint))];
  return () => ends.forEach((end) => end());
}

function entry(item, choose) {
  const [colour, state] = STATES[item.state], when = item.done ? `, ${date(item.done)}` : "";
  const chosen = item.item === open;
  return make("li", { class: `${colour}${chosen ? " now" : ""}`, id: `item-${item.item}` },
    make("div", { class: "row" }, make("h3", { tabindex: -1 }, known(item.title)), make("span", { class: colour || "soft" }, `${state}${when}`),
      button(t("Open"), { hidden: chosen, "data-key": "open", onclick: () => choose(item.item), "aria-label": t("Open {item}", { item: known(item.title) }) })),
    make("p", { class: "soft next", lang: spoken(item.next) }, known(item.next)),
    item.state === NOT_IN_USE ? button(t("Use this result"), { class: "use-result", "data-key": "use", why: cannotStart(), onclick: () => start({ procedure: "use", pattern: item.item }) }) : null,
    chosen ? make("div", {}, ...buttons(item.item), item.words.length ? make("pre", { lang: "en" }, item.words.join("\n")) : null,
      item.report ? make("p", {}, make("a", { href: item.report, target: "_blank", rel: "noopener" }, t("Report"))) : null,
      item.picture ? make("img", { src: `${item.picture}?${item.done}`, alt: t("Result: {item}", { item: known(item.title) }) }) : null) : null);
}

function buttons(item) {
  const why = cannotStart();
  if (item in LIVE) return [make("div", { class: "row" },
    button(t("Show the pattern"), { class: "main start", why, onclick: () => start({ procedure: "live", pattern: LIVE[item] }) }),
    button(t("It is adjusted"), { class: "done", why: notDriving(), onclick: () => start({ procedure: "confirm", pattern: item }) }))];
  if (item === "region") return [make("p", {}, t("Draw on the image, then use the region."))];
  const own = (fields[item] ??= (OPTIONS[item] ?? []).map(optionField));
  return [make("div", { class: "row" }, ...own.map(({ element }) => element), button(t("Measure"), { class: "main start", why, onclick: () => {
    const options = own.map(({ input, name, found }) => [name, found(), input.reportValidity()]);
    if (options.every(([, , valid]) => valid)) return start({ procedure: item, options: Object.fromEntries(options.filter(([, value]) => value !== null)) });
  } }))];
}

// One field for all changes of the list, so that what is being written stays.
function optionField({ label, name, kind, ...rest }) {
  const choice = () => {
    const input = make("input", { type: "checkbox", id: name });
    return { input, found: () => input.checked };
  };
  const list = () => {
    const { input, found } = numbersField({ id: name, ...rest });
    return { input, found: () => found()?.join(",") ?? null };
  };
  const { input, found } = kind === "choice" ? choice() : kind === "list" ? list() : numberField({ id: name, ...rest });
  return { input, name, found, element: keep(make("label", {}, label, input)) };
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
