// @ts-check
/** What is chosen on the timeline, in words and fields: a key, a span, or the whole plan. */

import { html, useEffect, useState } from "../vendor/preact.js";
import { angleAt, valueAt } from "../curves.js";
import { EASES } from "../edits.js";
import { number } from "../numbers.js";
import { Choice } from "../parts/choice.js";
import { FileLine } from "../parts/text.js";
import { lateOf, repairsOf, slackOf } from "../repairs.js";
import { wholeKeys } from "../timeline/keys.js";
import { handleOf } from "../timeline/slopes.js";
import { timeText } from "../timeline/window.js";
import { PoseSliders } from "./pose.js";

/** @typedef {import("../state.js").State} State */
/** @typedef {import("../state.js").View} View */
/** @typedef {import("../state.js").Key} Key */
/** @typedef {import("../actions.js").Actions} Actions */
/** @typedef {{ state: State, actions: Actions }} Props */

/** @param {Props} props */
export function About({ state, actions }) {
  const { view, selection } = state;
  if (view === null) return null;
  if (selection?.kind === "keys") {
    const whole = wholeKeys(selection.keys);
    const [first] = whole;
    const lane = first === undefined ? undefined : view.lanes[first.lane];
    const key = first === undefined ? undefined : lane?.keys[first.key];
    if (key === undefined || lane === undefined) return null;
    if (whole.length > 1) return html`<${AboutKeys} ...${{ state, view, actions, count: whole.length }} />`;
    return html`<${AboutKey} ...${{ state, view, own: key, lane, actions }} />`;
  }
  if (selection?.kind === "span") {
    const span = view[selection.list][selection.index];
    const title = selection.list === "stretched" ? "Slowed" : "Angle given up";
    return span === undefined ? null : html`<h2>${title}</h2><p>${span.text}</p>`;
  }
  return html`<${AboutPlan} state=${state} actions=${actions} />`;
}

/** @param {{ state: State, view: View, own: Key, lane: import("../state.js").Lane, actions: Actions }} props */
function AboutKey({ state, view, own, lane, actions }) {
  const { editor } = actions;
  const authored_s = own.authored_s;
  const late_s = authored_s === null ? 0 : own.at_s - authored_s;
  return html`<h2>${own.is_anchor ? "Anchor" : "Key"} ${own.label}</h2>
    <p>${lane.kind} ${lane.name}${own.line === null || !lane.file ? "" : html`, <${FileLine} actions=${actions} file=${lane.file} line=${own.line} />`}
      ${Math.abs(late_s) > 5e-4 ? html`, <strong class="warn-text">reached ${late_s.toFixed(3)} s later than authored</strong>` : null}</p>
    <table class="small"><thead><tr><th>joint</th><th>key</th><th>plan</th><th>deg/s</th></tr></thead><tbody>
      ${Object.entries(own.deg).map(([joint, deg]) => {
        const curve = view.curves[joint]?.plan;
        const limits = view.joints.find((one) => one.name === joint);
        if (curve === undefined || limits === undefined) return null;
        const [least, most] = lane.is_added ? [undefined, undefined] : limits.range_deg;
        return html`<tr key=${joint}><th scope="row">${joint}</th>
          <td><${NumberField} name=${joint} unit="°" value=${deg} digits=${4} ...${{ least, most }} isBare set=${(/** @type {number} */ to_deg) => editor.set({ deg: { [joint]: to_deg } })} /></td>
          <td class="number">${number(angleAt(curve, own.at_s), 2)}</td><td class="number"><${Slope} ...${{ view, actions, joint, own: refOf(state) }} /></td></tr>`;
      })}</tbody></table>
    <div class="fields">
      ${authored_s === null ? null : html`<${NumberField} name="at" unit="s" value=${authored_s} digits=${3} least=${0}
        set=${(/** @type {number} */ at_s) => editor.move({ by_s: at_s - authored_s, by_deg: 0 })} />`}
      <${NumberField} name="hold" unit="s" value=${own.hold_s} digits=${3} least=${0} set=${(/** @type {number} */ hold_s) => editor.set({ values: { hold_s: hold_s === 0 ? null : hold_s } })} />
      <${TextField} name="label" value=${own.label} set=${(/** @type {string} */ label) => editor.set({ values: { label: label === "" ? null : label } })} />
      <label class="field-check"><input type="checkbox" checked=${own.is_anchor} data-field="anchor"
        onChange=${() => editor.anchor()} /> anchor: its time must be met</label>
    </div>
    <div class="choices">ease <${Choice} label="ease" options=${EASES.map((ease) => [ease, ease])} chosen=${own.ease}
      choose=${(/** @type {string} */ ease) => editor.set({ values: { ease } })} /></div>
    <${Spare} view=${view} own=${refOf(state)} />
    <${Repairs} ...${{ state, view, actions, own: refOf(state) }} />
    <${Limits} state=${state} view=${view} joints=${Object.keys(own.deg)} />`;
}

/** With which speed a joint passes the key: as it was given, else as it is planned.
 * @param {{ view: View, actions: Actions, joint: string, own: import("../state.js").KeyRef }} props */
function Slope({ view, actions, joint, own }) {
  const handle = handleOf(view, { ...own, joint });
  const key = view.lanes[own.lane]?.keys[own.key];
  const curve = view.curves[joint]?.plan;
  if (handle === null) return curve === undefined || key === undefined ? null : number(valueAt(curve, key.at_s, 1), 1);
  return html`<span class=${handle.isGiven ? "" : "muted"}><${NumberField} name=${`${joint} slope`} unit="" value=${handle.slope} digits=${1} isBare
    set=${(/** @type {number} */ slope) => actions.editor.setSlope(handle, () => slope)} /></span>`;
}

/** The key that is chosen, for those who show one. @param {State} state @returns {import("../state.js").KeyRef} */
function refOf(state) {
  const keys = state.selection?.kind === "keys" ? state.selection.keys : [];
  return keys[0] ?? { lane: -1, key: -1, joint: null };
}

/** How much time a key has to spare. @param {{ view: View, own: import("../state.js").KeyRef }} props */
function Spare({ view, own }) {
  const { before_s, after_s } = slackOf(view, own);
  const texts = [before_s === null ? "" : `${before_s.toFixed(2)} s before`, after_s === null ? "" : `${after_s.toFixed(2)} s after`].filter(Boolean);
  return texts.length === 0 ? null : html`<p class="muted" data-spare>to spare at most ${texts.join(", ")} (estimate)</p>`;
}

/** What would bring a late key in time, as the planner has found. @param {{ state: State, view: View, actions: Actions, own: import("../state.js").KeyRef }} props */
function Repairs({ state, view, actions, own }) {
  const [found, setFound] = useState(/** @type {import("../repairs.js").Repair[] | null} */ (null));
  const name = `${own.lane} ${own.key}`;
  useEffect(() => {
    let isOver = false;
    setFound(null);
    const look = async () => {
      /** @type {import("../repairs.js").Repair[]} */
      const good = [];
      for (const repair of state.drafts > 0 ? [] : repairsOf(view, own)) {
        const tried = await actions.editor.tried(repair.edit);
        if (isOver) return;
        if (tried?.window != null && tried.window.slow.length === 0 && !tried.window.keys.some((key) => key.is_missed)) good.push(repair);
      }
      setFound(good);
    };
    void look();
    return () => void (isOver = true);
  }, [view, name, state.drafts > 0]);
  if (lateOf(view, own) === 0 || found === null) return null;
  if (found.length === 0) return html`<p class="muted">No small change was found that brings it in time.</p>`;
  return html`<div class="repairs" role="group" aria-label="What brings it in time">in time with:
    ${found.map((repair) => html`<button type="button" key=${repair.text} onClick=${() => actions.editor.take(repair.edit)}>${repair.text}</button>`)}</div>`;
}

/** Of several keys: how many, and what is done with all of them. @param {{ state: State, view: View, actions: Actions, count: number }} props */
function AboutKeys({ state, view, actions, count }) {
  const { editor } = actions;
  const joints = editor.keys.flatMap(({ lane, key, joint }) => (joint === null ? Object.keys(view.lanes[lane]?.keys[key]?.deg ?? {}) : [joint]));
  return html`<h2>${count} keys</h2>
    <div class="fields">
      <${NumberField} name="move by" unit="s" value=${0} digits=${3} set=${(/** @type {number} */ by_s) => editor.move({ by_s, by_deg: 0 })} />
      <${NumberField} name="turn by" unit="°" value=${0} digits=${2} set=${(/** @type {number} */ by_deg) => editor.move({ by_s: 0, by_deg })} />
      <${NumberField} name="stretch about the cursor" unit="%" value=${100} digits=${1} least=${1} set=${(/** @type {number} */ percent) => editor.scale(percent / 100)} />
    </div>
    <div class="choices">ease <${Choice} label="ease" options=${EASES.map((ease) => [ease, ease])} chosen=${null}
      choose=${(/** @type {string} */ ease) => editor.set({ values: { ease } })} /></div>
    <${Limits} state=${state} view=${view} joints=${[...new Set(joints)]} />`;
}

/** What is slowed or given up of joints. @param {{ state: State, view: View, joints: string[] }} props */
function Limits({ state, view, joints }) {
  const spans = [...view.stretched, ...view.given_up].filter((span) => joints.includes(span.joint));
  if (spans.length === 0 || state.drafts > 0) return null;
  return html`<ul class="reasons">${spans.map((span) => html`<li key=${`${span.joint} ${span.from_s}`} class="warn-text">${span.text}</li>`)}</ul>`;
}

/**
 * A number that is taken when it is finished; Escape gives back what it was.
 * @param {{ name: string, unit: string, value: number, digits: number, least?: number, most?: number, isBare?: boolean, set: (value: number) => void }} props
 */
export function NumberField({ name, unit, value, digits, least, most, isBare, set }) {
  const shown = String(Number(value.toFixed(digits)));
  return html`<label class=${isBare ? "field-bare" : "field"}><span class=${isBare ? "hidden" : ""}>${name}</span>
    <input type="number" step="any" data-field=${name} data-was=${shown} ...${{ min: least, max: most }} value=${shown} key=${shown}
      onKeyDown=${leave} onChange=${(/** @type {Event} */ event) => {
        const own = /** @type {HTMLInputElement} */ (event.currentTarget);
        const wanted = Number(own.value);
        if (own.value === "" || !Number.isFinite(wanted)) own.value = shown;
        else if (wanted !== Number(shown)) set(Math.min(Math.max(wanted, least ?? -Infinity), most ?? Infinity));
      }} /> ${unit}</label>`;
}

/** @param {{ name: string, value: string, isBare?: boolean, set: (value: string) => void }} props */
export function TextField({ name, value, set, isBare }) {
  return html`<label class="field"><span class=${isBare ? "hidden" : ""}>${name}</span>
    <input type="text" maxlength="60" data-field=${name} data-was=${value} value=${value} key=${value} autocomplete="off" spellcheck=${false} onKeyDown=${leave}
      onChange=${(/** @type {Event} */ event) => set(/** @type {HTMLInputElement} */ (event.currentTarget).value.trim())} /></label>`;
}

/** Enter takes what was typed and leaves the field; Escape, which gives it back, is in `Actions.closeOpen`.
 * @param {KeyboardEvent} event */
function leave(event) {
  if (event.key !== "Enter") return;
  event.stopPropagation();
  /** @type {HTMLInputElement} */ (event.currentTarget).blur();
}

/** @param {Props} props */
function AboutPlan({ state, actions }) {
  const { view } = state;
  if (view === null) return null;
  const spans = /** @type {const} */ (["stretched", "given_up"]);
  return html`<h2>${view.name}</h2>
    <p class="muted">${view.joints.length} joints, ${view.lanes.reduce((sum, lane) => sum + lane.keys.length, 0)} keys, ${view.is_endless ? "without end" : timeText(view.duration_s ?? 0, 0.1)}</p>
    ${spans.every((list) => view[list].length === 0) ? html`<p>Nothing is slowed, no angle is given up.</p>` : null}
    <ul class="reasons scroll">${spans.flatMap((list) => view[list].map((span, index) => html`<li key=${`${list}-${index}`}>
      <button type="button" class="plain" onClick=${() => {
        actions.set({ selection: { kind: "span", list, index } });
        actions.moveTo(span.from_s);
      }}>${span.text}</button></li>`))}</ul>
    <${PoseSliders} state=${state} actions=${actions} />
    ${state.document?.notes.map((note) => html`<p class="muted">${note}</p>`)}`;
}
