// The start page: the rigs of this folder, the tests that were measured, and the series of specimens that is planned.

import { button } from "./buttons.js";
import { keep, make, patch } from "./elements.js";
import { date, decimal, known, spoken, t } from "./language.js";
import { cannotStart } from "./procedure.js";
import { command, start } from "./server.js";
import { latest, listen } from "./stream.js";

const kept = { search: "", compared: [] };

export function show(place) {
  const search = keep(make("input", { type: "search", id: "search", placeholder: t("name, specimen, operator, any entry") }));
  search.value = kept.search;
  const list = make("div", { class: "panel" }), side = make("section"), table = make("div", { class: "scroll tests" });
  const paint = () => {
    patch(list, make("h2", {}, t("Tests")), make("div", { class: "row" }, make("label", {}, t("Search"), search),
      make("a", { href: "#run", class: "button", id: "new-test" }, t("New test")),
      make("a", { href: `#compare`, class: "button", id: "compare-tests" }, t("Compare (chosen: {count})", { count: kept.compared.length }))), table);
    patch(table, ...testRows());
    patch(side, make("div", { class: "panel", id: "series" }, ...seriesParts()), make("div", { class: "panel", id: "rigs" }, ...rigParts()));
  };
  search.addEventListener("input", () => { kept.search = search.value; paint(); });
  repaint = paint;
  place.replaceChildren(make("div", { class: "columns wide" }, list, side));
  const ends = ["tests", "rigs", "series", "rig", "procedure", "wheel"].map((topic) => listen(topic, paint));
  return () => { repaint = () => {}; ends.forEach((end) => end()); };
}

let repaint = () => {};

export const compared = () => kept.compared;
export const reportOf = (name) => `/files/${encodeURIComponent(`test ${name}`)}/report.html`;
const pictureOf = ({ name, when }) => `/tests/${encodeURIComponent(name)}/picture?${when}`;

// Every word has to be in a name, an entry or the verdict.
function found(test) {
  const text = [test.name, test.rig, known(test.verdict), ...Object.entries(test.answers ?? {}).flat()].join(" ").toLowerCase();
  return kept.search.toLowerCase().split(/\s+/).every((word) => text.includes(word));
}

function testRows() {
  const tests = latest("tests") ?? [], shown = tests.filter(found);
  if (!tests.length) return [make("p", { class: "soft" }, t("No test has been measured with this rig file yet."))];
  if (!shown.length) return [make("p", { class: "soft" }, t("No test contains these words."))];
  const head = ["", t("test"), t("specimen"), t("operator"), t("date"), t("result"), ""].map((name) => make("th", { class: "words" }, name));
  return [make("table", {}, make("tr", {}, ...head), ...shown.map(row))];
}

function row(test) {
  const { name, when, report, results, specimen, operator, state, verdict, continues } = test;
  const cell = (...parts) => make("td", { class: "words" }, ...parts);
  const choose = () => {
    kept.compared = kept.compared.includes(name) ? kept.compared.filter((each) => each !== name) : [...kept.compared, name].slice(-2);
    repaint();
  };
  return make("tr", { "data-key": name },
    cell(results ? make("img", { src: pictureOf(test), alt: "", class: "small", loading: "lazy" }) : null),
    cell(results ? make("a", { href: `#maps&test=${encodeURIComponent(name)}`, class: "open" }, name) : name),
    cell(specimen), cell(operator), cell(date(when)), cell(make("span", { class: state, lang: spoken(verdict) }, known(verdict))),
    cell(make("span", { class: "row" },
      report ? make("a", { href: reportOf(name), target: "_blank", rel: "noopener" }, t("report")) : null,
      report ? make("a", { href: reportOf(name), download: `${name}.html` }, t("save")) : null,
      results ? button(t("Compare"), { "data-key": "compare", "aria-pressed": String(kept.compared.includes(name)), onclick: choose }) : null,
      continues ? button(t("Go on"), { "data-key": "go-on", why: cannotStart(), onclick: () => start({ procedure: "run", options: { continue_run: name } }) }) : null)));
}

// One click measures the next specimen with the programme and the answers of the series.
function seriesParts() {
  const { specimens = [], answers = {}, text = "", planned = 0, problem = "" } = latest("series") ?? {}, tests = latest("tests") ?? [];
  const common = Object.entries(answers).map(([name, value]) => `${known(name)} ${typeof value === "number" ? decimal(value) : value}`).join(", ");
  const lines = specimens.map((specimen) => {
    const done = tests.find((each) => each.specimen === specimen && each.when >= planned);
    return make("li", { class: "row", "data-key": specimen }, make("strong", {}, specimen),
      done ? make("span", { class: done.state }, `${done.name}: ${known(done.verdict)}`) : make("span", { class: "soft" }, t("not tested")),
      button(done ? t("Test again") : t("Test"), { class: done ? "" : "main", "data-key": "test", "aria-label": t("Test {specimen}", { specimen }), why: cannotStart(),
        onclick: () => start({ procedure: "run", text, options: { test: { ...answers, [latest("rig").specimen_field]: specimen } } }) }));
  });
  return [make("h2", {}, t("Series")), problem ? make("p", { class: "bad" }, problem) : null,
    specimens.length ? make("p", { class: "soft" }, `${text ? t("Programme written for the series") : t("Programme of the rig file")}${common ? `; ${common}` : ""}.`)
      : make("p", { class: "soft" }, t("None is planned. In Run, fill in the form and choose the programme; then plan a series there.")),
    make("ol", { class: "list" }, ...lines),
    specimens.length ? button(t("Remove the series"), { id: "remove-series", onclick: () => command("series", {}) }) : null];
}

function rigParts() {
  const rigs = latest("rigs") ?? [];
  return [make("h2", {}, t("Rigs of this computer")), make("ul", {}, ...rigs.map(({ file, tests, own }) => make("li", { "data-key": file },
    make("strong", {}, file), tests === null ? "" : `, ${t("tests: {count}", { count: tests })}`, own ? ` ${t("(this page)")}` : make("span", { class: "soft" }, ` – ${t("open it with fringedic operate {file}", { file })}`))))];
}
