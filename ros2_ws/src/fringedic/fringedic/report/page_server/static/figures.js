// Figures of the live image: focus, histogram, and each with what to do.

import { draw, make, patch } from "./elements.js";
import { known, spoken, t } from "./language.js";
import { listen } from "./stream.js";

export function figuresPanel() {
  const panel = make("div", { class: "panel", id: "figures" });
  const end = listen("figures", (figures) => patch(panel, ...(figures ? content(figures) : [make("p", { class: "soft" }, t("No figures yet: start the live view."))])));
  return { element: panel, end };
}

function content({ focus, entries, histogram }) {
  const percent = focus === null ? "–" : `${Math.round(100 * focus)} %`;
  return [
    make("h2", {}, t("Focus, relative to the best so far")), make("p", { class: "figure", id: "focus" }, percent),
    make("progress", { max: 1, value: focus ?? 0, "aria-label": t("focus") }),
    make("h3", {}, t("Grey levels")), bars(histogram),
    make("dl", {}, ...entries.flatMap(([name, value, advice, good]) => [
      make("dt", {}, known(name)), make("dd", {}, make("span", { lang: spoken(value) }, known(value)), " ", make("span", { class: good ? "good" : "bad", lang: spoken(advice) }, known(advice)))])),
  ];
}

// The square root keeps small classes visible.
function bars(histogram) {
  const highest = Math.sqrt(Math.max(...histogram, 1)), width = 256 / histogram.length;
  const svg = draw("svg", { class: "chart", viewBox: "0 0 256 60", role: "img", "aria-label": t("histogram from black to saturated") });
  histogram.forEach((count, k) => { const height = (60 * Math.sqrt(count)) / highest; svg.append(draw("rect", { class: "dot", x: k * width, y: 60 - height, width, height })); });
  return svg;
}
