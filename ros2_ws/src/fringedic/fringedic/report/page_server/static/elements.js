// Builds elements: make("button", {class: "main", onclick: start}, "Start").

export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  set(element, attributes);
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

export function draw(tag, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

function set(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
}

// Shows new children; the element of the same id, or else of the same text, keeps the focus of the keyboard.
export function repaint(place, ...children) {
  const active = place.contains(document.activeElement) ? document.activeElement : null, text = active?.textContent;
  place.replaceChildren(...children.filter((child) => child !== null && child !== undefined));
  if (!active || active === document.activeElement) return;
  const same = active.id ? document.getElementById(active.id) : [...place.querySelectorAll(active.tagName)].find((each) => each.textContent === text);
  same?.focus({ preventScroll: true });
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
  return size >= 1e5 || size < 1e-3 ? value.toExponential(digits - 1) : String(Number(value.toPrecision(digits)));
}

// A value and its standard deviation with two digits of it, as in "12.34 ± 0.56 µm".
export function withSigma(value, sigma, unit) {
  if (!Number.isFinite(value)) return "not measured";
  if (!Number.isFinite(sigma) || sigma <= 0) return `${number(value, 4)} ${unit}`.trim();
  const digits = Math.min(Math.max(1 - Math.floor(Math.log10(sigma)), 0), 9);
  return `${value.toFixed(digits)} ± ${sigma.toFixed(digits)} ${unit}`.trim();
}
