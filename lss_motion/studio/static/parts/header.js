// @ts-check
/** The head of every page: what is open, the pages, who operates, the state, and what is wrong. */

import { html } from "../vendor/preact.js";
import { Tour } from "../contents/files.js";
import { stateOf } from "../states.js";
import { FileLine, silenceOf } from "./text.js";

/** @typedef {{ state: import("../state.js").State, actions: import("../actions.js").Actions }} Props */

const PAGES = /** @type {const} */ ([["show", "Show"], ["timeline", "Timeline"], ["robot", "Robot"]]);

/** @param {Props} props */
export function Header({ state, actions }) {
  const { document: own, player } = state;
  const { tone } = stateOf(state);
  const title = own?.title || state.view?.name || state.welcome?.title || "studio";
  return html`<header class="head">
    <div class="head-title">
      <strong class="name" title=${title}>${title}</strong>
      ${state.welcome?.role === "view" ? html`<span class="muted name" title=${own?.file ?? ""}>${own?.file ?? ""}</span>`
        : html`<button type="button" class="plain name" title="Open, new, duplicate" aria-label=${`Files: ${own?.file ?? ""}`} onClick=${() => actions.set({ dialog: { kind: "files" } })}>${own?.file || "Files"} ▾</button>`}
    </div>
    <nav role="tablist" aria-label="Pages">
      ${PAGES.map(([page, name]) => html`<button role="tab" type="button" class="tab" aria-selected=${state.page === page}
        onClick=${() => actions.set({ page })}>${name}</button>`)}
    </nav>
    <div class="head-end">
      <${Operator} state=${state} actions=${actions} />
      <button type="button" class="plain" onClick=${() => actions.run("theme")}
        aria-label=${state.theme === "dark" ? "Light theme" : "Dark theme"}>${state.theme === "dark" ? "☀" : "☾"}</button>
      <button type="button" class="plain" onClick=${() => actions.run("help")} aria-label="Keys">?</button>
    </div>
    <div class=${`head-state tone-${tone}`}><${StateLine} state=${state} />
      ${player.latch === null || state.link.status === "lost" ? null : html`<button type="button" class="rearm" disabled=${player.state === "stopping"}
        onClick=${() => actions.askRearm()}>Arm again…</button>`}
      <span class="chips">
        ${own?.is_planning ? html`<${Planning} planning_s=${own.planning_s} />` : null}
        ${own && own.errors.length > 0 ? html`<span class="chip chip-bad">▲ ${own.errors.length === 1 ? "1 error" : `${own.errors.length} errors`} in the file</span>` : null}
        ${own && !own.is_current && !own.is_planning && own.plan ? html`<span class="chip chip-warn">◆ the last good plan is shown</span>` : null}
        ${state.robot_state?.is_simulated ? html`<span class="chip">simulated robot</span>` : null}
      </span></div>
  </header>`;
}

/** That the file is planned; and since when, where the planner may stand still. @param {{ planning_s: number }} props */
function Planning({ planning_s }) {
  const text = silenceOf(planning_s);
  return html`<span class=${`chip ${text === "" ? "chip-busy" : "chip-warn"}`} role="status">${text === "" ? "planning…" : `◆ ${text}`}</span>`;
}

/** The state in its word and its colour, and what a person needs to know besides.
 * @param {{ state: import("../state.js").State }} props */
export function StateLine({ state }) {
  const { name, word, tone, sign, detail } = stateOf(state);
  return html`<p class=${`state tone-${tone}`} role=${tone === "bad" ? "alert" : "status"} data-state=${name}><span class="state-sign" aria-hidden="true">${sign}</span>
    <span class="word">${word}</span>${detail === "" ? null : html`<span class="state-detail">${detail}</span>`}</p>`;
}

/** Who operates. @param {Props} props */
function Operator({ state, actions }) {
  const { lease, welcome, clients } = state;
  if (welcome === null) return null;
  const watching = clients > 1 ? ` · ${clients} clients` : "";
  const pair = welcome.role === "edit"
    ? html`<button type="button" class="plain" onClick=${() => actions.pair("operate")}>Pair a tablet</button>` : null;
  if (lease.is_mine) {
    return html`<span class="operator"><span class="chip chip-busy">● you operate${watching}</span>${pair}
      <button type="button" class="plain" onClick=${() => actions.link.ask("lease", { want: "release" })}>Release</button></span>`;
  }
  const who = lease.holder === null ? "no operator" : `${lease.holder_name} operates`;
  return html`<span class="operator"><span class="chip">○ ${who}${watching}</span>
    ${welcome.role === "view" ? html`<span class="muted">you may look, and stop</span>`
      : html`<button type="button" class="plain" onClick=${() => actions.withLease(() => actions.link.ask("lease", { want: "take" }))}>Operate</button>`}${pair}</span>`;
}

/** A file that is edited here and was changed elsewhere: nothing is overwritten before a person has chosen.
 * @param {Props & { file: string, difference: string[] }} props */
function ChangedOnDisk({ state, actions, file, difference }) {
  /** @param {"ours" | "disk"} what */
  const keep = (what) => actions.link.ask("disk.keep", { revision: state.document?.revision ?? 0, file, what });
  return html`<div class="banner banner-warn" role="alert"><p>${file} was changed on disk while it is edited here; it is not overwritten.
      <button type="button" onClick=${() => keep("ours")}>Keep what is here</button>
      <button type="button" onClick=${() => keep("disk")}>Take what is on disk</button></p>
    <details><summary>What differs</summary><pre class="difference">${difference.join("\n")}</pre></details></div>`;
}

/** What stands above the page besides the state: what was refused, errors of the file. @param {Props} props */
export function Banners({ state, actions }) {
  const { player, document: own, welcome, refusal } = state;
  return html`<div class="banners">
    <${Tour} state=${state} actions=${actions} />
    ${refusal ? html`<p class=${`banner ${refusal.is_hint ? "banner-note" : "banner-warn"}`} role="alert" key=${refusal.number}>${refusal.is_hint ? "" : "✕ "}${refusal.text}
      <button type="button" onClick=${() => actions.set({ refusal: null })}>Close</button></p>` : null}
    ${own?.errors.map((error) => html`<p class="banner banner-warn" role="status"><${FileLine} actions=${actions} file=${error.path} line=${error.line} /> ${error.text}</p>`)}
    ${own?.editing.conflicts.map((one) => html`<${ChangedOnDisk} key=${one.file} ...${{ state, actions, ...one }} />`)}
    ${own !== null && own.editing.recovered.length > 0
      ? html`<p class="banner banner-note" role="status">Edits that were not saved were found again: ${own.editing.recovered.join(", ")}. Save keeps them, Undo gives them up.</p>` : null}
    ${actions.isRunning && player.plan !== null && own?.plan != null && own.plan !== player.plan
      ? html`<p class="banner banner-note" role="status">The file has changed since START: what plays is as it was; times, cues and curves shown are the new ones. The next START plays them.
          <button type="button" disabled=${!own.is_current} onClick=${() => actions.splice()}>Play the edit now</button></p>` : null}
    ${welcome?.is_network_readable ? html`<p class="banner banner-note">This link has no TLS: others on the network can read along.</p>` : null}
  </div>`;
}
