// State of the nodes, and the log.

import { make, number, patch } from "./elements.js";
import { clock, known, spoken, t } from "./language.js";
import { listen } from "./stream.js";

const COLOURS = { ok: "good", warning: "care", error: "bad", silent: "bad", fatal: "bad" };

export function show(place) {
  const nodes = make("table", { id: "nodes" }), lines = make("pre", { id: "log", tabindex: 0, lang: "en" });
  place.replaceChildren(
    make("section", { class: "panel" }, make("h2", {}, t("Nodes")), make("div", { class: "scroll" }, nodes)),
    make("section", { class: "panel" }, make("h2", {}, t("Log")), make("div", { class: "scroll" }, lines)));
  const ends = [
    listen("nodes", (found) => patch(nodes, head(t("node"), t("state"), t("per second"), t("delay [s]"), t("lost")),
      ...found.map(({ name, level, message, values }) => make("tr", {}, make("td", {}, name), make("td", { class: COLOURS[level] }, `${known(level)}: `, make("span", { lang: spoken(message) }, known(message))),
        ...["rate_hz", "latency_s", "drops"].map((key) => make("td", {}, number(parseFloat(values[key])))))))),
    listen("log", (found) => { lines.textContent = found.map(({ time, level, node, text }) => `${clock(time)} ${level} ${node}: ${text}`).reverse().join("\n") || t("The log is empty."); }),
  ];
  return () => ends.forEach((end) => end());
}

const head = (...names) => make("tr", {}, ...names.map((name) => make("th", {}, name)));
