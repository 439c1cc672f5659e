// Requests to the server; a refusal is shown as its sentence.

import { known, language, spoken, t } from "./language.js";
import { lookAt, shownTest } from "./shown.js";
import { next } from "./stream.js";

const ACKNOWLEDGED_MS = 150; // after which a command without an answer is said to be on its way
const PASSING_MS = 4000;
const CHANGED_MS = 1000; // longest time between the answer to a start and the message of its procedure
let isRefusal = false, passing = 0;

// Shows a sentence, of the server in its language; one that `isPassing` vanishes by itself, a refusal when the procedure changes.
export function say(text, { refusal = false, isPassing = false, lang = language } = {}) {
  const place = document.getElementById("message");
  place.textContent = text;
  place.lang = lang;
  place.hidden = !text;
  isRefusal = refusal;
  clearTimeout(passing);
  if (isPassing) passing = setTimeout(() => say(""), PASSING_MS);
}

// Another procedure, or another state of it: a refusal that was about the one before is no longer true.
export function forgetRefusal() {
  if (isRefusal) say("");
}

// Sends a command; returns the sentence of its answer, which is shown, or null when it is refused.
export async function command(name, content = {}) {
  const waiting = setTimeout(() => say(t("Sent; the rig has not answered yet.")), ACKNOWLEDGED_MS);
  try {
    const answer = await post(`/do/${name}`, content), text = (await sentence(answer)) ?? "";
    clearTimeout(waiting);
    say(known(text), { refusal: !answer.ok, lang: spoken(text) ?? language });
    return answer.ok ? known(text) : null;
  } catch {
    clearTimeout(waiting);
    say(t("The server does not answer. The measurement goes on without this page; wait, or start fringedic again."));
    return null;
  }
}

// Starts a procedure, and waits until the page shows it: a second press of a double click is none.
export async function start(content) {
  const answer = await command("start", content);
  const topic = { live: "live", confirm: "setup" }[content.procedure] ?? "procedure";
  if (answer !== null) await Promise.race([next(topic), new Promise((done) => setTimeout(done, CHANGED_MS))]);
  return answer;
}

export const post = (path, content) => fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(content) });

async function sentence(answer) {
  const text = await answer.text();
  try {
    const { message, sentence: inParts } = JSON.parse(text);
    return inParts ?? message;
  } catch {
    return text;
  }
}

// The error of a refusal, with its sentence and the language of that.
export async function refused(answer) {
  const why = await sentence(answer);
  return Object.assign(new Error(known(why)), { lang: spoken(why) ?? language });
}

async function get(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw await refused(answer);
  return answer;
}

// Shows the sentence of a failed request, and returns null then.
export async function tried(request) {
  try {
    return await request;
  } catch (error) {
    say(error.message, { lang: error.lang });
    return null;
  }
}

// Returns a function that awaits one request after the other: the answer to an earlier one that comes late is null.
export function newest() {
  let asked = 0;
  return async (request) => {
    const own = ++asked;
    try {
      const answer = await request;
      return own === asked ? answer : null;
    } catch (error) {
      if (own === asked) throw error;
      return null;
    }
  };
}

// An address about the test that is looked at, or about another one.
const about = (path, test = shownTest()) => (test ? `${path}${path.includes("?") ? "&" : "?"}test=${encodeURIComponent(test)}` : path);

export async function tile(step, name, test) {
  const answer = await get(about(`/maps/${step}/${name}`, test));
  const values = new Float32Array(await answer.arrayBuffer());
  const [rows, columns, spacing] = ["Rows", "Columns", "Spacing"].map((key) => Number(answer.headers.get(`X-${key}`)));
  return { values, rows, columns, spacing };
}

export const cloud = async (step, name) => new Float32Array(await (await get(about(`/cloud/${step}/${name}`))).arrayBuffer());

async function posted(path, content) {
  const answer = await post(path, content);
  if (!answer.ok) throw await refused(answer);
  return answer.json();
}

// Named evaluations of a test, its steps and settings, and what is being computed.
export const evaluations = async (folder, sensor) => (await get(`/evaluations/${encodeURIComponent(folder)}?${new URLSearchParams({ sensor })}`)).json();

// What a programme would do, and why it may not be started.
export const checkProgramme = (text) => posted("/check", { text });
// The text of a programme that was changed in the form.
export const composeProgramme = async (programme) => (await posted("/compose", { programme })).text;
// What marks read on a map at some steps, or at all.
export const readings = (name, marks, steps = null) => posted(about("/readings"), { name, marks, steps });

let colours = null;
export async function palettes() {
  colours ??= await (await get("/palettes")).json();
  return colours;
}

const ends = (from, to) => `from=${from.join(",")}&to=${to.join(",")}`;
export const line = async (step, name, from, to) => (await get(about(`/line/${step}/${name}?${ends(from, to)}`))).json();
export const gauge = async (from, to, subset) => (await get(about(`/gauge?${ends(from, to)}&subset=${subset}`))).json();

// The topics of an earlier test.
export const testTopics = async (name) => (await get(`/tests/${encodeURIComponent(name)}`)).json();

const opening = newest(); // the one that was chosen last, also when its answer comes first

export async function openTest(name) {
  const answer = opening(name ? testTopics(name) : null), topics = name ? await answer : null;
  if (topics || !name) lookAt(name, topics);
}
