// Requests to the server; a refusal is shown as its sentence.

export function say(text) {
  const place = document.getElementById("message");
  place.textContent = text;
  place.hidden = !text;
}

export async function command(name, content = {}) {
  try {
    const answer = await fetch(`/do/${name}`, {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(content),
    });
    say((await sentence(answer)) ?? "");
    return answer.ok;
  } catch {
    say("The server does not answer. The measurement goes on without this page; wait, or start fringedic again.");
    return false;
  }
}

async function sentence(answer) {
  const text = await answer.text();
  try {
    return JSON.parse(text).message;
  } catch {
    return text;
  }
}

async function get(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(await sentence(answer));
  return answer;
}

// Shows the sentence of a failed request, and returns null then.
export async function tried(request) {
  try {
    return await request;
  } catch (error) {
    say(error.message);
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

export async function tile(step, name) {
  const answer = await get(`/maps/${step}/${name}`);
  const values = new Float32Array(await answer.arrayBuffer());
  const [rows, columns, spacing] = ["Rows", "Columns", "Spacing"].map((key) => Number(answer.headers.get(`X-${key}`)));
  return { values, rows, columns, spacing };
}

export const cloud = async (step, name) => new Float32Array(await (await get(`/cloud/${step}/${name}`)).arrayBuffer());
export const palettes = async () => (await get("/palettes")).json();

const ends = (from, to) => `from=${from.join(",")}&to=${to.join(",")}`;
export const line = async (step, name, from, to) => (await get(`/line/${step}/${name}?${ends(from, to)}`)).json();
export const gauge = async (from, to, subset) => (await get(`/gauge?${ends(from, to)}&subset=${subset}`)).json();
