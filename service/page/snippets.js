// The same by curl, Python and pyvo: texts to copy, with this server's address.

import { hasKey } from "./api.js";
import { copier, el } from "./dom.js";

const here = () => location.origin;
const curlKey = () => (hasKey() ? " -H \"Authorization: Bearer $NIGHTGLASS_KEY\"" : "");
const pythonKey = () => (hasKey() ? ", key=os.environ[\"NIGHTGLASS_KEY\"]" : "");
const imports = () => (hasKey() ? "import os\n" : "");

function tabs(name, texts) {
  const shown = el("pre", { tabindex: "0" });
  let text = "";
  const buttons = Object.entries(texts).map(([title, make]) => el("button", { type: "button",
    class: "tab", onclick: (event) => choose(event.target, make) }, title));
  function choose(button, make) {
    text = make();
    shown.textContent = text;
    for (const other of buttons) other.setAttribute("aria-pressed", String(other === button));
  }
  choose(buttons[0], Object.values(texts)[0]);
  return el("div", { class: "card snippets" }, el("div", { class: "bar" }, el("h2", {}, name),
    buttons, el("span", { class: "spring" }), copier(() => text, "this")), shown);
}

export function submitSnippets() {
  return tabs("Elsewhere", {
    curl: () => `curl -i${curlKey()} \\\n  -H 'Content-Type: application/json' \\\n`
      + `  -H "Idempotency-Key: $(uuidgen)" \\\n  --data @scene.json ${here()}/v1/jobs`,
    Python: () => `${imports()}from service.client import Client\n\n`
      + `client = Client("${here()}"${pythonKey()})\njob = client.submit("scene.yaml")\n`
      + "job.wait()\ncube = job.open()          # xarray",
    shell: () => `nightglass render scene.yaml --server ${here()} -o product`,
    pyvo: () => "from pathlib import Path\nfrom pyvo.dal import AsyncTAPJob\n\n"
      + `job = AsyncTAPJob.create("${here()}/uws", Path("scene.json").read_text())\n`
      + "job.run().wait()\nfiles = job.fetch_result().to_table()",
  });
}

export function jobSnippets(job) {
  const at = `${here()}/v1/jobs/${job.id}`;
  return tabs("Elsewhere", {
    curl: () => `curl -OJ${curlKey()} ${at}/product.tar\n`
      + `curl -OJ${curlKey()} ${at}/frames/0/fits`,
    Python: () => `${imports()}from service.client import Client\n\n`
      + `job = Client("${here()}"${pythonKey()}).job("${job.id}")\n`
      + "cube = job.open()          # xarray, read over HTTP as needed\n"
      + "job.fetch(\"product\")       # all of it, verified",
    shell: () => `nightglass jobs fetch ${job.id} --server ${here()} -o product`,
    pyvo: () => "from pyvo.dal import AsyncTAPJob\n\n"
      + `job = AsyncTAPJob("${here()}/uws/async/${job.id}", delete=False)\n`
      + "print(job.phase, job.result_uris)",
  });
}
