// @ts-check
/** The pose at the cursor as sliders: the figure follows while one is dragged, and letting go makes a key. */

import { html } from "../vendor/preact.js";
import { angleAt } from "../curves.js";
import { number } from "../numbers.js";
import { timeText } from "../timeline/window.js";

const STEP_DEG = 0.5;

/** @param {{ state: import("../state.js").State, actions: import("../actions.js").Actions }} props */
export function PoseSliders({ state, actions }) {
  const { view, cursor_s, posed, welcome } = state;
  if (view === null || welcome?.role !== "edit" || actions.isRunning) return null;
  const joints = view.joints.filter((joint) => (view.keys[joint.name] ?? []).some((key) => !key.is_added));
  if (joints.length === 0) return null;
  return html`<h2>Pose at ${timeText(cursor_s, 0.001)}</h2>
    <p class="muted">Move a slider: letting go makes a key there.</p>
    <div class="pose">${joints.map(({ name, range_deg }) => {
      const curve = view.curves[name]?.plan;
      const deg = posed?.[name] ?? (curve === undefined ? 0 : angleAt(curve, cursor_s));
      return html`<label key=${name}><span>${name}</span><input type="range" data-pose=${name} min=${range_deg[0]} max=${range_deg[1]} step=${STEP_DEG} value=${deg}
        aria-valuetext=${`${number(deg, 1)} degrees`}
        onInput=${(/** @type {Event} */ event) => actions.set({ posed: { ...state.posed, [name]: valueOf(event) } })}
        onChange=${(/** @type {Event} */ event) => {
          actions.set({ posed: null });
          actions.editor.pose(name, valueOf(event));
        }} /><output class="number">${number(deg, 1)}°</output></label>`;
    })}</div>`;
}

/** @param {Event} event */
function valueOf(event) {
  return Number(/** @type {HTMLInputElement} */ (event.currentTarget).value);
}
