// Numbers as people type them: with a decimal point or a decimal comma. What has two meanings is refused.

import { make } from "./elements.js";
import { decimal, t, usesComma } from "./language.js";

const PLAIN = /^[-+]?(\d+([.,]\d*)?|[.,]\d+)(e[-+]?\d+)?$/i;
// 1,234 is 1234 in one country, and 1.234 in another: the separator that the language does not have for decimals is refused
const THOUSANDS = usesComma ? /^[-+]?[1-9]\d{0,2}\.\d{3}$/ : /^[-+]?[1-9]\d{0,2},\d{3}$/;

// The number in a text, or the sentence that says how to write it.
export function parseNumber(text) {
  const typed = text.trim().replace("−", "-");
  if (/\d\s+\d/.test(typed)) return { problem: t("“{typed}” has a space: write one number", { typed }) };
  if ((typed.match(/[.,]/g) ?? []).length > 1) return { problem: t("“{typed}” has several separators: write thousands without them", { typed }) };
  if (THOUSANDS.test(typed)) return { problem: t("“{typed}” has two meanings: write {decimal} or {thousands}", { typed, decimal: typed.replace(/[.,]/, usesComma ? "," : "."), thousands: typed.replace(/[.,]/, "") }) };
  if (!PLAIN.test(typed) || !Number.isFinite(Number(typed.replace(",", ".")))) return { problem: t("“{typed}” is no number", { typed }) };
  return { value: Number(typed.replace(",", ".")) };
}

// The numbers of a list. Between them are semicolons or spaces; commas only where they cannot be decimal: before a space or
// a sign, or in a list of whole numbers.
export function parseNumbers(text, { whole = false } = {}) {
  const typed = text.trim();
  const separators = typed.includes(";") ? /\s*;\s*/ : whole ? /[\s,]+/ : /,?\s+|,(?=[-+−])/;
  const values = [];
  for (const part of typed.split(separators).filter(Boolean)) {
    if (!typed.includes(";") && !whole && part.includes(",")) {
      return { problem: t("“{part}” is one number with a decimal comma, or several: write {decimal}, or put semicolons between the numbers", { part, decimal: part.replace(",", ".") }) };
    }
    const { value, problem } = parseNumber(part);
    if (problem) return { problem };
    if (whole && !Number.isInteger(value)) return { problem: t("“{typed}” is no whole number", { typed: part }) };
    values.push(value);
  }
  return { values };
}

// A field for a number between `min` and `max`. `found` returns its number, null when it is empty, and undefined with the
// problem shown when it is none. `changed` is called when a person has finished a change.
export function numberField({ min = -Infinity, max = Infinity, odd = false, whole = false, changed, ...attributes }) {
  return field(attributes, changed, (text) => {
    const { value, problem } = parseNumber(text);
    if (problem) return { problem };
    if (value < min || value > max) return { problem: outside(value, min, max) };
    if ((whole || odd) && !Number.isInteger(value)) return { problem: t("“{typed}” is no whole number", { typed: decimal(value) }) };
    return odd && value % 2 === 0 ? { problem: t("{value} is even: write an odd number", { value }) } : { value };
  });
}

// A field for several numbers, or `count` of them; `found` as of `numberField`, with their list.
export function numbersField({ count, whole, changed, ...attributes }) {
  return field(attributes, changed, (text) => {
    const { values, problem } = parseNumbers(text, { whole });
    if (problem) return { problem };
    return count && values.length !== count ? { problem: t("numbers: {found}, but {count} are needed", { found: values.length, count }) } : { value: values };
  });
}

function field({ value, ...attributes }, changed, read) {
  const input = make("input", { type: "text", inputmode: "decimal", autocomplete: "off", class: "number", ...attributes });
  input.value = typeof value === "number" ? decimal(value) : value ?? "";
  const found = () => {
    const { value: number = undefined, problem = "" } = input.value.trim() ? read(input.value) : { value: null };
    input.setCustomValidity(problem);
    input.title = problem;
    return problem ? undefined : number;
  };
  input.addEventListener("input", found);
  if (changed) input.addEventListener("change", () => { if (found() !== undefined) changed(); else input.reportValidity(); });
  return { input, found };
}

function outside(number, smallest, largest) {
  const [value, min, max] = [number, smallest, largest].map(decimal);
  if (largest === Infinity) return t("{value} is below {min}", { value, min });
  return smallest === -Infinity ? t("{value} is above {max}", { value, max }) : t("{value} is outside {min} to {max}", { value, min, max });
}
