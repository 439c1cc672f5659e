// The start page: the rigs of this folder, the tests that were measured, and the series of specimens that is planned.

import { button } from "./buttons.js";
import { keep, make, patch } from "./elements.js";
import { cannotStart } from "./procedure.js";
import { command, start } from "./server.js";
import { latest, listen } from "./stream.js";
import { SPECIMEN } from "./test_form.js";

const kept = { search: "", compared: [] };

export function show(place) {
  const search = keep(make("input", { type: "search", id: "search", placeholder: "name, specimen, operator, any entry" }));
  search.value = kept.search;
  const list = make("div", { class: "panel" }), side = make("section"), table = make("div", { class: "scroll tests" });
  const paint = () => {
    patch(list, make("h2", {}, "Tests"), make("div", { class: "row" }, make("label", {}, "Search", search),
      make("a", { href: "#run", class: "button", id: "new-test" }, "New test"),
      make("a", { href: `#compare`, class: "button", id: "compare-tests" }, `Compare (${kept.compared.length} chosen)`)), table);
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
  const text = [test.name, test.rig, test.verdict, ...Object.entries(test.answers ?? {}).flat()].join(" ").toLowerCase();
  return kept.search.toLowerCase().split(/\s+/).every((word) => text.includes(word));
}

function testRows() {
  const tests = latest("tests") ?? [], shown = tests.filter(found);
  if (!tests.length) return [make("p", { class: "soft" }, "No test has been measured with this rig file yet.")];
  if (!shown.length) return [make("p", { class: "soft" }, "No test contains these words.")];
  const head = ["", "test", "specimen", "operator", "date", "result", ""].map((name) => make("th", { class: "words" }, name));
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
    cell(specimen), cell(operator), cell(new Date(1000 * when).toLocaleString()), cell(make("span", { class: state }, verdict)),
    cell(make("span", { class: "row" },
      report ? make("a", { href: reportOf(name), target: "_blank", rel: "noopener" }, "report") : null,
      report ? make("a", { href: reportOf(name), download: `${name}.html` }, "save") : null,
      results ? button("Compare", { "data-key": "compare", "aria-pressed": String(kept.compared.includes(name)), onclick: choose }) : null,
      continues ? button("Go on", { "data-key": "go-on", why: cannotStart(), onclick: () => start({ procedure: "run", options: { continue_run: name } }) }) : null)));
}

// One click measures the next specimen with the programme and the answers of the series.
function seriesParts() {
  const { specimens = [], answers = {}, text = "", planned = 0, problem = "" } = latest("series") ?? {}, tests = latest("tests") ?? [];
  const common = Object.entries(answers).map(([name, value]) => `${name} ${value}`).join(", ");
  const lines = specimens.map((specimen) => {
    const done = tests.find((each) => each.specimen === specimen && each.when >= planned);
    return make("li", { class: "row", "data-key": specimen }, make("strong", {}, specimen),
      done ? make("span", { class: done.state }, `${done.name}: ${done.verdict}`) : make("span", { class: "soft" }, "not tested"),
      button(done ? "Test again" : "Test", { class: done ? "" : "main", "data-key": "test", "aria-label": `Test ${specimen}`, why: cannotStart(),
        onclick: () => start({ procedure: "run", text, options: { test: { ...answers, [SPECIMEN]: specimen } } }) }));
  });
  return [make("h2", {}, "Series"), problem ? make("p", { class: "bad" }, problem) : null,
    specimens.length ? make("p", { class: "soft" }, `Programme ${text ? "written for the series" : "of the rig file"}${common ? `; ${common}` : ""}.`)
      : make("p", { class: "soft" }, "None is planned. In Run, fill in the form and choose the programme; then plan a series there."),
    make("ol", { class: "list" }, ...lines),
    specimens.length ? button("Remove the series", { id: "remove-series", onclick: () => command("series", {}) }) : null];
}

function rigParts() {
  const rigs = latest("rigs") ?? [];
  return [make("h2", {}, "Rigs of this computer"), make("ul", {}, ...rigs.map(({ file, tests, own }) => make("li", { "data-key": file },
    make("strong", {}, file), tests === null ? "" : `, ${tests} tests`, own ? " (this page)" : make("span", { class: "soft" }, `: open it with fringedic operate ${file}`))))];
}
