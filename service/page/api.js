// Talking to the service: JSON with the team's key, problems as errors, event streams by fetch.

let key = sessionStorage.getItem("nightglass-key") || "";

// No header takes more than visible ASCII: anything else becomes a key that the service refuses.
export function useKey(text) {
  key = text.trim().replace(/[^!-~]/g, "?");
  if (key) sessionStorage.setItem("nightglass-key", key);
  else sessionStorage.removeItem("nightglass-key");
}

export const hasKey = () => key !== "";

export class Problem extends Error {
  constructor(status, detail, errors) {
    super(detail);
    this.status = status;
    this.errors = errors || [];
  }
}

export async function ask(path, options = {}) {
  const headers = new Headers(options.headers);
  if (key) headers.set("Authorization", `Bearer ${key}`);
  let answer;
  try {
    answer = await fetch(path, { ...options, headers });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(0, "the service does not answer", []);
  }
  if (!answer.ok && answer.status !== 304) throw await problemOf(answer);
  return answer;
}

async function problemOf(answer) {
  try {
    const body = await answer.json();
    return new Problem(answer.status, body.detail || body.title, body.errors);
  } catch {
    return new Problem(answer.status, `status ${answer.status}`, []);
  }
}

export const json = async (path, options) => (await ask(path, options)).json();

export function send(path, value, headers = {}) {
  const body = typeof value === "string" ? value : JSON.stringify(value);
  return json(path, {
    method: "POST", body, headers: { "Content-Type": "application/json", ...headers },
  });
}

// Calls `told(job)` at every change of a job until it ends or `signal` aborts; reconnects.
export async function follow(path, told, signal) {
  let last = "";
  while (!signal.aborted) {
    try {
      const headers = last ? { "Last-Event-ID": last } : {};
      const answer = await ask(`${path}/events`, { headers, signal });
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      let text = "";
      for (;;) {
        const { value, done } = await reader.read();
        if (done) break;
        text += value;
        const events = text.split("\n\n");
        text = events.pop();
        for (const event of events) {
          const fields = Object.fromEntries(event.split("\n").map((line) => {
            const colon = line.indexOf(":");
            return [line.slice(0, colon), line.slice(colon + 1).trim()];
          }));
          if (fields.id) last = fields.id;
          if (fields.event === "deleted") return;
          if (fields.event === "job") {
            const job = JSON.parse(fields.data);
            told(job);
            if (ended(job)) return;
          }
        }
      }
    } catch (error) {
      if (signal.aborted || error.status === 404) return;
    }
    await new Promise((go) => setTimeout(go, 1000));
  }
}

export const ended = (job) => ["COMPLETED", "ERROR", "ABORTED"].includes(job.phase);

// A download that the browser makes by itself, piece by piece; where a key is needed, by a ticket.
export async function download(path, name) {
  const link = document.createElement("a");
  link.download = name;
  link.href = key ? (await send("/v1/tickets", { path })).href : path;
  document.body.append(link);
  link.click();
  link.remove();
}

// The picture at a path as an address that an <img> may show.
export async function picture(path) {
  return key ? URL.createObjectURL(await (await ask(path)).blob()) : path;
}
