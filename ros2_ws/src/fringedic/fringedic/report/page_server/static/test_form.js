// The form of a test: fields of the rig file, filled before each test.

import { button } from "./buttons.js";
import { keep, make, options } from "./elements.js";
import { decimal, known, t } from "./language.js";
import { numberField } from "./numbers.js";
import { latest } from "./stream.js";

const OF_ONE_TEST = ["name", "number", "test_number"]; // entries of the specimen that differ from test to test
let of = "", fields = []; // the form that the fields belong to; they keep what was typed while views change

// The fields as labels; they are made again when the rig file has another form.
export function formParts() {
  const { form = [], answers = {} } = latest("rig") ?? {}, known = JSON.stringify([form, answers]);
  if (known !== of) [of, fields] = [known, form.map((each) => formField(each, answers[each.name]))];
  if (!form.length) return [];
  const last = (latest("tests") ?? []).find((each) => Object.keys(each.answers ?? {}).length);
  return [make("div", { class: "form", id: "test-form" }, ...fields.map(({ element }) => element)),
    last ? button(t("Fill in as the last test"), { id: "as-last", onclick: () => fill(last.answers) }) : null];
}

// Fills the form, but for what the next test has of its own.
function fill(answers) {
  for (const { name, entry, input } of fields) if (!OF_ONE_TEST.includes(entry) && name in answers) input.value = typeof answers[name] === "number" ? decimal(answers[name]) : answers[name];
}

// The answers by the names of the fields; null, with the problem shown, when one is not valid. An empty field removes the entry of the rig file.
export function testAnswers() {
  const found = fields.map(({ name, input, found }) => [name, found(), input.reportValidity()]);
  if (!found.every(([, value, valid]) => valid && value !== undefined)) return null;
  const written = latest("rig")?.answers ?? {};
  return Object.fromEntries(found.map(([name, value]) => [name, value ?? ""]).filter(([name, value]) => value !== "" || name in written));
}

function formField({ name, entry, kind, choices, minimum, maximum, required }, value) {
  const id = `test-${name.replace(/[^a-z0-9]+/gi, "-")}`, label = required ? t("{field} (required)", { field: known(name) }) : known(name);
  if (kind === "number") {
    const { input, found } = numberField({ id, min: minimum ?? -Infinity, max: maximum ?? Infinity, value: value ?? "", required });
    return { name, entry, input, found, element: keep(make("label", {}, label, input)) };
  }
  const input = choices ? make("select", { id, required }) : make("input", { id, type: "text", maxlength: 1000, autocomplete: "off", required });
  if (choices) options(input, [["", "–"], ...choices.map((each) => [each, each])], value ?? "");
  else input.value = value ?? "";
  return { name, entry, input, found: () => input.value.trim(), element: keep(make("label", {}, label, input)) };
}
