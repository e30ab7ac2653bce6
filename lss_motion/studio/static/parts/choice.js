// @ts-check
/** One of few, as buttons side by side. A list that drops down would cover STOP on a tablet. */

import { html } from "../vendor/preact.js";

/**
 * @template T
 * @param {object} props
 * @param {string} props.label
 * @param {(readonly [T, string])[]} props.options each with its words
 * @param {T} props.chosen
 * @param {(value: T) => void} props.choose
 * @param {boolean} [props.disabled]
 */
export function Choice({ label, options, chosen, choose, disabled }) {
  return html`<div role="group" aria-label=${label} class="choice">
    ${options.map(([value, words]) => html`<button type="button" key=${words} aria-pressed=${value === chosen}
      disabled=${disabled} onClick=${() => choose(value)}>${words}</button>`)}
  </div>`;
}
