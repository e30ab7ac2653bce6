// @ts-check
/** Lines of the files of a show: named, and shown as text. */

import { html, useEffect, useRef, useState } from "../vendor/preact.js";

/** A file and line that lead to its text. @param {{ actions: import("../actions.js").Actions, file: string, line: number | null }} props */
export function FileLine({ actions, file, line }) {
  const place = line === null ? file : `${file}:${line}`;
  return html`<button type="button" class="plain file-line" onClick=${() => actions.set({ dialog: { kind: "text", file, line } })}>${place}</button>`;
}

/** What was typed and is not given to the server yet, by file: closing the text loses nothing. @type {Map<string, string>} */
const typed = new Map();

/** The text of a file, at a line: to read, and to change. @param {{ state: import("../state.js").State, actions: import("../actions.js").Actions, file: string, line: number | null }} props */
export function FileText({ state, actions, file, line }) {
  const [text, setText] = useState(/** @type {string | null} */ (null));
  const [problem, setProblem] = useState("");
  const [isEdited, setEdited] = useState(typed.has(file));
  const marked = useRef(/** @type {HTMLElement | null} */ (null));
  const revision = state.document?.revision ?? 0;
  useEffect(() => {
    fetch(`/text/${file.split("/").map(encodeURIComponent).join("/")}`).then(async (response) => {
      if (response.ok) setText(await response.text());
      else setProblem((await response.json()).error);
    }, () => setProblem("the server cannot be reached"));
  }, [file, revision]);
  useEffect(() => marked.current?.scrollIntoView({ block: "center" }), [text === null]);
  if (problem !== "" && text === null) return html`<p class="bad-text">${problem}</p>`;
  if (text === null) return html`<p class="muted">Loading…</p>`;
  if (isEdited) {
    return html`<${EditedText} ...${{ state, actions, file, line, text, revision }} done=${() => {
      typed.delete(file);
      setEdited(false);
    }} />`;
  }
  return html`${state.welcome?.role === "edit" ? html`<div class="choices"><button type="button" onClick=${() => setEdited(true)}>Change the text</button></div>` : null}
    <ol class="file-text" tabindex="0">${text.split("\n").map((own, index) => html`<li key=${index}
    ref=${index + 1 === line ? marked : undefined} aria-current=${index + 1 === line ? "true" : undefined}>${own || " "}</li>`)}</ol>`;
}

/** @param {{ state: import("../state.js").State, actions: import("../actions.js").Actions, file: string, line: number | null, text: string, revision: number, done: () => void }} props */
function EditedText({ state, actions, file, line, text, revision, done }) {
  const [problem, setProblem] = useState("");
  const place = useRef(/** @type {HTMLTextAreaElement | null} */ (null));
  useEffect(() => {
    const own = place.current;
    if (own === null || line === null) return;
    const start = text.split("\n").slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
    own.focus();
    own.setSelectionRange(start, start);
    own.scrollTop = (own.scrollHeight * (line - 4)) / Math.max(text.split("\n").length, 1);
  }, []);
  const take = () => {
    const change = changedLines(text, place.current?.value ?? text);
    if (change === null) return done();
    actions.link.send("text.set", { revision, file, ...change }).then(done, (error) => setProblem(error.message));
    return undefined;
  };
  const errors = state.document?.errors.filter((one) => one.path === file) ?? [];
  return html`<textarea class="file-text" ref=${place} spellcheck=${false} aria-label=${`text of ${file}`}
      onInput=${(/** @type {Event} */ event) => typed.set(file, /** @type {HTMLTextAreaElement} */ (event.currentTarget).value)}>${typed.get(file) ?? text}</textarea>
    ${problem === "" ? null : html`<p class="bad-text" role="alert">${problem}</p>`}
    ${errors.map((one) => html`<p class="bad-text">line ${one.line}: ${one.text}</p>`)}
    <div class="choices"><button type="button" class="primary" onClick=${take}>Take it</button>
      <button type="button" onClick=${done}>Leave the text as it was</button></div>`;
}

/**
 * Return the lines that are others: those from one line to before another one become `lines`; null
 * where nothing is. @param {string} before @param {string} after
 * @returns {{ from_line: number, to_line: number, lines: string[] } | null}
 */
export function changedLines(before, after) {
  if (before === after) return null;
  const [old, own] = [before.split("\n"), after.split("\n")];
  let first = 0;
  while (first < Math.min(old.length, own.length) && old[first] === own[first]) first += 1;
  let same = 0;
  const most = Math.min(old.length, own.length) - first;
  while (same < most && old[old.length - 1 - same] === own[own.length - 1 - same]) same += 1;
  return { from_line: first + 1, to_line: old.length - same + 1, lines: own.slice(first, own.length - same) };
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
  if (own.kind === "folder") return "Nothing is open. Files, at the top left, opens a show of this folder, makes a new one, or a new figure.";
  if (own.kind === "robot") return "This is a robot file, which has no show. Open a sequence, a gait or a play list; the Robot page moves this robot.";
  if (own.kind === "stage") return `This is a stage: many shows on cues. It is run by: lss-motion serve ${own.file}. To look at one of its shows, open its file.`;
  if (own.errors.length > 0) return "There is no plan: the file has an error, which stands above.";
  return "There is no plan yet.";
}
