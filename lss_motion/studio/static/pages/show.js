// @ts-check
/** The Show page: made to run a show from a tablet. No way to change the file. */

import { html, useEffect, useRef } from "../vendor/preact.js";
import { FigurePanel } from "../figure/panel.js";
import { onFrame } from "../frames.js";
import { whyNoPlan } from "../parts/text.js";
import { Wellness } from "../parts/wellness.js";
import { hasTime, instantOf, isUnderWay, MOVING, stateOf } from "../states.js";
import { timeText } from "../timeline/window.js";
import { StageCues, StageHosts, StageNotes, StageState } from "./stage.js";

/** @typedef {import("../state.js").State} State */
/** @typedef {{ state: State, actions: import("../actions.js").Actions, store: import("../store.js").Store }} Props */

/** @param {Props} props */
export function ShowPage({ state, actions, store }) {
  const page = useRef(/** @type {HTMLElement | null} */ (null));
  useEffect(() => onFrame(() => {
    if (page.current !== null) drawLive(page.current, store);
  }), []);
  const isStage = state.document?.kind === "stage" || state.stage !== null;
  return html`<main class=${`page show ${state.stage === null ? "" : "show-stage"} ${state.theatre ? "show-theatre" : ""}`} ref=${page}>
    <section class="now" aria-label="Now">
      <${Now} state=${state} />
      <${StageState} state=${state} />
    </section>
    <section class="card stand" aria-label="Figure"><${FigurePanel} store=${store} />
      <button type="button" class="theatre-switch" aria-pressed=${state.theatre} onClick=${() => actions.run("theatre")}
        title="F11 makes the browser fill the screen">${state.theatre ? "Back to the page" : "Figure and clock only"}</button></section>
    <section class="card cues" aria-label="Cues"><h2>Cues</h2>${isStage
      ? html`<${StageCues} state=${state} actions=${actions} />` : html`<${Cues} state=${state} actions=${actions} />`}</section>
    <section class="card troubles" aria-label="Joints, warnings and faults">
      <${StageHosts} state=${state} /><${Wellness} state=${state} />
      <${Troubles} state=${state} /><${StageNotes} state=${state} /></section>
  </main>`;
}

/** @param {{ state: State }} props */
function Now({ state }) {
  const { view } = state;
  return view !== null && hasTime(state) && html`
    <p class="clock"><span data-clock>0:00.0</span>
      <span class="clock-of">${view === null ? "" : view.is_endless ? "without end" : `of ${timeText(view.duration_s ?? view.view_s, 0.1)}`}</span></p>
    <div class="progress" aria-hidden="true"><i data-progress></i>
      ${view?.marks.map((mark) => html`<b class=${mark.is_anchor ? "anchor" : ""} style=${{ left: `${(100 * mark.at_s) / view.view_s}%` }}></b>`)}</div>
    <dl class="next">
      <div><dt>now</dt><dd data-now>–</dd></div>
      <div><dt>next</dt><dd data-next>–</dd></div>
    </dl>`;
}

/** Draw what changes with every frame. @param {Element} page @param {import("../store.js").Store} store */
function drawLive(page, store) {
  const state = store.state.value;
  const { view, rate } = state;
  if (view === null) return;
  const { name } = stateOf(state);
  const { show_s, at_s } = instantOf(state, store.telemetry.value);
  put(page, "[data-clock]", timeText(show_s, 0.1));
  const bar = page.querySelector("[data-progress]");
  if (bar instanceof HTMLElement) bar.style.width = `${((100 * at_s) / view.view_s).toFixed(2)}%`;
  const isRunning = ["playing", "paused", "waits", "recovering", "preparing"].includes(name);
  const all = upcoming(view);
  const later = isRunning ? all.find((one) => one.at_s > at_s) : undefined;
  const present = isRunning ? all.filter((one) => one.at_s <= at_s + 1e-3).at(-1) : undefined;
  put(page, "[data-next]", nextText(view, later, at_s, isRunning, MOVING.has(name) ? Math.max(rate.ratio, 0.01) : 0));
  put(page, "[data-now]", present?.text ?? "–");
  for (const item of page.querySelectorAll("[data-cue]")) {
    const own_s = Number(/** @type {HTMLElement} */ (item).dataset["cue"]);
    const cue = own_s === present?.at_s ? "present" : own_s === later?.at_s ? "coming" : isRunning && own_s <= at_s ? "past" : "";
    if (item.className === cue) continue;
    item.className = cue;
    if (cue === "coming") item.scrollIntoView({ block: "nearest" });
    if (cue === "present") item.scrollIntoView({ block: "nearest" });
  }
}

/**
 * What comes next, in how long while the show moves on; nothing where nothing runs.
 * @param {import("../state.js").View} view @param {{ at_s: number, text: string } | undefined} later
 * @param {number} at_s @param {boolean} isRunning @param {number} ratio speed of the show, 0: it stands
 */
function nextText(view, later, at_s, isRunning, ratio) {
  if (!isRunning) return "–";
  const to_s = later?.at_s ?? view.view_s;
  const text = later?.text ?? (view.is_endless ? "again from the start" : "the end");
  return ratio > 0 ? `${text} in ${((to_s - at_s) / ratio).toFixed(1)} s` : text;
}

/** @param {Element} page @param {string} place @param {string} text */
function put(page, place, text) {
  const element = page.querySelector(place);
  if (element !== null && element.textContent !== text) element.textContent = text;
}

/** @type {WeakMap<import("../state.js").View, { at_s: number, text: string, kind: string }[]>} */
const cues = new WeakMap();

/** Labels and events in order. @param {import("../state.js").View} view */
function upcoming(view) {
  let found = cues.get(view);
  if (found === undefined) {
    found = [
      ...view.marks.map((mark) => ({ at_s: mark.at_s, text: mark.label, kind: mark.is_anchor ? "anchor" : "label" })),
      ...view.events.map((event) => ({ at_s: event.at_s, text: event.text, kind: event.kind })),
    ].sort((one, other) => one.at_s - other.at_s);
    // A loop ends where it begins: that is one instant.
    found = found.filter((cue, index) => {
      const before = index === 0 ? undefined : found?.[index - 1];
      return before === undefined || before.text !== cue.text || cue.at_s - before.at_s > 1e-3;
    });
    cues.set(view, found);
  }
  return found;
}

/** @param {{ state: State, actions: import("../actions.js").Actions }} props */
function Cues({ state, actions }) {
  const { view } = state;
  if (view === null) {
    return html`<p class="muted">${whyNoPlan(state)}</p>`;
  }
  const found = upcoming(view);
  const canSeek = isUnderWay(state);
  if (found.length === 0) return html`<p class="muted">This show has no labels and no events.</p>`;
  return html`<ol class="scroll cue-list">${found.map((cue, index) => html`<li key=${index} data-cue=${cue.at_s}>
    <span class="number">${timeText(cue.at_s, 0.1)}</span>
    ${cue.kind === "label" ? null : html`<span class=${`kind kind-${cue.kind}`}>${cue.kind}</span>`}<span class="cue-text">${cue.text}</span>
    ${canSeek ? html`<button type="button" class="plain" aria-label=${`Go to ${cue.text}`} onClick=${() => actions.seek(cue.at_s)}>go to</button>` : null}</li>`)}</ol>`;
}

/** @param {{ state: State }} props */
function Troubles({ state }) {
  if (state.trouble.length === 0) return null;
  const signs = { fault: "■", warning: "▲", note: "•" };
  return html`<ul class="scroll trouble-list" aria-live="polite">${state.trouble.map((one) => html`
    <li key=${one.number} class=${one.kind}><span class="sign" aria-hidden="true">${signs[one.kind]}</span>
      <span><span class="hidden">${one.kind}: </span>${one.at_s === null ? "" : html`<span class="number">${timeText(one.at_s, 0.1)}</span> `}${one.text}${one.done ? html`<span class="done"> → ${one.done}</span>` : null}</span></li>`)}</ul>`;
}
