// @ts-check
/** GO, play, pause, rate and the way through the show, at the foot of every page. */

import { html } from "../vendor/preact.js";
import { withinView } from "../curves.js";
import { timeText } from "../timeline/window.js";
import { Choice } from "./choice.js";

/** @typedef {{ state: import("../state.js").State, actions: import("../actions.js").Actions, store: import("../store.js").Store }} Props */

/** @type {[number, string][]} */
const RATES = [[0.25, "25 %"], [0.5, "50 %"], [0.75, "75 %"], [1, "100 %"]];

/** @param {Props} props */
export function Transport({ state, actions }) {
  const { player, rate, view, page } = state;
  const { stage } = state;
  // Of a stage it fires the next cue of GO, or ends a rest that waits for GO.
  const hasGo = stage !== null && (stage.next_go !== null || stage.reasons.some((text) => text.startsWith("waits for GO")));
  const isReady = player.state === "ready" || hasGo;
  const next = stage?.next_go == null ? "" : `: ${stage.next_go}`;
  const isRunning = actions.isRunning;
  const canPause = player.state === "playing" || player.state === "paused";
  const hasPlan = state.document?.plan != null;
  return html`<footer class="foot">
    <button type="button" class=${`go ${isReady ? "go-ready" : ""}`} data-go disabled=${isRunning && !isReady || !hasPlan}
      onClick=${() => actions.go()}><span class="go-text">${isReady || isRunning ? `GO${next}` : "START"}</span><span class="key-hint">Enter</span></button>
    ${isRunning || page === "show"
      ? html`<button type="button" class="big" disabled=${!canPause} onClick=${() => actions.toggle()}>
          ${rate.is_paused ? "▶ Resume" : "❚❚ Pause"}<span class="key-hint">Space</span></button>`
      : html`<button type="button" class="big" disabled=${!hasPlan} onClick=${() => actions.play(true)}>
          ▶ Play from cursor<span class="key-hint">Space</span></button>`}
    <div class="rate"><span class="rate-name">Rate</span><${Choice} label="Rate" options=${RATES} chosen=${nearestRate(rate.ratio)} disabled=${!canPause}
      choose=${(/** @type {number} */ ratio) => actions.rate(ratio)} /></div>
    ${view === null ? null : html`<${Way} state=${state} actions=${actions} />`}
  </footer>`;
}

/** @param {number} ratio */
function nearestRate(ratio) {
  return RATES.map(([one]) => one).reduce((best, one) => (Math.abs(one - ratio) < Math.abs(best - ratio) ? one : best));
}

/** The way through the show as a slider: seek while it plays, the cursor otherwise.
 * @param {{ state: import("../state.js").State, actions: import("../actions.js").Actions }} props */
function Way({ state, actions }) {
  const { view, health, player } = state;
  if (view === null) return null;
  const canSeek = player.state === "playing" || player.state === "paused";
  const at_s = canSeek && health?.show_s != null ? withinView(view, Math.max(health.show_s, 0)) : state.cursor_s;
  return html`<label class="way"><span class="way-name">${canSeek ? "Seek" : "Cursor"}</span> <span class="way-at">${timeText(at_s, 0.1)}</span>
    <input type="range" min="0" max=${view.view_s} step="0.01" value=${at_s}
      aria-valuetext=${`${timeText(at_s, 0.1)} of ${timeText(view.view_s, 0.1)}`}
      onChange=${(/** @type {Event} */ event) => {
        const to_s = Number(/** @type {HTMLInputElement} */ (event.currentTarget).value);
        if (canSeek) actions.seek(to_s);
        else actions.moveTo(to_s);
      }} />
    <span class="way-end">of ${view.is_endless ? "∞" : timeText(view.view_s, 0.1)}</span></label>`;
}
