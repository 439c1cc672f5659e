// The test that is looked at: the one that runs or ran last, or an earlier one that was opened.

import { latest, listen } from "./stream.js";

const listeners = new Set();
let opened = null; // its name and its topics

// Name of the opened test; empty for the one that runs or ran last.
export const shownTest = () => opened?.name ?? "";
export const shown = (topic) => (opened ? opened.topics[topic] : latest(topic));

// Like `listen`, for a topic of the test that is looked at.
export function listenShown(topic, callback) {
  const entry = { topic, callback }, end = listen(topic, (data) => { if (!opened) callback(data); });
  listeners.add(entry);
  if (opened) callback(opened.topics[topic]);
  return () => { listeners.delete(entry); end(); };
}

// Looks at an earlier test, or with an empty name at the present one.
export function lookAt(name, topics) {
  opened = name ? { name, topics } : null;
  for (const { topic, callback } of [...listeners]) if (shown(topic) !== undefined) callback(shown(topic));
}

// Another content of a topic of the opened test, which this page has changed.
export function replaceShown(topic, data) {
  if (!opened) return;
  opened.topics = { ...opened.topics, [topic]: data };
  lookAt(opened.name, opened.topics);
}
