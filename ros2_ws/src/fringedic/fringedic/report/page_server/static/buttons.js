// Buttons: a press arrives once, whatever the page shows meanwhile, and is answered.

import { make } from "./elements.js";
import { known, t } from "./language.js";
import { say } from "./server.js";
import { latest } from "./stream.js";

const SLIPPED_PX = 24; // beside the button, within which a release still belongs to it

// A button whose `onclick` may be asynchronous; a second press is ignored until it has ended. `why` is the reason why the
// button has no effect now: it can be read and pressed, and says its reason then.
export function button(text, { why = "", onclick, ...attributes }) {
  return make("button", {
    type: "button",
    ...attributes,
    "aria-disabled": why ? "true" : null,
    title: why || null,
    onclick: ({ currentTarget }) => (why ? say(why) : act(currentTarget, onclick)),
  }, text);
}

// Why this browser may give no commands; empty when it drives.
export function notDriving() {
  const wheel = latest("wheel");
  if (!wheel || wheel.drives) return "";
  return wheel.driver_present ? t("{browser} drives: ask for the wheel first.", { browser: known(wheel.driver) }) : t("Nobody drives: ask for the wheel first.");
}

async function act(element, action) {
  if (element.hasAttribute("aria-busy")) return;
  element.setAttribute("aria-busy", "true");
  try {
    if ((await action()) === "") say(t("{button}: accepted.", { button: element.textContent }), { isPassing: true });
  } finally {
    element.removeAttribute("aria-busy");
  }
}

// The release of a press belongs to the element on which it began, also when the page has moved under the pointer.
// The second press of a double click is one of the element of the first: another button may have taken its place meanwhile.
let pressed = null, first = null;
addEventListener("pointerdown", (event) => {
  const element = event.button === 0 ? event.target.closest?.("button, a, summary") : null;
  pressed = element && { element, x: event.clientX, y: event.clientY };
  element?.setPointerCapture(event.pointerId);
}, true);
addEventListener("click", (event) => {
  const { element, x, y } = pressed ?? {};
  pressed = null;
  if (event.detail < 2) first = element;
  if (!element || !element.contains(event.target) || event.detail === 0) return;
  const box = element.getBoundingClientRect();
  const beside = (value, low, high) => value < low - SLIPPED_PX || value > high + SLIPPED_PX;
  const isOutside = beside(event.clientX, box.left, box.right) || beside(event.clientY, box.top, box.bottom);
  const isSlipped = isOutside && Math.hypot(event.clientX - x, event.clientY - y) > SLIPPED_PX;
  if (isSlipped || element !== first) {
    event.preventDefault();
    event.stopPropagation();
  }
}, true);
