// @ts-check
/** The small fields of which the contents are made. */

import { html, useState } from "../vendor/preact.js";

/** A part of the contents, folded or not. @param {{ title: string, count?: number | undefined, children?: unknown }} props */
export function Section({ title, count, children }) {
  return html`<details class="part" open><summary><h2>${title}${count ? html` <span class="muted">${count}</span>` : null}</h2></summary>${children}</details>`;
}

/** @param {{ name: string, run: () => void, text?: string, isOn?: boolean | undefined, isOff?: boolean | undefined }} props */
export function Small({ name, run, text, isOn, isOff }) {
  return html`<button type="button" class="small-button" aria-label=${name} title=${name} aria-pressed=${isOn} disabled=${isOff} onClick=${run}>${text ?? name}</button>`;
}

/** A number by a slider: it is taken when it is let go.
 * @param {{ name: string, unit: string, value: number, least: number, most: number, step: number, set: (value: number) => void, show?: (value: number) => void }} props */
export function Slider({ name, unit, value, least, most, step, set, show }) {
  const [tried, setTried] = useState(/** @type {number | null} */ (null));
  const shown = tried ?? value;
  return html`<label class="slider"><span>${name}</span><input type="range" data-slider=${name} min=${least} max=${most} step=${step} value=${shown}
    onInput=${(/** @type {Event} */ event) => {
      setTried(valueOf(event));
      show?.(valueOf(event));
    }}
    onChange=${(/** @type {Event} */ event) => {
      setTried(null);
      set(valueOf(event));
    }} /><output class="number">${Number(shown.toFixed(3))} ${unit}</output></label>`;
}

/** @param {Event} event */
function valueOf(event) {
  return Number(/** @type {HTMLInputElement} */ (event.currentTarget).value);
}
