// @ts-check
/** The Timeline page: keys to shape the show by, its plan, what was read while it plays, the figure. */

import { html, useEffect, useRef } from "../vendor/preact.js";
import { Contents } from "../contents/panel.js";
import { bring } from "../contents/sound.js";
import { FigurePanel } from "../figure/panel.js";
import { Mirror } from "../mirror.js";
import { Choice } from "../parts/choice.js";
import { Menu } from "../parts/menu.js";
import { whyNoPlan } from "../parts/text.js";
import { TimelineBoard } from "../timeline/board.js";
import { timeText } from "../timeline/window.js";
import { About } from "./about.js";

/** @typedef {import("../state.js").State} State */
/** @typedef {{ state: State, actions: import("../actions.js").Actions, store: import("../store.js").Store }} Props */

const SIDES = /** @type {const} */ ([["chosen", "Chosen"], ["contents", "Contents"]]);
/** The motions that are drawn over each other. */
const GHOSTS = /** @type {const} */ ([
  ["authored", "authored", "What the author asks for, where the plan is another"],
  ["plan", "plan", "The motion within all limits"],
  ["predicted", "horn", "Where the horn is predicted to be"],
  ["reading", "read", "What was read in the last run"],
]);
const ORDERS = ["Angle", "Speed", "Acceleration"];

/** @param {Props} props */
export function TimelinePage({ state, actions, store }) {
  const place = useRef(/** @type {HTMLDivElement | null} */ (null));
  useEffect(() => {
    if (place.current === null) return undefined;
    const board = new TimelineBoard(place.current, store, actions);
    actions.board = board;
    return () => {
      actions.board = null;
      board.dispose();
    };
  }, []);
  useEffect(() => actions.board?.setTheme(), [state.theme]);
  /** @param {DragEvent} event */
  const drop = (event) => {
    event.preventDefault();
    if (event.dataTransfer !== null && state.welcome?.role === "edit") void bring(actions, event.dataTransfer.files);
  };
  return html`<main class="page timeline" onDragOver=${(/** @type {DragEvent} */ event) => event.preventDefault()} onDrop=${drop}>
    <section class="board-card">
      ${state.view === null ? html`<p class="board-why">${whyNoPlan(state)}</p>` : html`<${Tools} state=${state} actions=${actions} />`}
      <div class="board" ref=${place}></div>
      <${Mirror} state=${state} actions=${actions} />
    </section>
    <aside class="side">
      <section class="card" aria-label="Figure"><${FigurePanel} store=${store} isSought /></section>
      <section class="card about" aria-label="What is chosen" aria-live=${state.side === "chosen" ? "polite" : "off"}>
        <${Choice} label="beside the timeline" options=${SIDES} chosen=${state.side} choose=${(/** @type {State["side"]} */ side) => actions.set({ side })} />
        <div class="scroll about-part">${state.side === "chosen" ? html`<${About} state=${state} actions=${actions} />` : html`<${Contents} state=${state} actions=${actions} />`}</div></section>
    </aside>
    <${Menu} state=${state} actions=${actions} />
  </main>`;
}

/** @param {{ state: State, actions: import("../actions.js").Actions }} props */
function Tools({ state, actions }) {
  return html`<div class="tools" role="toolbar" aria-label="Timeline">
    <span class="segments" role="radiogroup" aria-label="Curves">
      ${ORDERS.map((name, order) => html`<button type="button" role="radio" aria-checked=${state.order === order}
        onClick=${() => actions.run(`order_${order}`)}>${name}</button>`)}</span>
    <button type="button" aria-label="Zoom out" onClick=${() => actions.run("zoom_out")}>−</button>
    <button type="button" aria-label="Zoom in" onClick=${() => actions.run("zoom_in")}>+</button>
    <button type="button" onClick=${() => actions.run("fit")}>Fit</button>
    <button type="button" aria-pressed=${state.follow} onClick=${() => actions.run("follow")}>Follow</button>
    <button type="button" aria-pressed=${state.ripple} title="Later keys move, too" onClick=${() => actions.run("ripple")}>Ripple</button>
    <button type="button" aria-pressed=${state.live} title="What is checked is taken into the show that plays, where it can be" onClick=${() => actions.run("live")}>Live</button>
    <${Edits} state=${state} actions=${actions} />
    <span class="cursor-time">cursor <output>${timeText(state.cursor_s, 0.001)}</output></span>
    <${Legend} state=${state} actions=${actions} />
  </div>`;
}

/** What a person does with the whole text, and whether what is seen was checked.
 * @param {{ state: State, actions: import("../actions.js").Actions }} props */
function Edits({ state, actions }) {
  const own = state.document;
  if (own === null || state.view === null) return null;
  const { undo, redo, unsaved } = own.editing;
  return html`<span class="edits">
    <button type="button" disabled=${undo === null} title=${`Undo ${undo ?? ""}`} onClick=${() => actions.run("undo")}>Undo</button>
    <button type="button" disabled=${redo === null} title=${`Redo ${redo ?? ""}`} onClick=${() => actions.run("redo")}>Redo</button>
    <button type="button" disabled=${unsaved.length === 0} title=${unsaved.join(", ")} onClick=${() => actions.run("save")}>Save</button>
    <${Badge} state=${state} own=${own} view=${state.view} /></span>`;
}

/** Draft or checked, in a word: only what is checked is played, and what is checked is what is seen.
 * @param {{ state: State, own: import("../state.js").Document, view: import("../state.js").View }} props */
function Badge({ state, own, view }) {
  if (own.errors.length > 0) return html`<span class="chip chip-bad" role="status">▲ not checked: an error</span>`;
  const isSeen = own.is_current && view.revision === own.revision;
  if (state.drafts > 0 || state.is_dragging || !isSeen) return html`<span class="chip chip-busy" role="status">◇ draft</span>`;
  const slowed = view.stretched.length === 0 ? "" : `, ${view.stretched.length} slowed`;
  return html`<span class=${`chip ${slowed === "" ? "chip-good" : "chip-warn"}`} role="status">✓ checked${slowed}</span>`;
}

/** What the colours are; the motions can be switched. @param {{ state: State, actions: import("../actions.js").Actions }} props */
function Legend({ state, actions }) {
  const view = state.view;
  /** @type {[string, string][]} */
  const all = [["limit", "limit"]];
  if (view?.stretched.length) all.push(["stretched", "slowed"]);
  if (view?.given_up.length) all.push(["given-up", "angle given up"]);
  return html`<ul class="legend" aria-label="Legend">
    ${GHOSTS.map(([name, text, title]) => html`<li key=${name}><button type="button" class="plain ghost" aria-pressed=${state.ghosts[name]} title=${title}
      onClick=${() => actions.set({ ghosts: { ...state.ghosts, [name]: !state.ghosts[name] } })}><i class=${`swatch swatch-${name}`}></i>${text}</button></li>`)}
    ${all.map(([name, text]) => html`<li key=${name}><i class=${`swatch swatch-${name}`}></i>${text}</li>`)}
    <li><i class="swatch swatch-key"></i>key</li><li><i class="swatch swatch-anchor"></i>anchor</li></ul>`;
}
