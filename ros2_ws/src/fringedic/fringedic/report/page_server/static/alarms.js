// Limits of signals at which the server requests a hold of the machine. They only ask; the machine's own limits protect.

import { button, notDriving } from "./buttons.js";
import { keep, make, options, patch } from "./elements.js";
import { decimal, known, spoken, t } from "./language.js";
import { numberField } from "./numbers.js";
import { command } from "./server.js";
import { latest, listen } from "./stream.js";

export function alarmsPanel() {
  const signal = keep(make("select", { id: "alarm-signal" })), below = numberField({ id: "alarm-below" }), above = numberField({ id: "alarm-above" });
  for (const { input } of [below, above]) keep(input);
  const element = make("section", { class: "panel", id: "alarms", hidden: true });
  let offered = "";
  const add = async () => {
    const limits = [below.found(), above.found()];
    if (!below.input.reportValidity() || !above.input.reportValidity()) return null;
    const others = plain().filter((each) => each.signal !== signal.value);
    const answer = await command("alarms", { alarms: [...others, { signal: signal.value, below: limits[0], above: limits[1] }] });
    if (answer !== null) below.input.value = above.input.value = "";
    return answer;
  };
  const paint = () => {
    const signals = latest("signals") ?? [], alarms = latest("alarms") ?? [], names = JSON.stringify(signals.map(({ name, unit }) => [name, unit]));
    if (names !== offered) options(signal, signals.map(({ name, unit }) => [name, `${known(name)} [${unit}]`]));
    offered = names;
    element.hidden = !latest("rig")?.load_frame && !latest("rig")?.machine;
    patch(element, make("h2", {}, t("Limits that request a hold")),
      make("p", { class: "soft" }, t("The page asks the machine to hold once, and pauses the programme. It only asks: protect people and machine by the machine’s own limits.")),
      make("ul", {}, ...alarms.map((alarm) => line(alarm, signals))),
      make("div", { class: "row" }, make("label", {}, t("Signal"), signal), make("label", {}, t("at or below"), below.input), make("label", {}, t("at or above"), above.input),
        button(t("Set this limit"), { id: "set-alarm", why: notDriving() || (signals.length ? "" : t("No signal has come yet: start measuring by hand, or a programme.")), onclick: add })));
  };
  const ends = ["alarms", "signals", "rig", "wheel"].map((topic) => listen(topic, paint));
  return { element, end: () => ends.forEach((end) => end()) };
}

const plain = () => (latest("alarms") ?? []).map(({ signal, below, above }) => ({ signal, below, above }));

function line(alarm, signals) {
  const { unit = "", value = null } = signals.find(({ name }) => name === alarm.signal) ?? {}, isChecked = value !== null;
  const words = [alarm.below === null ? "" : t("at or below {limit}", { limit: `${decimal(alarm.below)} ${unit}` }), alarm.above === null ? "" : t("at or above {limit}", { limit: `${decimal(alarm.above)} ${unit}` })].filter(Boolean).join(t(", or "));
  return make("li", { "data-key": alarm.signal }, make("span", { class: "row" }, `${known(alarm.signal)} ${words}`,
    alarm.reached ? make("strong", { class: "bad", lang: spoken(alarm.reached) }, known(alarm.reached)) : make("span", { class: isChecked ? "good" : "bad" }, isChecked ? t("in force") : t("not checked: the signal has no value now")),
    alarm.reached ? button(t("In force again"), { "data-key": "again", why: notDriving(), onclick: () => command("alarms", { alarms: plain() }) }) : null,
    button(t("Remove"), { "data-key": "remove", why: notDriving(), onclick: () => command("alarms", { alarms: plain().filter(({ signal }) => signal !== alarm.signal) }) })));
}
