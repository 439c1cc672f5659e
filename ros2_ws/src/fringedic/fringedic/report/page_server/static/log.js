// State of the nodes, and the log.

import { make, number, patch } from "./elements.js";
import { listen } from "./stream.js";

const COLOURS = { ok: "good", warning: "care", error: "bad", silent: "bad", fatal: "bad" };

export function show(place) {
  const nodes = make("table", { id: "nodes" }), lines = make("pre", { id: "log", tabindex: 0 });
  place.replaceChildren(
    make("section", { class: "panel" }, make("h2", {}, "Nodes"), make("div", { class: "scroll" }, nodes)),
    make("section", { class: "panel" }, make("h2", {}, "Log"), make("div", { class: "scroll" }, lines)));
  const ends = [
    listen("nodes", (found) => patch(nodes, head("node", "state", "per second", "delay [s]", "lost"),
      ...found.map(({ name, level, message, values }) => make("tr", {}, make("td", {}, name), make("td", { class: COLOURS[level] }, `${level}: ${message}`),
        ...["rate_hz", "latency_s", "drops"].map((key) => make("td", {}, number(parseFloat(values[key])))))))),
    listen("log", (found) => { lines.textContent = found.map(({ time, level, node, text }) => `${clock(time)} ${level} ${node}: ${text}`).reverse().join("\n") || "The log is empty."; }),
  ];
  return () => ends.forEach((end) => end());
}

const clock = (seconds) => new Date(1000 * seconds).toLocaleTimeString();
const head = (...names) => make("tr", {}, ...names.map((name) => make("th", {}, name)));
