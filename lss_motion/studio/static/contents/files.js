// @ts-check
/** The files of the folder: open, new show, duplicate, new figure; and the tour from nothing. */

import { html, useEffect, useState } from "../vendor/preact.js";
import { Pick } from "../parts/pick.js";
import { FIGURES, fileName, jointsOfKind, jointsProblem, MODELS, robotText, showText } from "./figures.js";
import { Small } from "./fields.js";

/** @typedef {import("../state.js").State} State */
/** @typedef {import("../actions.js").Actions} Actions */
/** @typedef {{ state: State, actions: Actions }} Props */

const KINDS = /** @type {const} */ ([["sequences", "Shows"], ["gaits", "Gaits"], ["robots", "Robots"], ["stages", "Stages"]]);

/** Open a file of the folder, once nothing is unsaved. @param {Actions} actions @param {string} file */
export function openFile(actions, file) {
  const run = () => actions.withLease(() => {
    void actions.link.ask("load", { path: file });
    actions.set({ dialog: null, selection: null });
  });
  const unsaved = actions.store.state.value.document?.editing.unsaved ?? [];
  if (unsaved.length === 0) run();
  else actions.set({ dialog: { kind: "confirm", title: "Open another file?", yes: "Open", run, text: `${unsaved.join(", ")} is not saved. Its edits stay beside it, and are there again when you come back.` } });
}

/** @param {Props} props */
export function Files({ state, actions }) {
  const { folder, welcome, document: own } = state;
  useEffect(() => void actions.contents.refresh(), []);
  if (welcome?.role === "view") return html`<p class="muted">Opening a file needs the role operate.</p>`;
  if (folder === null) return html`<p class="muted">Looking…</p>`;
  const mayEdit = welcome?.role === "edit";
  return html`${mayEdit ? html`<div class="choices"><button type="button" onClick=${() => actions.set({ touring: true, dialog: null, page: "timeline" })}>Guide me from nothing to a talking head</button></div>` : null}
    ${KINDS.map(([kind, words]) => folder[kind].length === 0 ? null : html`<h3>${words}</h3><ul class="files">${folder[kind].map((name) => html`<li key=${name}>
      <button type="button" class="plain" aria-current=${name === own?.file ? "true" : undefined} onClick=${() => openFile(actions, name)}>${name}</button></li>`)}</ul>`)}
    ${mayEdit ? html`<${NewShow} state=${state} actions=${actions} /><${Duplicate} state=${state} actions=${actions} /><${NewFigure} actions=${actions} />` : null}`;
}

/** Do what may be refused, and say so. @param {Actions} actions @param {() => Promise<unknown>} run */
async function refusing(actions, run) {
  try {
    await run();
  } catch (error) {
    actions.store.dispatch({ type: "refused", text: error instanceof Error ? error.message : String(error) });
  }
}

/** @param {{ label: string, value: string, set: (value: string) => void }} props */
function NameField({ label, value, set }) {
  return html`<label class="field"><span>${label}</span><input type="text" maxlength="60" aria-label=${label} value=${value} autocomplete="off" spellcheck=${false}
    onInput=${(/** @type {Event} */ event) => set(/** @type {HTMLInputElement} */ (event.currentTarget).value)} /></label>`;
}

/** @param {Props} props */
function NewShow({ state, actions }) {
  const [name, setName] = useState("");
  const robots = state.folder?.robots ?? [];
  const [wanted, setRobot] = useState("");
  const robot = robots.includes(wanted) ? wanted : robots[0];
  if (robot === undefined) return html`<h3>New show</h3><p class="muted">Make a figure first: a show is for a robot.</p>`;
  const make = () => refusing(actions, async () => {
    const response = await fetch(`/joints/${robot.split("/").map(encodeURIComponent).join("/")}`);
    const joints = await response.json();
    if (!response.ok) throw new Error(joints.error);
    await actions.contents.makeFile(fileName(name), showText(name.trim(), robot, joints));
    openFile(actions, fileName(name));
    actions.set({ page: "timeline" });
  });
  return html`<h3>New show</h3><div class="adds"><${NameField} label="name of the show" value=${name} set=${setName} />
    <${Pick} label="robot of the show" options=${robots} chosen=${robot} choose=${setRobot} />
    <${Small} name="Make the show" isOff=${name.trim() === ""} run=${make} /></div>`;
}

/** @param {Props} props */
function Duplicate({ state, actions }) {
  const [name, setName] = useState("");
  const own = state.document;
  if (own === null || own.file === "" || own.kind === "stage") return null;
  const make = () => refusing(actions, async () => {
    const response = await fetch(`/text/${encodeURIComponent(own.file)}`);
    const text = await response.text();
    if (!response.ok) throw new Error(text);
    await actions.contents.makeFile(fileName(name), text);
    openFile(actions, fileName(name));
  });
  return html`<h3>Duplicate ${own.file}</h3><div class="adds"><${NameField} label="name of the copy" value=${name} set=${setName} />
    <${Small} name="Make the copy" isOff=${name.trim() === ""} run=${make} /></div>`;
}

/** @param {{ actions: Actions }} props */
function NewFigure({ actions }) {
  const [kind, setKind] = useState("head");
  const [name, setName] = useState("");
  const [joints, setJoints] = useState(() => jointsOfKind("head"));
  /** @param {number} index @param {Partial<import("./figures.js").NewJoint>} change */
  const set = (index, change) => setJoints(joints.map((own, at) => (at === index ? { ...own, ...change } : own)));
  const problem = jointsProblem(joints);
  const file = fileName(name);
  const make = () => refusing(actions, async () => {
    await actions.contents.makeFile(file, robotText(name.trim(), kind, joints));
    openFile(actions, file);
  });
  return html`<h3>New figure</h3>
    <div class="adds"><${NameField} label="name of the figure" value=${name} set=${setName} />
      <div role="group" aria-label="kind of figure" class="choice">${Object.entries(FIGURES).map(([own, { words }]) => html`<button type="button" key=${own} aria-pressed=${own === kind}
        onClick=${() => { setKind(own); setJoints(jointsOfKind(own)); }}>${words}</button>`)}</div></div>
    <table class="small new-joints"><thead><tr><th>joint</th><th>servo id</th><th>model</th><th>from °</th><th>to °</th><th></th></tr></thead><tbody>
      ${joints.map((own, index) => html`<tr key=${index}>
        <td><input type="text" aria-label=${`name of joint ${index + 1}`} value=${own.name} onChange=${(/** @type {Event} */ event) => set(index, { name: textOf(event) })} /></td>
        <td><input type="number" min="0" max="250" aria-label=${`servo id of ${own.name}`} value=${own.id} onChange=${(/** @type {Event} */ event) => set(index, { id: Math.round(Number(textOf(event))) })} /></td>
        <td><${Pick} label=${`model of ${own.name}`} options=${MODELS} chosen=${own.model} choose=${(/** @type {string} */ model) => set(index, { model })} /></td>
        ${[0, 1].map((end) => html`<td key=${end}><input type="number" step="any" aria-label=${`${end === 0 ? "least" : "largest"} angle of ${own.name}`} value=${own.range_deg[end]}
          onChange=${(/** @type {Event} */ event) => set(index, { range_deg: end === 0 ? [Number(textOf(event)), own.range_deg[1]] : [own.range_deg[0], Number(textOf(event))] })} /></td>`)}
        <td><${Small} name=${`Remove joint ${own.name}`} text="✕" run=${() => setJoints(joints.filter((_, at) => at !== index))} /></td></tr>`)}</tbody></table>
    <div class="adds"><${Small} name="Add joint" text="+ joint" run=${() => setJoints([...joints, { name: `joint_${joints.length + 1}`, id: Math.max(0, ...joints.map((own) => own.id)) + 1, model: MODELS[0], range_deg: [-90, 90], speed_deg_s: 180, accel_deg_s2: 600 }])} />
      <${Small} name="Make the figure" isOff=${name.trim() === "" || problem !== ""} run=${make} />
      ${problem === "" ? html`<span class="muted">${name.trim() === "" ? "Give it a name. It is" : `${file}:`} simulated, or on the port of --port. Its Robot page finds servos, and takes ranges by hand.</span>` : html`<span class="bad-text">${problem}</span>`}</div>`;
}

/** @param {Event} event */
function textOf(event) {
  return /** @type {HTMLInputElement} */ (event.currentTarget).value.trim();
}

// -------------------------------------------------------------------------- the tour

/** The way from an empty folder to a head that talks: what to do, and how it is seen to be done.
 * @type {{ text: string, isDone: (state: State) => boolean }[]} */
export const TOUR = [
  { text: "Files: make a figure. “A talking head” has a jaw, a nod and a turn; give it a name.", isDone: ({ folder }) => (folder?.robots.length ?? 0) > 0 },
  { text: "Files: make a show for it, and give it a name.", isDone: (state) => sequenceOf(state) !== null },
  { text: "Drop a song or a voice on this page.", isDone: ({ folder }) => (folder?.sounds.length ?? 0) > 0 },
  { text: "Contents, Sounds: “of the show”. Let the show last as long.", isDone: (state) => sequenceOf(state)?.sound !== undefined },
  { text: "“A joint follows”: the jaw. Move its sliders until it speaks.", isDone: (state) => (sequenceOf(state)?.layers?.length ?? 0) > 0 },
  { text: "Drag the cursor in the ruler, then move a slider under Chosen, such as turn: that is a key.", isDone: (state) => (sequenceOf(state)?.keyframes?.length ?? 0) > 2 },
  { text: "Save (Ctrl-S), and play it: Space.", isDone: (state) => state.started !== null },
];

/** @param {State} state @returns {any} */
function sequenceOf({ document: own, model }) {
  const value = own === null ? undefined : model?.files[own.file]?.value;
  return value !== undefined && "sequence" in value ? value : null;
}

/** @param {Props} props */
export function Tour({ state, actions }) {
  if (!state.touring) return null;
  const next = TOUR.findIndex((step) => !step.isDone(state));
  const text = next < 0 ? "That was all: a head that talks, made by hand. The guide, “In a browser”, has the rest." : TOUR[next]?.text;
  return html`<p class="banner banner-note tour" role="status" data-step=${next < 0 ? TOUR.length : next}><strong>${next < 0 ? "Done" : `${next + 1} of ${TOUR.length}`}</strong> ${text}
    ${next >= 0 && next < 2 ? html`<button type="button" onClick=${() => actions.set({ dialog: { kind: "files" } })}>Files</button>` : null}
    <button type="button" onClick=${() => actions.set({ touring: false })}>${next < 0 ? "Close" : "Leave the tour"}</button></p>`;
}
