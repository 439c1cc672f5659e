// The language of the page: its sentences, numbers and dates. It is there before all other modules, whose lists of words are
// made once; after another choice the page is loaded again. The catalogues are ../languages/*.po.

const REMEMBERED = "fringedic.language";
const ENGLISH = { language: "en", languages: ["en"], sentences: {} };
const wanted = [localStorage.getItem(REMEMBERED), ...navigator.languages].filter(Boolean);
const found = await fetch(`/words?languages=${encodeURIComponent(wanted.join(","))}`).then((answer) => answer.json()).catch(() => ENGLISH);
const { language, languages } = found;
const sentences = Object.assign(Object.create(null), found.sentences); // without words of its own, such as constructor
const region = navigator.languages.find((each) => each.split("-")[0] === language) ?? language; // de-CH has a decimal point
const separator = language === "en" ? "." : new Intl.NumberFormat(region).formatToParts(0.5).find(({ type }) => type === "decimal").value;

document.documentElement.lang = language;

// A sentence of the page with its values: t("Step {step}", { step: 3 }).
export const t = (sentence, values = {}) => (sentences[sentence] ?? sentence).replace(/\{(\w+)\}/g, (_, name) => values[name]);

// A text of the server: a sentence with its values {template, values}, a fixed word of the catalogues, or any other text,
// which stays as it is: findings of the library are English, and names are those that a person has given.
export function known(text) {
  if (!text?.template) return sentences[text] ?? text;
  const shown = ([name, value]) => [name, /^[-+]?\d+\.\d+(e[-+]\d+)?$/.test(value) ? decimal(value) : known(value)];
  return t(text.template, Object.fromEntries(Object.entries(text.values).map(shown)));
}

// The attribute `lang` of an element with a text of the server, for screen readers.
export const spoken = (text) => (language === "en" || !text || (text.template ?? text) in sentences ? null : "en");

// Numbers that are written with a decimal point, as people of the language write them.
export const decimal = (text) => String(text).replace(/(?<=\d)\.(?=\d)/g, separator);
export const usesComma = separator === ",";

export const date = (seconds) => new Date(1000 * seconds).toLocaleString(region);
export const clock = (seconds) => new Date(1000 * seconds).toLocaleTimeString(region);

// The names of the languages, each in its own.
export const choices = languages.map((each) => [each, new Intl.DisplayNames([each], { type: "language" }).of(each)]);

export function choose(other) {
  localStorage.setItem(REMEMBERED, other);
  location.reload();
}

export { language };
