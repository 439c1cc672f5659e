// A programme as a form: the content of its text, which is the only programme. The server writes and reads the text.

import { button } from "./buttons.js";
import { make } from "./elements.js";
import { decimal, t } from "./language.js";
import { numberField } from "./numbers.js";
import { say } from "./server.js";

const NUMBER = { position_mm: t("to [mm]"), from_mm: t("from [mm]"), to_mm: t("to [mm]"), steps: t("steps"), repeats_at_rest: t("repeats at rest"), speed_mm_per_s: t("speed [mm/s]"), hold_s: t("hold [s]"), times: t("times"), every_s: t("from stack to stack [s]") };
const WHOLE = ["steps", "repeats_at_rest", "times"];
const LIMITS = { force_above_n: t("force rises to [N]"), force_below_n: t("force falls to [N]"), strain_above_percent: t("strain rises to [%]"), strain_below_percent: t("strain falls to [%]"), time_above_s: t("time of the move [s]"), valid_fraction_below: t("measured part falls to (0 to 1)") };
const OF_A_MOVE = Object.keys(LIMITS).filter((key) => key !== "valid_fraction_below"), OF_A_BLOCK = Object.keys(LIMITS).filter((key) => key !== "time_above_s");
const MODES = [["fringes", t("shape and displacement")], ["white", t("one white frame")], ["none", t("nothing")], ["moving", t("shape and displacement during the move")]];
const NEW = {
  step: () => ({ position_mm: 0 }), continuous: () => ({ continuous: { to_mm: 1, speed_mm_per_s: 0.02 } }), ramp: () => ({ ramp: { to_mm: 1, steps: 11 } }), hold: () => ({ hold_s: 60, mode: "none" }),
  cycle: () => ({ cycle: { times: 10, steps: [{ position_mm: 1 }, { position_mm: 0 }] } }),
};
const ADDED = { step: t("a step"), continuous: t("a measured move"), ramp: t("a ramp"), hold: t("a hold"), cycle: t("a cycle") };

const PRESSED_MS = 50; // until it is looked again whether a press has ended

// The form; `changed` is called with the whole programme after each change. What a person writes in stays while the text follows.
export class ProgrammeForm {
  constructor(changed) {
    this.changed = changed;
    this.element = make("div", { id: "form" });
    this.programme = null;
    this.isBehind = false; // the text was changed and has not been read: a change of the form would undo that of the text
    for (const event of ["click", "change"]) this.element.addEventListener(event, (what) => this.refuse(what), true);
  }

  refuse(event) {
    if (!this.isBehind || (event.type === "click" && !event.target.closest("button"))) return;
    event.preventDefault();
    event.stopPropagation();
    say(t("The programme is being checked."));
  }

  // Shows the content of a text; null: it cannot be read. A press that has begun is answered before its button is replaced.
  show(programme) {
    clearTimeout(this.later);
    if (this.element.matches(":active")) {
      this.later = setTimeout(() => this.show(programme), PRESSED_MS);
      return;
    }
    this.isBehind = false;
    if (JSON.stringify(programme) === JSON.stringify(this.programme)) return;
    this.programme = structuredClone(programme);
    this.render();
  }

  render() {
    const { programme } = this, done = () => this.changed(programme), again = () => { this.render(); done(); };
    this.element.replaceChildren(...(programme ? parts(programme, done, again) : [make("p", { class: "soft" }, t("The form is shown again when the text can be read."))]));
  }
}

// `done` after a change of a field, `again` after one of the list of entries, which is then drawn again.
function parts(programme, done, again) {
  const alone = Object.keys(ALONE).find((key) => programme[key] && !programme.steps);
  if (alone) {
    const add = (entry) => { programme.steps = [{ [alone]: programme[alone] }, entry]; delete programme[alone]; again(); };
    return [name(programme, done), make("div", { class: "entry" }, ALONE[alone](programme[alone], done)), adders(add)];
  }
  if (!Array.isArray(programme.steps)) programme.steps = [];
  return [name(programme, done), list(programme.steps, done, again)];
}

function name(programme, done) {
  const input = make("input", { type: "text", id: "form-experiment", pattern: "[A-Za-z0-9_\\-]+", title: t("letters, digits, _ and -"), onchange: () => { if (input.reportValidity()) { programme.experiment = input.value; done(); } } });
  input.value = programme.experiment ?? "experiment";
  return make("div", { class: "row" }, make("label", {}, t("Name of the programme"), input));
}

function list(entries, done, again) {
  const moved = (from, to) => { entries.splice(to, 0, ...entries.splice(from, 1)); again(); };
  const tools = (k) => make("span", { class: "row" },
    button("↑", { "aria-label": t("Earlier"), why: k ? "" : t("It is the first."), onclick: () => moved(k, k - 1) }),
    button("↓", { "aria-label": t("Later"), why: k < entries.length - 1 ? "" : t("It is the last."), onclick: () => moved(k, k + 1) }),
    button(t("Remove"), { onclick: () => { entries.splice(k, 1); again(); } }));
  return make("div", { class: "entries" }, ...entries.map((entry, k) => make("div", { class: "entry" }, body(entry, done, again), tools(k))),
    adders((entry) => { entries.push(entry); again(); }));
}

const adders = (add) => make("div", { class: "row adders" }, t("Add:"), ...Object.entries(NEW).map(([kind, made]) => button(ADDED[kind], { class: `add-${kind}`, onclick: () => add(made()) })));

function body(entry, done, again) {
  const alone = Object.keys(ALONE).find((key) => entry?.[key]);
  if (alone) return ALONE[alone](entry[alone], done);
  if (entry?.cycle) {
    const { cycle } = entry, steps = Array.isArray(cycle.steps) ? cycle.steps : (cycle.steps = []);
    return make("fieldset", {}, make("legend", {}, t("Cycle")), make("div", { class: "row" }, numbers(cycle, ["times"], done)), limits(cycle, OF_A_BLOCK, done), list(steps, done, again));
  }
  if (entry === null || typeof entry !== "object") return make("p", { class: "bad" }, t("This entry is no step: change it in the text."));
  const isHold = entry.mode === "none" && !("position_mm" in entry), pace = numbers(entry, ["every_s"], done);
  const show = () => { pace.hidden = entry.mode !== "moving" && !("every_s" in entry); };
  show();
  return make("fieldset", {}, make("legend", {}, isHold ? t("Hold") : t("Step")), make("div", { class: "row" }, numbers(entry, isHold ? ["hold_s"] : ["position_mm", "speed_mm_per_s", "hold_s"], done),
    isHold ? null : mode(entry, () => { show(); done(); }, MODES), pace, isHold ? null : reference(entry, done)), isHold || !("position_mm" in entry) ? null : limits(entry, OF_A_MOVE, done));
}

const ramp = (content, done) => make("fieldset", {}, make("legend", {}, t("Ramp")),
  make("div", { class: "row" }, numbers(content, ["from_mm", "to_mm", "steps", "speed_mm_per_s", "hold_s", "repeats_at_rest"], done), mode(content, done, MODES.slice(0, 2))), limits(content, OF_A_BLOCK, done));

const continuous = (content, done) => make("fieldset", {}, make("legend", {}, t("Measured move")),
  make("div", { class: "row" }, numbers(content, ["from_mm", "to_mm", "speed_mm_per_s", "every_s"], done, NUMBER, { from_mm: 0, every_s: 0 })), limits(content, OF_A_MOVE, done));

const ALONE = { ramp, continuous }; // entries that can be the whole programme

const DEFAULTS = { from_mm: 0, speed_mm_per_s: 1, hold_s: 0, repeats_at_rest: 0, every_s: 0 };

// Fields of numbers; an empty one leaves its key out.
function numbers(content, keys, done, labels = NUMBER, defaults = DEFAULTS) {
  return make("span", { class: "row" }, ...keys.map((key) => {
    const { input, found } = numberField({ "data-key": key, whole: WHOLE.includes(key), placeholder: decimal(defaults[key] ?? ""), value: content[key] ?? "", changed: () => set(content, key, found(), done) });
    return make("label", {}, labels[key], input);
  }));
}

function set(content, key, value, done) {
  if (value === null || value === "") delete content[key];
  else content[key] = value;
  done();
}

function mode(content, done, modes) {
  const select = make("select", { "data-key": "mode", onchange: () => set(content, "mode", select.value === "fringes" ? null : select.value, done) }, ...modes.map(([value, text]) => make("option", { value, selected: (content.mode ?? "fringes") === value }, text)));
  return make("label", {}, t("measures"), select);
}

const reference = (content, done) => make("label", {}, make("input", { type: "checkbox", checked: Boolean(content.set_reference), onchange: ({ target }) => set(content, "set_reference", target.checked || null, done) }), t("new reference"));

// Conditions that end a move, a ramp or a cycle earlier.
function limits(content, keys, done) {
  const until = { ...content.until }, changed = () => { set(content, "until", Object.keys(until).length ? until : null, done); };
  return make("details", { open: Boolean(content.until) }, make("summary", {}, t("Ends earlier when")), numbers(until, keys, changed, LIMITS));
}
