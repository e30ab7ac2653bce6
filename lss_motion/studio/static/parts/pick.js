// @ts-check
/** One of many, as a list that folds out in its place: what a browser drops down would cover STOP. */

import { html, useRef } from "../vendor/preact.js";

/** @param {{ label: string, options: readonly string[], chosen: string, choose: (option: string) => void }} props */
export function Pick({ label, options, chosen, choose }) {
  const place = useRef(/** @type {HTMLDetailsElement | null} */ (null));
  /** @param {string} option */
  const take = (option) => {
    if (place.current !== null) place.current.open = false;
    choose(option);
  };
  return html`<details class="pick" ref=${place}><summary aria-label=${`${label}: ${chosen}`}>${chosen}</summary>
    <div role="group" aria-label=${label}>${options.map((option) => html`<button type="button" key=${option} class="plain"
      aria-pressed=${option === chosen} onClick=${() => take(option)}>${option}</button>`)}</div></details>`;
}
