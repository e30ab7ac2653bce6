// @ts-check
/** What a show consists of besides its keys: sound, events, loop, tracks, layers, play list; by hand. */

import { html, useState } from "../vendor/preact.js";
import { NumberField, TextField } from "../pages/about.js";
import { Choice } from "../parts/choice.js";
import { Pick } from "../parts/pick.js";
import { Section, Slider, Small } from "./fields.js";
import { addOf, isSoloed, moveOf, removeOf, setOf, soloOf } from "./editor.js";
import { GaitContents } from "./gait.js";
import { Sounds } from "./sound.js";
import { freeJoints, newTrack, startAngles } from "./tracks.js";

/** @typedef {import("../state.js").State} State */
/** @typedef {import("../actions.js").Actions} Actions */
/** @typedef {{ state: State, actions: Actions, file: string, value: any }} Part of a file, with what it holds */
/** @typedef {import("./editor.js").Place} Place */

export const COLOURS = /** @type {const} */ (["red", "green", "blue", "yellow", "cyan", "magenta", "white", "off"]);
const MODES = /** @type {const} */ ([["override", "in place"], ["add", "added"]]);
/** A layer that is new begins and ends without a jump, wherever the show is then. */
const FADE_S = 0.3;
const JOINS = /** @type {const} */ ([["rest", "after a rest"], ["through", "without a stop"]]);

/** @param {{ state: State, actions: Actions }} props */
export function Contents({ state, actions }) {
  const { document: own, model, welcome } = state;
  if (welcome?.role !== "edit") return html`<p class="muted">You may look here. Changing the show needs the role edit.</p>`;
  const value = own === null ? undefined : model?.files[own.file]?.value;
  if (own === null || value === undefined) return html`<p class="muted">${own?.is_planning ? "The file is being read…" : "The file cannot be read: mend its text first."}</p>`;
  if ("gait" in value) return html`<${GaitContents} ...${{ state, actions, file: own.file, value }} />`;
  if (!("sequence" in value)) return html`<p class="muted">Only a sequence has events, tracks, layers and a play list.</p>`;
  const part = { state, actions, file: own.file, value };
  return html`<${Sounds} ...${part} /><${Events} ...${part} /><${Looped} ...${part} />
    ${value.play === undefined ? html`<${Tracks} ...${part} />` : html`<${PlayList} ...${part} />`}
    <${Layers} ...${part} />`;
}

// ------------------------------------------------------------------------ events

/** @param {Part} props */
function Events({ state, actions, file, value }) {
  const { contents } = actions;
  const all = /** @type {any[]} */ (value.events ?? []);
  /** @param {Record<string, unknown>} event */
  const add = (event) => contents.addEvent(state.cursor_s, event);
  const joint = state.view?.joints[0]?.name ?? "";
  return html`<${Section} title="Events" count=${all.length}>
    <ul class="items">${all.map((own, index) => html`<li key=${`${index} ${JSON.stringify(own)}`}>
      <${Event} ...${{ state, actions, file, own, index }} />
      <${Small} name=${`Remove event ${index + 1}`} text="✕" run=${() => contents.change(() => [removeOf(file, "events", index)])} /></li>`)}</ul>
    <div class="adds"><span class="muted">at the cursor</span>
      <${Small} name="Add say" text="+ text" run=${() => add({ say: "text" })} />
      ${joint === "" ? null : html`<${Small} name="Add LED" text="+ LED" run=${() => add({ led: { [joint]: "red" } })} />`}</div>
    </${Section}>`;
}

/** @param {{ state: State, actions: Actions, file: string, own: any, index: number }} props */
function Event({ state, actions, file, own, index }) {
  const { contents } = actions;
  /** @param {(string | number)[]} keys @param {unknown} value */
  const set = (keys, value) => contents.set(file, ["events", index, ...keys], value);
  return html`<div class="fields">
    <${NumberField} name="at" unit="s" value=${own.at_s} digits=${3} least=${0} set=${(/** @type {number} */ at_s) => set(["at_s"], at_s)} />
    ${own.say === undefined ? null : html`<${TextField} name="text" value=${own.say} set=${(/** @type {string} */ text) => set(["say"], text === "" ? "text" : text)} />`}
    ${own.run === undefined ? null : html`<span class="muted">calls ${own.run}</span>`}
    ${own.sound === undefined ? null : html`<span class="name" title=${own.sound}>${own.sound}</span>
      <${NumberField} name="gain" unit="dB" value=${own.gain_db ?? 0} digits=${1} least=${-60} most=${20} set=${(/** @type {number} */ db) => set(["gain_db"], db === 0 ? null : db)} />`}
    ${Object.entries(own.led ?? {}).map(([joint, colour]) => html`<span class="led" key=${joint}>
      <${Pick} label="joint" options=${(state.view?.joints ?? []).map(({ name }) => name)} chosen=${joint}
        choose=${(/** @type {string} */ to) => to !== joint && set(["led"], renamed(own.led, joint, to))} />
      <span class="swatches" role="radiogroup" aria-label=${`colour of ${joint}`}>${COLOURS.map((name) => html`<button type="button" role="radio" key=${name} class=${`colour colour-${name}`}
        aria-checked=${name === colour} aria-label=${name} title=${name} onClick=${() => set(["led", joint], name)}></button>`)}</span></span>`)}
  </div>`;
}

/** The same mapping with another key in the same place. @param {Record<string, unknown>} value @param {string} before @param {string} after */
function renamed(value, before, after) {
  return Object.fromEntries(Object.entries(value).map(([key, own]) => [key === before ? after : key, own]));
}

// ------------------------------------------------------------------------- loops

/** How often, of the show or a track: once, a count, or forever.
 * @param {{ actions: Actions, file: string, place: Place, loop: number | "forever" | undefined, label: string }} props */
function LoopChoice({ actions, file, place, loop, label }) {
  const { contents } = actions;
  const kind = loop === "forever" ? "forever" : (loop ?? 1) > 1 ? "times" : "once";
  /** @param {string} wanted */
  const choose = (wanted) => contents.set(file, place, wanted === "once" ? (loop === undefined ? 1 : null) : wanted === "times" ? 2 : "forever");
  return html`<div class="choices"><${Choice} label=${label} options=${[["once", "once"], ["times", "times"], ["forever", "forever"]]} chosen=${kind}
      choose=${(/** @type {string} */ wanted) => wanted === kind ? undefined : choose(wanted)} />
    ${kind === "times" ? html`<${NumberField} name="loop" unit="×" value=${Number(loop)} digits=${0} least=${1} set=${(/** @type {number} */ count) => contents.set(file, place, Math.round(count))} isBare />` : null}</div>`;
}

/** @param {Part} props */
function Looped({ state, actions, file, value }) {
  const { contents } = actions;
  if (value.keyframes === undefined && value.play === undefined) return null;
  const span = /** @type {[number, number] | undefined} */ (value.loop_span_s);
  const maySpan = value.keyframes !== undefined && ["tracks", "events", "sound"].every((key) => value[key] === undefined);
  const cursor_s = Number(state.cursor_s.toFixed(3));
  return html`<${Section} title="Loop">
    <${LoopChoice} ...${{ actions, file, place: ["loop"], loop: value.loop, label: "how often it is played" }} />
    ${span === undefined ? null : html`<div class="fields">
      <${NumberField} name="from" unit="s" value=${span[0]} digits=${3} least=${0} set=${(/** @type {number} */ from_s) => contents.set(file, ["loop_span_s"], [from_s, span[1]])} />
      <${NumberField} name="to" unit="s" value=${span[1]} digits=${3} least=${0} set=${(/** @type {number} */ to_s) => contents.set(file, ["loop_span_s"], [span[0], to_s])} />
      <${Small} name="Loop the whole" run=${() => contents.set(file, ["loop_span_s"], null)} /></div>`}
    ${span === undefined && maySpan ? html`<div class="adds"><${Small} name="Loop from the start to the cursor only" run=${() => contents.set(file, ["loop_span_s"], [0, cursor_s])} isOff=${cursor_s <= 0} /></div>` : null}
  </${Section}>`;
}

// ------------------------------------------------------------------------ tracks

/** @param {Part} props */
function Tracks({ state, actions, file, value }) {
  const { contents } = actions;
  const all = Object.entries(/** @type {Record<string, any>} */ (value.tracks ?? {}));
  return html`<${Section} title="Tracks" count=${all.length}>
    <ul class="items">${all.map(([name, own]) => html`<li key=${name}>
      <div class="item-head"><${TextField} name="track" value=${name} isBare set=${(/** @type {string} */ to) => to !== "" && contents.change(() => [{ op: "value.rename", fields: { file, place: ["tracks", name], name: to } }])} />
        <${MuteSolo} ...${{ actions, file, value, place: ["tracks", name], name, isMuted: own.mute === true }} />
        <${Small} name=${`Remove track ${name}`} text="✕" run=${() => actions.set({ dialog: {
          kind: "confirm", title: `Remove track ${name}?`, text: "Its keys go with it. Undo brings them back.", yes: "Remove",
          run: () => void contents.set(file, all.length === 1 ? ["tracks"] : ["tracks", name], null),
        } })} /></div>
      <p class="muted">${jointsOf(own).join(", ")}</p>
      <${LoopChoice} ...${{ actions, file, place: ["tracks", name, "loop"], loop: own.loop, label: `how often track ${name} is played` }} />
    </li>`)}</ul>
    <${AddTrack} ...${{ state, actions, file, value }} /></${Section}>`;
}

/** @param {any} track */
function jointsOf(track) {
  return [...new Set((track.keyframes ?? []).flatMap((/** @type {any} */ key) => [...Object.keys(key.deg ?? {}), ...(key.pose === undefined ? [] : [`pose ${key.pose}`])]))];
}

/** Joints that have no keys yet get a track of their own. @param {Part} props */
function AddTrack({ state, actions, file, value }) {
  const [wanted, setWanted] = useState(/** @type {string[]} */ ([]));
  const free = freeJoints(value, /** @type {any} */ (state.robot));
  if (free.length === 0) return html`<p class="muted">Each joint has keys already; a joint is keyed in one track.</p>`;
  const joints = wanted.filter((name) => free.includes(name));
  const add = () => {
    const { name, track } = newTrack(value, joints, startAngles(/** @type {any} */ (state.robot), joints));
    setWanted([]);
    return actions.contents.set(file, ["tracks", name], track);
  };
  return html`<div class="adds"><${Joints} label="joints of a new track" all=${free} chosen=${joints} choose=${setWanted} />
    <${Small} name="Add track" text="+ track" run=${add} isOff=${joints.length === 0} /></div>`;
}

/** Which joints, as boxes. @param {{ label: string, all: string[], chosen: string[], choose: (joints: string[]) => void }} props */
function Joints({ label, all, chosen: on, choose }) {
  return html`<span class="joint-boxes" role="group" aria-label=${label}>${all.map((name) => html`<label class="field-check" key=${name}>
    <input type="checkbox" checked=${on.includes(name)} onChange=${() => choose(all.filter((one) => (one === name) !== on.includes(one)))} />${name}</label>`)}</span>`;
}

/** @param {{ actions: Actions, file: string, value: any, place: Place, name: string, isMuted: boolean }} props */
function MuteSolo({ actions, file, value, place, name, isMuted }) {
  const { contents } = actions;
  return html`<${Small} name=${`Mute ${name}`} text="M" isOn=${isMuted} run=${() => contents.set(file, [...place, "mute"], isMuted ? null : true)} />
    <${Small} name=${`Solo ${name}`} text="S" isOn=${isSoloed(value, place)} run=${() => contents.change((model) => soloOf(model.files[file]?.value, file, place))} />`;
}

// ------------------------------------------------------------------------ layers

/** @param {Part} props */
function Layers({ state, actions, file, value }) {
  const { contents } = actions;
  const all = /** @type {any[]} */ (value.layers ?? []);
  const files = (state.folder?.sequences ?? []).filter((name) => name !== file);
  return html`<${Section} title="Layers" count=${all.length}>
    <ul class="items">${all.map((own, index) => html`<li key=${`${index} ${own.file}`}><${Layer} ...${{ state, actions, file, value, own, index, count: all.length }} /></li>`).reverse()}</ul>
    <${AddFile} ...${{ label: "a sequence on top", files, text: "+ layer", add: (/** @type {string} */ name) => contents.change((model) => [addOf(model.files[file]?.value, file, "layers", { file: name, fade_s: FADE_S })]) }} />
  </${Section}>`;
}

/** @param {Part & { own: any, index: number, count: number }} props */
function Layer({ state, actions, file, value, own, index, count }) {
  const { contents } = actions;
  /** @param {string} key @param {unknown} to */
  const set = (key, to) => contents.set(file, ["layers", index, key], to);
  /** @param {number} to */
  const move = (to) => contents.change(() => [moveOf(file, "layers", index, to)]);
  const joints = state.view?.joints.map(({ name }) => name) ?? [];
  const mask = own.joints ?? joints;
  return html`<div class="item-head"><span class="name" title=${own.file}>${own.file}</span>
      <${MuteSolo} ...${{ actions, file, value, place: ["layers", index], name: own.file, isMuted: own.mute === true }} />
      <${Small} name=${`${own.file} further up`} text="↑" isOff=${index === count - 1} run=${() => move(index + 1)} />
      <${Small} name=${`${own.file} further down`} text="↓" isOff=${index === 0} run=${() => move(index - 1)} />
      <${Small} name=${`Remove layer ${own.file}`} text="✕" run=${() => contents.change(() => [removeOf(file, "layers", index)])} /></div>
    <div class="choices"><${Choice} label=${`how ${own.file} is laid on`} options=${MODES} chosen=${own.mode ?? "override"} choose=${(/** @type {string} */ mode) => set("mode", mode === "override" ? null : mode)} /></div>
    <${Slider} name="weight" unit="" value=${own.weight ?? 1} least=${0} most=${1} step=${0.05} set=${(/** @type {number} */ weight) => set("weight", weight === 1 ? null : weight)} />
    <div class="fields">
      <${NumberField} name="from" unit="s" value=${own.from_s ?? 0} digits=${3} least=${0} set=${(/** @type {number} */ from_s) => set("from_s", from_s === 0 ? null : from_s)} />
      <${NumberField} name="fade" unit="s" value=${own.fade_s ?? 0} digits=${3} least=${0} set=${(/** @type {number} */ fade_s) => set("fade_s", fade_s === 0 ? null : fade_s)} /></div>
    <details class="mask"><summary>joints: ${own.joints === undefined ? "all that it keys" : own.joints.join(", ")}</summary>
      <${Joints} label=${`joints of ${own.file}`} all=${joints} chosen=${mask}
        choose=${(/** @type {string[]} */ wanted) => set("joints", wanted.length === 0 || wanted.length === joints.length ? null : wanted)} /></details>`;
}

/** Choose a file of the folder to add. @param {{ label: string, files: string[], text: string, add: (file: string) => void }} props */
export function AddFile({ label, files, text, add }) {
  const [wanted, setWanted] = useState("");
  const own = files.includes(wanted) ? wanted : files[0] ?? "";
  if (own === "") return html`<p class="muted">This folder has no other file for ${label}.</p>`;
  return html`<div class="adds"><${Pick} label=${label} options=${files} chosen=${own} choose=${setWanted} />
    <${Small} name=${`Add ${label}`} text=${text} run=${() => add(own)} /></div>`;
}

// --------------------------------------------------------------------- play list

/** @param {Part} props */
function PlayList({ state, actions, file, value }) {
  const { contents } = actions;
  const [dragged, setDragged] = useState(/** @type {{ from: number, to: number } | null} */ (null));
  const all = /** @type {any[]} */ (value.play ?? []);
  const files = (state.folder?.sequences ?? []).filter((name) => name !== file);
  /** @param {number} index @param {number} to */
  const move = (index, to) => index === to ? undefined : contents.change(() => [moveOf(file, "play", index, to)]);
  return html`<${Section} title="Play list" count=${all.length}>
    <ol class="items">${all.map((own, index) => html`<li key=${`${index} ${JSON.stringify(own)}`} class=${dragged?.from === index ? "dragged" : dragged?.to === index ? "drop-here" : ""}>
      <div class="item-head"><span class="grip" title="drag it to its place" onPointerDown=${(/** @type {PointerEvent} */ event) => {
          /** @type {HTMLElement} */ (event.currentTarget).setPointerCapture(event.pointerId);
          setDragged({ from: index, to: index });
        }} onPointerMove=${(/** @type {PointerEvent} */ event) => {
          if (dragged !== null) setDragged({ ...dragged, to: itemAt(event) ?? dragged.to });
        }} onPointerUp=${() => {
          if (dragged !== null) void move(dragged.from, dragged.to);
          setDragged(null);
        }} onPointerCancel=${() => setDragged(null)}>⠿</span><span class="name" title=${stepText(own)}>${stepText(own)}</span>
        <${Small} name=${`Step ${index + 1} earlier`} text="↑" isOff=${index === 0} run=${() => move(index, index - 1)} />
        <${Small} name=${`Step ${index + 1} later`} text="↓" isOff=${index === all.length - 1} run=${() => move(index, index + 1)} />
        <${Small} name=${`Remove step ${index + 1}`} text="✕" isOff=${all.length === 1} run=${() => contents.change(() => [removeOf(file, "play", index)])} /></div>
      <${Step} ...${{ actions, file, own, index }} /></li>`)}</ol>
    <${AddFile} ...${{ label: "a sequence to play", files, text: "+ play", add: (/** @type {string} */ name) => contents.change((model) => [addOf(model.files[file]?.value, file, "play", { file: name })]) }} />
    <div class="adds"><${Small} name="Add pause" text="+ pause" run=${() => contents.change((model) => [addOf(model.files[file]?.value, file, "play", { pause_s: 1 })])} /></div>
  </${Section}>`;
}

/** The place in its list that the pointer is at. @param {PointerEvent} event */
function itemAt(event) {
  const list = /** @type {HTMLElement} */ (event.currentTarget).closest("ol");
  const found = [...(list?.children ?? [])].findIndex((one) => event.clientY < one.getBoundingClientRect().bottom);
  return found < 0 ? undefined : found;
}

/** @param {any} step */
function stepText(step) {
  if (step.file !== undefined) return step.file;
  return step.wait_for === undefined ? "pause" : `wait for ${step.wait_for.sensor}`;
}

/** @param {{ actions: Actions, file: string, own: any, index: number }} props */
function Step({ actions, file, own, index }) {
  const { contents } = actions;
  /** @param {string} key @param {unknown} to */
  const set = (key, to) => contents.change(() => [setOf(file, ["play", index, key], to)]);
  if (own.pause_s !== undefined) return html`<${NumberField} name="pause" unit="s" value=${own.pause_s} digits=${3} least=${0} set=${(/** @type {number} */ pause_s) => set("pause_s", pause_s)} />`;
  if (own.file === undefined) return null;
  return html`<div class="fields">
      <${NumberField} name="times" unit="×" value=${own.times ?? 1} digits=${0} least=${1} set=${(/** @type {number} */ times) => set("times", Math.round(times) === 1 ? null : Math.round(times))} />
      <${NumberField} name="speed" unit="×" value=${own.speed_ratio ?? 1} digits=${2} least=${0.1} set=${(/** @type {number} */ ratio) => set("speed_ratio", ratio === 1 ? null : ratio)} /></div>
    <div class="choices"><${Choice} label=${`how step ${index + 1} begins`} options=${JOINS} chosen=${own.join ?? "rest"} choose=${(/** @type {string} */ join) => set("join", join === "rest" ? null : join)} /></div>`;
}
