// Builds elements, and changes those that are shown: make("button", {class: "main", onclick: start}, "Start").

import { decimal, t } from "./language.js";

// The attributes that each element was made with: `patch` compares them, not the page, where a person types and opens.
const made = new WeakMap();
const lasting = new WeakSet();
const standsFor = new WeakMap();

export function make(tag, attributes = {}, ...children) {
  return build(document.createElement(tag), attributes, children);
}

export function draw(tag, attributes = {}, ...children) {
  return build(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

function build(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) put(element, name, value);
  made.set(element, attributes);
  element.append(...children.filter(isShown).map((child) => (lasting.has(child) && child.isConnected ? standIn(child) : child)));
  return element;
}

// What stands in an element that is being built for one that is shown already: moving that one would take the focus from it.
function standIn(element) {
  const comment = document.createComment("");
  standsFor.set(comment, element);
  return comment;
}

// Puts the lasting elements in the places of those that stand for them.
function settle(node) {
  for (const child of [...node.childNodes]) {
    if (standsFor.has(child)) child.replaceWith(standsFor.get(child));
    else settle(child);
  }
}

const isShown = (child) => child !== null && child !== undefined;

function put(element, name, value) {
  if (name.startsWith("on")) element[name] = value ?? null;
  else if (value === true) element.setAttribute(name, "");
  else if (value === false || !isShown(value)) element.removeAttribute(name);
  else element.setAttribute(name, value);
}

// An element with a state of its own, such as a text field: `patch` shows this one, and never another in its place.
export function keep(element) {
  lasting.add(element);
  return element;
}

// Shows these children. An element that is there already, with the same tag and id (or data-key; else class), stays the same one and
// is changed: a button that is pressed, a field that is written in and a fold that is open outlast every message.
export function patch(place, ...children) {
  const wanted = children.filter(isShown).map((child) => standsFor.get(child) ?? (child instanceof Node ? child : document.createTextNode(child)));
  const free = [...place.childNodes].filter((old) => !wanted.includes(old));
  const shown = wanted.map((child) => {
    const at = child.parentNode === place ? -1 : free.findIndex((old) => isSame(old, child));
    if (at < 0) {
      if (child.parentNode !== place) settle(child);
      return child;
    }
    const [old] = free.splice(at, 1);
    change(old, child);
    return old;
  });
  free.forEach((old) => old.remove()); // first, so that the others need not move
  shown.forEach((node, k) => { if (place.childNodes[k] !== node) place.insertBefore(node, place.childNodes[k] ?? null); });
}

const key = (node) => node.id || node.dataset?.key || "";
// Without a key the class tells a row of buttons from a table: one must not be turned into the other while a button is pressed.
const isSame = (old, child) => old.nodeName === child.nodeName && key(old) === key(child) && !lasting.has(old) && !lasting.has(child)
  && (key(old) || made.get(old)?.class === made.get(child)?.class);

function change(old, child) {
  if (old.nodeType === Node.TEXT_NODE) {
    if (old.data !== child.data) old.data = child.data;
    return;
  }
  const before = made.get(old) ?? {}, now = made.get(child) ?? {};
  for (const name of new Set([...Object.keys(before), ...Object.keys(now)])) if (before[name] !== now[name]) put(old, name, now[name]);
  made.set(old, now);
  patch(old, ...child.childNodes);
}

export function options(select, entries, chosen) {
  const value = chosen ?? select.value;
  select.replaceChildren(...entries.map(([key, text]) => make("option", { value: key }, text)));
  if (entries.some(([key]) => String(key) === String(value))) select.value = value;
}

export function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  return decimal(size >= 1e5 || size < 1e-3 ? value.toExponential(digits - 1) : Number(value.toPrecision(digits)));
}

// A value in another unit; what is missing (null in a message) stays missing, and is never 0.
export const scaled = (value, factor) => (value === null || value === undefined ? NaN : value * factor);

// A value and its standard deviation with two digits of it, as in "12.34 ± 0.56 µm".
export function withSigma(value, sigma, unit) {
  if (!Number.isFinite(value)) return t("not measured");
  if (!Number.isFinite(sigma) || sigma <= 0) return `${number(value, 4)} ${unit}`.trim();
  const digits = Math.min(Math.max(1 - Math.floor(Math.log10(sigma)), 0), 9);
  return `${decimal(value.toFixed(digits))} ± ${decimal(sigma.toFixed(digits))} ${unit}`.trim();
}
