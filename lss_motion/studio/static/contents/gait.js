// @ts-check
/** The parameters of a gait by sliders, with feet, polygon and margin of what is planned. */

import { html, useMemo, useRef } from "../vendor/preact.js";
import { Choice } from "../parts/choice.js";
import { timeText } from "../timeline/window.js";
import { setOf } from "./editor.js";
import { Section, Slider, Small } from "./fields.js";
import { footingOf, leastMargin, poseAt } from "./footing.js";

/** @typedef {import("./panel.js").Part} Part */
/** @typedef {import("./editor.js").Place} Place */

/** Values of a gait with what is used where the file has none: words, unit, least, most, step.
 * @type {[Place, string, string, number, number, number, number?][]} */
const VALUES = [
  [["height_mm"], "height", "mm", 20, 250, 1],
  [["cycle_s"], "cycle", "s", 0.3, 5, 0.05, 1],
  [["step_height_mm"], "step height", "mm", 2, 100, 1, 25],
  [["sway_mm"], "sway", "mm", 0, 60, 1],
  [["leg", "stance_mm"], "stance", "mm", 20, 300, 1],
];
/** @type {[string, string, number, number, number][]} */
const SPEEDS = [["forward_mm_s", "mm/s", -150, 150, 5], ["left_mm_s", "mm/s", -100, 100, 5], ["turn_deg_s", "°/s", -60, 60, 1]];
/** Patterns by the number of legs (`show.gait.file`), the default first. @type {Record<number, readonly string[]>} */
const PATTERNS = { 4: ["trot", "pace", "bound", "walk", "crawl"], 6: ["tripod", "ripple", "wave", "amble"] };

/** @param {Part} props */
export function GaitContents({ state, actions, file, value }) {
  /** Of each slider the newest value that is not sent yet. */
  const waiting = useRef(/** @type {Map<string, { place: Place, to: number }>} */ (new Map()));
  const isSending = useRef(false);
  /** Set a value while its slider moves: one at a time. @param {Place} place @param {number} to */
  const set = async (place, to) => {
    waiting.current.set(place.join("-"), { place, to });
    if (isSending.current) return;
    isSending.current = true;
    for (let next = taken(waiting.current); next !== undefined; next = taken(waiting.current)) {
      const { place: at, to: value_then } = next;
      await actions.contents.change(() => [setOf(file, at, value_then)], `slide-${at.join("-")}`);
    }
    isSending.current = false;
  };
  const patterns = PATTERNS[Object.keys(value.legs ?? {}).length] ?? [];
  return html`<${Feet} state=${state} actions=${actions} />
    <${Section} title="Gait">
      ${patterns.length === 0 ? null : html`<div class="choices"><${Choice} label="pattern" options=${patterns.map((name) => [name, name])} chosen=${value.pattern ?? patterns[0]}
        choose=${(/** @type {string} */ name) => actions.contents.set(file, ["pattern"], name)} /></div>`}
      ${VALUES.map(([place, words, unit, least, most, step, usual]) => {
        const own = place.reduce((at, part) => at?.[part], value) ?? usual;
        return own === undefined ? html`<div class="adds" key=${words}><${Small} name=${`Set the ${words}`} run=${() => actions.contents.set(file, place, least)} /></div>`
          : html`<${Slider} key=${words} name=${words} ...${{ unit, least: Math.min(least, own), most: Math.max(most, own), step, value: own }}
            show=${(/** @type {number} */ to) => set(place, to)} set=${(/** @type {number} */ to) => set(place, to)} />`;
      })}</${Section}>
    ${(value.do ?? []).map((/** @type {any} */ action, /** @type {number} */ index) => action.walk === undefined ? null : html`<${Section} key=${index} title=${`Walk ${action.walk.label ?? index + 1}`}>
      ${SPEEDS.map(([key, unit, least, most, step]) => html`<${Slider} key=${key} name=${key.split("_")[0] ?? ""} ...${{ unit, least, most, step, value: action.walk[key] ?? 0 }}
        show=${(/** @type {number} */ to) => set(["do", index, "walk", key], to)} set=${(/** @type {number} */ to) => set(["do", index, "walk", key], to)} />`)}</${Section}>`)}`;
}

/** Take the oldest of those that wait. @template T @param {Map<string, T>} waiting @returns {T | undefined} */
function taken(waiting) {
  const [name] = waiting.keys();
  const own = name === undefined ? undefined : waiting.get(name);
  if (name !== undefined) waiting.delete(name);
  return own;
}

/** Feet, polygon and margin at the cursor, from above. @param {{ state: import("../state.js").State, actions: import("../actions.js").Actions }} props */
function Feet({ state, actions }) {
  const { view, cursor_s } = state;
  const figure = /** @type {import("./footing.js").Figure | null} */ (/** @type {any} */ (state.robot)?.figure ?? null);
  const least = useMemo(() => (figure === null || view === null || figure.feet.length < 3 ? null : leastMargin(figure, view)), [figure, view]);
  if (figure === null || view === null || least === null) return null;
  const { feet, polygon, margin_mm } = footingOf(figure, poseAt(view, cursor_s));
  const reach_mm = 1.1 * Math.max(...feet.map(({ at_mm: [x, y] }) => Math.max(Math.abs(x), Math.abs(y))), 10);
  // Forward is up, left is left.
  const across = (/** @type {number[]} */ [x, y]) => `${(-Number(y)).toFixed(1)},${(-Number(x)).toFixed(1)}`;
  const words = margin_mm > 0 ? `${margin_mm.toFixed(0)} mm inside` : "outside: it tips, or needs the next step";
  return html`<${Section} title="Feet at the cursor">
    <svg class="feet" data-margin=${margin_mm.toFixed(1)} viewBox=${`${-reach_mm} ${-reach_mm} ${2 * reach_mm} ${2 * reach_mm}`} role="img" aria-label=${`${feet.filter((foot) => foot.isDown).length} of ${feet.length} feet on the ground; the middle is ${words}`}>
      <polygon class=${margin_mm > 0 ? "stands" : "tips"} points=${polygon.map(across).join(" ")} />
      ${feet.map(({ at_mm, isDown }, index) => html`<circle key=${index} class=${isDown ? "foot-down" : "foot-up"} cx=${-at_mm[1]} cy=${-at_mm[0]} r=${reach_mm / 24} />`)}
      <path class="middle" d=${`M ${-reach_mm / 16} 0 H ${reach_mm / 16} M 0 ${-reach_mm / 16} V ${reach_mm / 16}`} /></svg>
    <p class=${margin_mm > 0 ? "" : "warn-text"}>The middle is ${words} (estimate, without the masses).</p>
    <p class="muted">Least of the show: ${least.margin_mm === -Infinity ? "fewer than three feet down" : `${least.margin_mm.toFixed(0)} mm`}
      <${Small} name="Go there" text=${timeText(least.at_s, 0.01)} run=${() => actions.moveTo(least.at_s)} /></p></${Section}>`;
}
