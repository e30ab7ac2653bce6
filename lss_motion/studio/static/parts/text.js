// @ts-check
/** Lines of the files of a show: named, and shown as text. */

import { html, useEffect, useRef, useState } from "../vendor/preact.js";

/** A file and line that lead to its text. @param {{ actions: import("../actions.js").Actions, file: string, line: number | null }} props */
export function FileLine({ actions, file, line }) {
  const place = line === null ? file : `${file}:${line}`;
  return html`<button type="button" class="plain file-line" onClick=${() => actions.set({ dialog: { kind: "text", file, line } })}>${place}</button>`;
}

/** The text of a file, at a line. @param {{ file: string, line: number | null }} props */
export function FileText({ file, line }) {
  const [text, setText] = useState("");
  const [problem, setProblem] = useState("");
  const marked = useRef(/** @type {HTMLElement | null} */ (null));
  useEffect(() => {
    fetch(`/text/${file.split("/").map(encodeURIComponent).join("/")}`).then(async (response) => {
      if (response.ok) setText(await response.text());
      else setProblem((await response.json()).error);
    }, () => setProblem("the server cannot be reached"));
  }, [file]);
  useEffect(() => marked.current?.scrollIntoView({ block: "center" }), [text]);
  if (problem !== "") return html`<p class="bad-text">${problem}</p>`;
  return html`<ol class="file-text" tabindex="0">${text.split("\n").map((own, index) => html`<li key=${index}
    ref=${index + 1 === line ? marked : undefined} aria-current=${index + 1 === line ? "true" : undefined}>${own || " "}</li>`)}</ol>`;
}

/** A plan of an ordinary show takes less: longer is worth a word. */
const PATIENCE_S = 4;

/** That the planner has not answered for long; "" as long as that is normal. @param {number} planning_s */
export function silenceOf(planning_s) {
  return planning_s < PATIENCE_S ? "" : `the planner has not answered for ${Math.floor(planning_s)} s`;
}

/** Why there is nothing to show, and what to do. @param {import("../state.js").State} state */
export function whyNoPlan({ document: own }) {
  if (own === null || own.is_planning) {
    const silence = silenceOf(own?.planning_s ?? 0);
    return `The file is being planned…${silence === "" ? "" : ` ${silence[0]?.toUpperCase()}${silence.slice(1)}.`}`;
  }
  if (own.kind === "robot") return "This is a robot file, which has no show. Open a sequence, a gait or a play list; the Robot page moves this robot.";
  if (own.kind === "stage") return `This is a stage: many shows on cues. It is run by: lss-motion serve ${own.file}. To look at one of its shows, open its file.`;
  if (own.errors.length > 0) return "There is no plan: the file has an error, which stands above.";
  return "There is no plan yet.";
}
