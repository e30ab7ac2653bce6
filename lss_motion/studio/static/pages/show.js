// @ts-check
/** The Show page: made to run a show from a tablet. No way to change the file. */

import { html, useEffect, useRef } from "../vendor/preact.js";
import { angleAt, withinView } from "../curves.js";
import { FigurePanel } from "../figure/panel.js";
import { onFrame } from "../frames.js";
import { drawAngles, Joints } from "../parts/joints.js";
import { timeText } from "../timeline/window.js";
import { StageCues, StageHosts, StageNotes, StageState } from "./stage.js";

/** @typedef {import("../state.js").State} State */
/** @typedef {{ state: State, actions: import("../actions.js").Actions, store: import("../store.js").Store }} Props */

/** The states of the player, as an operator says them. @type {Record<string, string>} */
const WORDS = {
  idle: "not started", starting: "starting", ready: "ready: waits for GO", playing: "playing",
  paused: "paused", stopping: "stopping", ended: "ended", gone: "the player is gone",
};

/** What the player does before and between playing, by its phase. @type {Record<string, string>} */
const STEPS = {
  connecting: "checks the servos", preparing: "sets the servos up", approaching: "moves to the start",
  seeking: "brakes for another place", recovering: "waits for what is missing",
  restoring: "gives the settings back",
};

/** What the player does now, in words. @param {State} state */
function wordOf({ player, phase, ended }) {
  if (player.state === "ended" && ended?.outcome === "stopped") return "stopped";
  const isBusy = player.state === "starting" || player.state === "playing";
  return (isBusy ? STEPS[phase] : undefined) ?? WORDS[player.state] ?? player.state;
}

/** @param {Props} props */
export function ShowPage({ state, actions, store }) {
  const page = useRef(/** @type {HTMLElement | null} */ (null));
  useEffect(() => onFrame(() => {
    if (page.current !== null) drawLive(page.current, store);
  }), []);
  return html`<main class=${`page show ${isStage(state) ? "show-stage" : ""}`} ref=${page}>
    <section class="now" aria-label="Now">
      <${Now} state=${state} />
      <${StageState} state=${state} />
    </section>
    <section class="card cues" aria-label="Cues"><h2>Cues</h2>${isStage(state)
      ? html`<${StageCues} state=${state} actions=${actions} />` : html`<${Cues} state=${state} actions=${actions} />`}</section>
    <section class="card health" aria-label=${hasHosts(state) ? "Computers and joints" : "Joints"}><${StageHosts} state=${state} /><h2>Joints</h2>
      <div class="scroll"><${Joints} state=${state} /></div>
      <${Lines} state=${state} />
      ${isMany(state) || hasHosts(state) ? null : html`<div class="health-figure"><${FigurePanel} store=${store} /></div>`}
    </section>
    <section class="card troubles" aria-label="Warnings and faults"><h2>Warnings and faults</h2><${Troubles} state=${state} /><${StageNotes} state=${state} /></section>
  </main>`;
}

/** Whether the file is a stage, whose cues are its own. @param {State} state */
function isStage(state) {
  return state.document?.kind === "stage" || state.stage !== null;
}

/** Whether several computers play together. @param {State} state */
function hasHosts(state) {
  return (state.stage?.hosts.length ?? 0) > 0;
}

/** Whether the joints leave the figure no room. @param {State} state */
function isMany(state) {
  return (state.view?.joints.length ?? 0) > 9;
}

/** @param {{ state: State }} props */
function Now({ state }) {
  const { player, view, last_mark, waiting, rate, ended } = state;
  const word = wordOf(state);
  const slower = rate.ratio < 1 ? ` at ${Math.round(100 * rate.ratio)} %` : "";
  return html`
    <p class=${`word word-${player.state}`} role="status">${word}${player.state === "playing" ? slower : ""}
      ${ended?.error ? html`<span class="bad-text">: ${ended.error}</span>` : null}</p>
    <p class="clock"><span data-clock>0:00.0</span>
      <span class="clock-of">${view === null ? "" : view.is_endless ? "without end" : `of ${timeText(view.duration_s ?? view.view_s, 0.1)}`}</span></p>
    <div class="progress" aria-hidden="true"><i data-progress></i>
      ${view?.marks.map((mark) => html`<b class=${mark.is_anchor ? "anchor" : ""} style=${{ left: `${(100 * mark.at_s) / view.view_s}%` }}></b>`)}</div>
    ${waiting !== null ? html`<p class="waiting">⧗ waits for ${waiting}</p>` : null}
    <dl class="next">
      <div><dt>now</dt><dd data-now>${last_mark?.label ?? "–"}</dd></div>
      <div><dt>next</dt><dd data-next>–</dd></div>
    </dl>`;
}

/** Draw what changes with every frame. @param {Element} page @param {import("../store.js").Store} store */
function drawLive(page, store) {
  const state = store.state.value;
  const { view, cursor_s } = state;
  const frame = store.telemetry.value;
  if (view === null) return;
  const isOver = state.player.state === "idle";
  const show_s = frame === null || isOver ? cursor_s : frame.show_s;
  const at_s = withinView(view, Math.max(show_s, 0));
  put(page, "[data-clock]", timeText(show_s, 0.1));
  const bar = page.querySelector("[data-progress]");
  if (bar instanceof HTMLElement) bar.style.width = `${((100 * at_s) / view.view_s).toFixed(2)}%`;
  const later = upcoming(view).find((one) => one.at_s > at_s);
  put(page, "[data-next]", later === undefined ? "the end" : `${later.text} in ${(later.at_s - at_s).toFixed(1)} s`);
  const before = view.marks.filter((mark) => mark.at_s <= at_s + 1e-3).at(-1);
  put(page, "[data-now]", before?.label ?? "–");
  for (const item of page.querySelectorAll("[data-cue]")) {
    const own_s = Number(/** @type {HTMLElement} */ (item).dataset["cue"]);
    const cue = own_s <= at_s + 1e-3 ? "past" : own_s === later?.at_s ? "coming" : "";
    if (item.className !== cue) {
      item.className = cue;
      if (cue === "coming") item.scrollIntoView({ block: "nearest" });
    }
  }
  if (frame !== null && !isOver && state.started !== null) drawAngles(page, frame, state.started.joints);
  else drawAngles(page, plannedAt(view, at_s), view.joints.map((joint) => joint.name));
}

/** What the telemetry would be with nothing read. @param {import("../state.js").View} view
 * @param {number} at_s @returns {import("../state.js").Telemetry} */
function plannedAt(view, at_s) {
  const planned_deg = Float32Array.from(view.joints, ({ name }) => {
    const plan = view.curves[name]?.plan;
    return plan === undefined ? NaN : angleAt(plan, at_s);
  });
  const read_deg = new Float32Array(planned_deg.length).fill(NaN);
  return { plan: view.plan, show_s: at_s, rate: 1, planned_deg, predicted_deg: planned_deg, read_deg };
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
  const { view, player } = state;
  if (view === null) {
    const isRobot = state.document?.kind === "robot";
    return html`<p class="muted">${isRobot ? "A robot file has no show: open a sequence, a gait or a play list. The Robot page moves this robot." : "No plan yet."}</p>`;
  }
  const found = upcoming(view);
  const canSeek = player.state === "playing" || player.state === "paused";
  if (found.length === 0) return html`<p class="muted">This show has no labels and no events.</p>`;
  return html`<ol class="scroll cue-list">${found.map((cue, index) => html`<li key=${index} data-cue=${cue.at_s}>
    <span class="number">${timeText(cue.at_s, 0.1)}</span>
    <span class=${`kind kind-${cue.kind}`}>${cue.kind}</span><span class="cue-text">${cue.text}</span>
    ${canSeek ? html`<button type="button" class="plain" aria-label=${`Go to ${cue.text}`} onClick=${() => actions.seek(cue.at_s)}>go to</button>` : null}</li>`)}</ol>`;
}

/** @param {{ state: State }} props */
function Lines({ state }) {
  const { health, view } = state;
  const buses = Object.keys(health?.buses ?? view?.line ?? {});
  return html`<dl class="lines">${buses.map((bus) => {
    const own = health?.buses[bus];
    const use = own?.use_ratio ?? view?.line[bus]?.mean_ratio ?? 0;
    return html`<div key=${bus}><dt>line ${bus}</dt><dd>
      <span class="meter" role="meter" aria-label=${`use of line ${bus}`} aria-valuemin="0" aria-valuemax="100" aria-valuenow=${Math.round(100 * use)}>
        <i style=${{ width: `${Math.min(100 * use, 100)}%` }}></i></span>
      ${Math.round(100 * use)} %${own ? `, ${own.replies_hz.toFixed(0)} replies/s` : " planned"}</dd></div>`;
  })}
  ${health ? html`<div><dt>late</dt><dd>${(health.late_us / 1000).toFixed(1)} ms worst${health.missed > 0 ? `, ${health.missed} missed` : ""}</dd></div>` : null}</dl>`;
}

/** @param {{ state: State }} props */
function Troubles({ state }) {
  if (state.trouble.length === 0) return html`<p class="muted">None.</p>`;
  const signs = { fault: "■", warning: "▲", note: "•" };
  return html`<ul class="scroll trouble-list" aria-live="polite">${state.trouble.map((one) => html`
    <li key=${one.number} class=${one.kind}><span class="sign" aria-hidden="true">${signs[one.kind]}</span>
      <span><span class="hidden">${one.kind}: </span>${one.at_s === null ? "" : html`<span class="number">${timeText(one.at_s, 0.1)}</span> `}${one.text}${one.done ? html`<span class="done"> → ${one.done}</span>` : null}</span></li>`)}</ul>`;
}
