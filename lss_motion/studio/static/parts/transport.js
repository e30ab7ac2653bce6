// @ts-check
/** GO, play, pause, rate and the way through the show, at the foot of every page. */

import { html, useEffect, useRef } from "../vendor/preact.js";
import { onFrame } from "../frames.js";
import { instantOf, isUnderWay } from "../states.js";
import { timeText } from "../timeline/window.js";
import { Choice } from "./choice.js";

/** @typedef {{ state: import("../state.js").State, actions: import("../actions.js").Actions, store: import("../store.js").Store }} Props */

/** @type {[number, string][]} */
const RATES = [[0.25, "25 %"], [0.5, "50 %"], [0.75, "75 %"], [1, "100 %"]];

/** @param {Props} props */
export function Transport({ state, actions, store }) {
  const { player, rate, view, page } = state;
  const { stage } = state;
  // Of a stage it fires the next cue of GO, or ends a rest that waits for GO.
  const hasGo = stage !== null && (stage.next_go !== null || stage.reasons.some((text) => text.startsWith("waits for GO")));
  const isReady = player.state === "ready" || hasGo;
  const next = stage?.next_go == null ? "" : `: ${stage.next_go}`;
  const isRunning = actions.isRunning;
  const canPause = isUnderWay(state);
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
    ${view === null ? null : html`<${Way} ...${{ state, actions, store }} />`}
  </footer>`;
}

/** @param {number} ratio */
function nearestRate(ratio) {
  return RATES.map(([one]) => one).reduce((best, one) => (Math.abs(one - ratio) < Math.abs(best - ratio) ? one : best));
}

/** Write the instant that the page shows to the slider; while that is held, it is the hand's.
 * @param {Element} way @param {import("../store.js").Store} store */
function drawWay(way, store) {
  const state = store.state.value;
  const [text, input] = [way.querySelector(".way-at"), way.querySelector("input")];
  if (state.view === null || text === null || input === null || input.matches(":active")) return;
  const at_s = isUnderWay(state) ? instantOf(state, store.telemetry.value).at_s : state.cursor_s;
  const written = timeText(at_s, 0.1);
  input.value = String(at_s);
  if (text.textContent === written) return;
  text.textContent = written;
  input.setAttribute("aria-valuetext", `${written} of ${timeText(state.view.view_s, 0.1)}`);
}

/** The way through the show as a slider: seek while it plays, the cursor otherwise.
 * @param {Props} props */
function Way({ state, actions, store }) {
  const way = useRef(/** @type {HTMLElement | null} */ (null));
  useEffect(() => onFrame(() => {
    if (way.current !== null) drawWay(way.current, store);
  }), []);
  const { view } = state;
  if (view === null) return null;
  const canSeek = isUnderWay(state);
  return html`<label class="way" ref=${way}><span class="way-name">${canSeek ? "Seek" : "Cursor"}</span> <span class="way-at"></span>
    <input type="range" min="0" max=${view.view_s} step="0.01"
      onChange=${(/** @type {Event} */ event) => {
        const to_s = Number(/** @type {HTMLInputElement} */ (event.currentTarget).value);
        if (canSeek) actions.seek(to_s);
        else actions.moveTo(to_s);
      }} />
    <span class="way-end">of ${view.is_endless ? "∞" : timeText(view.view_s, 0.1)}</span></label>`;
}
