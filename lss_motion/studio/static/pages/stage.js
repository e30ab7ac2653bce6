// @ts-check
/** What the Show page has for a stage: its state, the cue list, and what has happened. GO is at the foot. */

import { html } from "../vendor/preact.js";
import { whyNoPlan } from "../parts/text.js";

/** @typedef {{ state: import("../state.js").State, actions: import("../actions.js").Actions }} Props */

/** What is on and why, and what waits. The state is at the head. @param {{ state: import("../state.js").State }} props */
export function StageState({ state }) {
  const own = state.stage;
  if (own === null) return null;
  const because = own.cause === "" || own.reasons.length > 0 ? "" : own.cause === "idle" ? "nothing else plays" : `cue ${own.cause}`;
  const fired = own.cues.reduce((sum, cue) => sum + cue.fired, 0);
  const rows = [
    ["on", own.show ?? "nothing"], ["because", because], ["beside it", own.added.join(", ")],
    ["queue", own.queue.join(", ")], ["resumed later", own.left.join(", ")],
    ["timecode", own.timecode == null ? "" : timecodeText(own.timecode)],
    ["so far", fired === 0 ? "no cue has fired" : own.cues.filter((cue) => cue.fired > 0).map((cue) => `${cue.name} ${cue.fired}×`).join(", ")],
    ["last", state.notes[0]?.text ?? ""],
  ].filter(([, text]) => text !== "");
  return html`<dl class="stage-state" aria-label="Stage">${rows.map(([name, text]) => html`<div key=${name}><dt>${name}</dt><dd>${text}</dd></div>`)}</dl>`;
}

/** The timecode in a line. @param {import("../state.js").StageTimecode} timecode */
function timecodeText({ state, source, at, rate, show, off_ms }) {
  const runs = rate === null || state !== "locked" || Math.abs(rate - 1) < 5e-5 ? "" : ` at ${(100 * rate).toFixed(2)} %`;
  const off = off_ms === null ? "" : ` (${off_ms.toFixed(0)} ms)`;
  return `${at} ${state.replace("_", " ")}${runs}, ${source}${show === null ? "" : `; the show ${show}${off}`}`.trim();
}

/** The cues, each a large button: one fires by it, whatever it waits for. @param {Props} props */
export function StageCues({ state, actions }) {
  const own = state.stage;
  if (own === null) {
    return html`<p class="muted">${state.document?.plan == null ? whyNoPlan(state) : "The stage does not run. START begins it."}</p>`;
  }
  const isResting = own.state === "rests" || own.state === "given_up";
  return html`<div class="stage-head">
      <button type="button" onClick=${() => actions.stage(isResting ? "stage.wake" : "stage.rest")}>${isResting ? "Wake" : "Rest"}</button>
    </div>
    <ol class="scroll stage-cues">${own.cues.map((cue) => {
      const isOn = cue.name === own.cause;
      const isNext = cue.name === own.next_go;
      return html`<li key=${cue.name} class=${isOn ? "present" : isNext ? "coming" : cue.is_enabled ? "" : "past"} data-stage-cue=${cue.name}>
        <button type="button" class="fire" aria-label=${`Fire ${cue.name}`} onClick=${() => actions.cue(cue.name)}>
          <strong>${isOn ? "▶ " : ""}${cue.name}</strong><span>${cue.plays}</span></button>
        <span class="cue-when">${cue.is_enabled ? cue.when : `off: ${cue.when}`}${cue.fired === 0 ? "" : ` · ${cue.fired}×`}</span>
        ${cue.refused === "" ? null : html`<span class="refused">✕ ${cue.refused}</span>`}
        <span class="cue-choices"><label class="enable"><input type="checkbox" role="switch" aria-label=${`${cue.name} can fire`} checked=${cue.is_enabled}
          onChange=${() => actions.stage("enable", { cue: cue.name, is_enabled: !cue.is_enabled })} /> may fire</label>
        <button type="button" class="plain" aria-label=${`Next on GO: ${cue.name}`} disabled=${isNext}
          onClick=${() => actions.stage("arm", { cue: cue.name })}>${isNext ? "next on GO" : "make next"}</button></span>
      </li>`;
    })}</ol>`;
}

/** Every computer of a stage with figures. STOP at the foot is for all of them.
 * @param {{ state: import("../state.js").State }} props */
export function StageHosts({ state }) {
  const hosts = state.stage?.hosts ?? [];
  if (hosts.length === 0) return null;
  return html`<h2>Computers <span class="muted">STOP is for all</span></h2>
    <div class="scroll host-scroll"><table class="hosts"><thead><tr>
      <th scope="col">figure</th><th scope="col">state</th><th scope="col">clock</th><th scope="col">show</th><th scope="col">health</th><th scope="col">last word</th>
    </tr></thead><tbody>${hosts.map((host) => html`
      <tr key=${host.name} data-host=${host.name} class=${host.is_good ? "" : "host-bad"}>
        <th scope="row">${host.name}${host.is_conductor ? html` <span class="muted">conducts</span>` : null}</th>
        <td class="host-state">${host.is_good ? "" : "▲ "}${host.state}</td>
        <td class="number">${clockText(host)}</td>
        <td class="number">${host.show_s === null ? "–" : `${host.show_s.toFixed(1)} s`}${host.off_ms === null ? "" : html`<br />${signed(host.off_ms, 1)} ms`}</td>
        <td class="number">${healthText(host)}</td>
        <td class="host-text">${host.text || (host.heard_s === null ? "" : host.heard_s > 2 ? `silent for ${host.heard_s.toFixed(0)} s` : "–")}</td>
      </tr>`)}</tbody></table></div>`;
}

/** By how much the clock of a computer differs, and how well that is known. @param {import("../state.js").StageHost} host */
function clockText({ is_conductor, offset_ms, bound_ms }) {
  if (is_conductor) return "its own";
  if (bound_ms === null) return "not known";
  return html`± ${bound_ms.toFixed(2)} ms<br /><span class="muted">${offsetText(offset_ms ?? 0)}</span>`;
}

/** An offset of clocks that count from their own start: from microseconds to months. @param {number} offset_ms */
function offsetText(offset_ms) {
  return Math.abs(offset_ms) < 1000 ? `${signed(offset_ms, 2)} ms` : `${signed(offset_ms / 1000, 3)} s`;
}

/** @param {number} value @param {number} digits */
function signed(value, digits) {
  return `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;
}

/** @param {import("../state.js").StageHost} host */
function healthText({ hottest_c, late_ms }) {
  const parts = [hottest_c === null ? "" : `${hottest_c.toFixed(0)} °C`, late_ms === null ? "" : `late ${late_ms.toFixed(1)} ms`];
  return parts.filter((part) => part !== "").join(", ") || "–";
}

/** What has happened, the newest first. @param {{ state: import("../state.js").State }} props */
export function StageNotes({ state }) {
  if (state.notes.length === 0) return null;
  return html`<ul class="scroll trouble-list stage-notes" aria-label="What has happened">${state.notes.map((note) => html`
    <li key=${note.number} class=${note.kind === "alert" ? "fault" : "note"}><span class="sign" aria-hidden="true">${note.kind === "alert" ? "■" : "•"}</span>
      <span>${note.text}</span></li>`)}</ul>`;
}
