// @ts-check
/** Every question, and help: STOP works above them, by key and by the buttons. */

import { html, useLayoutEffect, useRef, useState } from "../vendor/preact.js";
import { Files } from "../contents/files.js";
import { KEYMAP, STOP_KEYS } from "../keymap.js";
import { Puppet } from "../pages/puppet.js";
import { Choice } from "./choice.js";
import { FileText } from "./text.js";

/** @typedef {{ state: import("../state.js").State, actions: import("../actions.js").Actions }} Props */

/** @param {Props} props */
export function Dialogs({ state, actions }) {
  const { dialog } = state;
  if (dialog === null) return null;
  const close = () => actions.set({ dialog: null });
  if (dialog.kind === "help") return html`<${Box} title="Keys" close=${close}><${Help} /></${Box}>`;
  if (dialog.kind === "files") return html`<${Box} title="Files" close=${close}><${Files} state=${state} actions=${actions} /></${Box}>`;
  if (dialog.kind === "puppet") return html`<${Box} title="Puppeteer" close=${close}><${Puppet} state=${state} actions=${actions} /></${Box}>`;
  if (dialog.kind === "text") {
    const file = dialog.file ?? "";
    return html`<${Box} title=${file} close=${close}><${FileText} ...${{ state, actions, file }} line=${dialog.line ?? null} /></${Box}>`;
  }
  if (dialog.kind === "pairing" && state.pairing !== null) {
    return html`<${Box} title="Pair another device" close=${close}><${Pairing} pairing=${state.pairing} actions=${actions} /></${Box}>`;
  }
  return html`<${Box} title=${dialog.title ?? "Sure?"} close=${close} yes=${dialog.yes ?? "Yes"} run=${dialog.run}>
    <p>${dialog.text}</p></${Box}>`;
}

/**
 * It is not modal for the browser: what is modal makes the rest inert, and STOP with it.
 * @param {{ title: string, close: () => void, yes?: string, run?: () => void, children?: unknown }} props
 */
function Box({ title, close, yes, run, children }) {
  const box = useRef(/** @type {HTMLDialogElement | null} */ (null));
  useLayoutEffect(() => {
    const before = document.activeElement;
    box.current?.querySelector("button")?.focus({ preventScroll: true });
    return () => { if (before instanceof HTMLElement) before.focus(); };
  }, []);
  return html`<div class="veil"><dialog open ref=${box} aria-labelledby="dialog-title">
    <h2 id="dialog-title">${title}</h2>
    ${children}
    <div class="dialog-buttons">
      <button type="button" onClick=${close}>${run ? "No" : "Close"}</button>
      ${run ? html`<button type="button" class="primary" onClick=${() => { close(); run(); }}>${yes}</button>` : null}
    </div></dialog></div>`;
}

function Help() {
  const [sought, setSought] = useState("");
  const isSought = (/** @type {import("../keymap.js").Binding} */ { text, keys }) => (
    text !== "" && `${text} ${keys.join(" ")}`.toLowerCase().includes(sought.toLowerCase()));
  return html`<label class="field"><span>search</span> <input type="search" value=${sought}
      onInput=${(/** @type {Event} */ event) => setSought(/** @type {HTMLInputElement} */ (event.currentTarget).value)} /></label>
  <table class="keys"><tbody>
    ${[...STOP_KEYS, ...KEYMAP].filter(isSought).map((one) => html`<tr key=${one.action}>
      <th scope="row">${one.keys.map((key) => html`<kbd>${key.replace("Arrow", "")}</kbd> `)}</th>
      <td>${one.text}${one.pages ? html` <span class="muted">(${one.pages.join(", ")})</span>` : null}</td></tr>`)}
  </tbody></table>
  <p class="muted">Timeline: click a key, Shift-click more, or draw a box; drag them, with Ctrl to what is near (keys, labels, cursor, grid), with Shift ten times as fine. Right click or a long touch: the menu. Wheel scrolls, Ctrl and wheel zooms, Shift and wheel or the middle button pans; drag the ruler for the cursor.</p>`;
}

/** What a role may, as a person says it. */
const ROLES = /** @type {const} */ ([["view", "look and stop"], ["operate", "operate, too"], ["edit", "also save and pair"]]);

/** @param {{ pairing: NonNullable<import("../state.js").State["pairing"]>, actions: import("../actions.js").Actions }} props */
function Pairing({ pairing, actions }) {
  return html`<p class="code" aria-label="Code">${pairing.code}</p>
    <p>Open one of these addresses there and type the code. It is valid once, for ${Math.round(pairing.valid_s / 60)} minutes.</p>
    <div class="choices">That device may <${Choice} label="That device may" options=${ROLES} chosen=${pairing.role}
      choose=${(/** @type {string} */ role) => actions.pair(role)} /></div>
    <p class="muted">Another choice makes a new code.</p>
    <ul>${pairing.urls.map((url) => html`<li><code>${url}</code></li>`)}</ul>`;
}
