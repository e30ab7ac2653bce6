// @ts-check
/** What the Show page has for a stage: its state, the cue list, and what has happened. GO is at the foot. */

import { html } from "../vendor/preact.js";

/** @typedef {{ state: import("../state.js").State, actions: import("../actions.js").Actions }} Props */

/** The states of a stage, as an operator says them. @type {Record<string, string>} */
const WORDS = {
  waits_for_port: "waits for the robot", connecting: "checks the servos", idle: "idle",
  plays: "plays", rests: "rests", given_up: "given up after faults",
};

/** What the stage does now, and what comes. @param {{ state: import("../state.js").State }} props */
export function StageState({ state }) {
  const own = state.stage;
  if (own === null) return null;
  const rows = [
    ["show", own.show ?? "none"], ["because of", own.cause], ["beside it", own.added.join(", ")],
    ["queue", own.queue.join(", ")], ["to be resumed", own.left.join(", ")],
    ["rests because", own.reasons.join("; ")],
    ["timecode", own.timecode == null ? "" : timecodeText(own.timecode)],
  ].filter(([name, text]) => text !== "" || name === "show");
  return html`<div class="stage-state" role="status" aria-label="Stage">
    <p class=${`stage-word stage-${own.state}`}>${WORDS[own.state] ?? own.state}</p>
    <dl class="lines">${rows.map(([name, text]) => html`<div key=${name}><dt>${name}</dt><dd>${text}</dd></div>`)}</dl>
  </div>`;
}

/** The timecode in a line. @param {import("../state.js").StageTimecode} timecode */
function timecodeText({ state, source, at, rate, show, off_ms }) {
  const runs = rate === null || state !== "locked" || Math.abs(rate - 1) < 5e-5 ? "" : ` at ${(100 * rate).toFixed(2)} %`;
  const off = off_ms === null ? "" : ` (${off_ms.toFixed(0)} ms)`;
  return `${at} ${state.replace("_", " ")}${runs}, ${source}${show === null ? "" : `; the show ${show}${off}`}`.trim();
}

/** The cue list. A cue fires by its button, whatever it waits for. @param {Props} props */
export function StageCues({ state, actions }) {
  const own = state.stage;
  if (own === null) return html`<p class="muted">The stage does not run. START begins it.</p>`;
  const isResting = own.state === "rests" || own.state === "given_up";
  return html`<div class="stage-cues">
    <p class="stage-head">
      <button type="button" onClick=${() => actions.stage(isResting ? "stage.wake" : "stage.rest")}>${isResting ? "Wake" : "Rest"}</button>
    </p>
    <ol class="scroll cue-list">${own.cues.map((cue) => html`
      <li key=${cue.name} class=${cue.name === own.next_go ? "coming" : cue.is_enabled ? "" : "past"} data-stage-cue=${cue.name}>
        <button type="button" class="fire" aria-label=${`Fire ${cue.name}`} onClick=${() => actions.cue(cue.name)}>▶</button>
        <span class="cue-text"><strong>${cue.name}</strong> <span class="muted">${cue.on} → ${cue.plays}</span>
          ${cue.refused === "" ? null : html`<span class="refused">✕ ${cue.refused}</span>`}</span>
        <span class="number" aria-label=${`${cue.fired} times`}>${cue.fired}×</span>
        <button type="button" class="plain" aria-label=${`Next on GO: ${cue.name}`} disabled=${cue.name === own.next_go}
          onClick=${() => actions.stage("arm", { cue: cue.name })}>next</button>
        <label class="enable"><input type="checkbox" role="switch" aria-label=${`${cue.name} can fire`} checked=${cue.is_enabled}
          onChange=${() => actions.stage("enable", { cue: cue.name, is_enabled: !cue.is_enabled })} /> on</label>
      </li>`)}</ol></div>`;
}

/** What has happened, the newest first. @param {{ state: import("../state.js").State }} props */
export function StageNotes({ state }) {
  if (state.notes.length === 0) return null;
  return html`<ul class="scroll trouble-list stage-notes" aria-label="What has happened">${state.notes.map((note) => html`
    <li key=${note.number} class=${note.kind === "alert" ? "fault" : "note"}><span class="sign" aria-hidden="true">${note.kind === "alert" ? "■" : "•"}</span>
      <span>${note.text}</span></li>`)}</ul>`;
}
