// The stream of the server: the latest message of each topic, and who is told about it.

const topics = new Map();
const listeners = new Set();

export const latest = (topic) => topics.get(topic);

// Calls a function with every new message of a topic, and at once with the one that is there; returns what ends that.
export function listen(topic, callback) {
  const entry = { topic, callback };
  listeners.add(entry);
  if (topics.has(topic)) callback(topics.get(topic));
  return () => listeners.delete(entry);
}

// The next message of a topic.
export const next = (topic) => new Promise((taken) => {
  const entry = { topic, callback: (data) => { listeners.delete(entry); taken(data); } };
  listeners.add(entry);
});

function publish(topic, data) {
  topics.set(topic, data);
  for (const entry of [...listeners]) if (entry.topic === topic) entry.callback(data);
}

// An image: width and height of the camera's frame, its stamp in seconds, and a JPEG.
function image(buffer) {
  const head = new DataView(buffer);
  return {
    width: head.getUint32(0, true),
    height: head.getUint32(4, true),
    stamp: head.getFloat64(8, true),
    blob: new Blob([buffer.slice(16)], { type: "image/jpeg" }),
  };
}

export function connect() {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/stream`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => publish("connected", true);
  socket.onmessage = ({ data }) => {
    if (typeof data !== "string") return publish("image", image(data));
    const message = JSON.parse(data);
    publish(message.topic, message.data);
  };
  socket.onclose = () => {
    publish("connected", false);
    setTimeout(connectAgain, 1000);
  };
}

// A server of another start refuses this session for ever: its sentence says what to do.
async function connectAgain() {
  const answer = await fetch("/").catch(() => null);
  if (answer?.status === 403) publish("refused", await answer.text());
  else connect();
}
