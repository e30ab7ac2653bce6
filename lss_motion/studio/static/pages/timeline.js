// @ts-check
/** The Timeline page: the plan to look at, with what was read while it plays, and the figure. */

import { html, useEffect, useRef } from "../vendor/preact.js";
import { angleAt, valueAt } from "../curves.js";
import { Mirror } from "../mirror.js";
import { number } from "../numbers.js";
import { FigurePanel } from "../figure/panel.js";
import { TimelineBoard } from "../timeline/board.js";
import { FileLine, whyNoPlan } from "../parts/text.js";
import { timeText } from "../timeline/window.js";

/** @typedef {import("../state.js").State} State */
/** @typedef {{ state: State, actions: import("../actions.js").Actions, store: import("../store.js").Store }} Props */

const ORDERS = ["Angle", "Speed", "Acceleration"];

/** @param {Props} props */
export function TimelinePage({ state, actions, store }) {
  const place = useRef(/** @type {HTMLDivElement | null} */ (null));
  useEffect(() => {
    if (place.current === null) return undefined;
    const board = new TimelineBoard(place.current, store, () => actions.run("shows_only"));
    actions.board = board;
    return () => {
      actions.board = null;
      board.dispose();
    };
  }, []);
  useEffect(() => actions.board?.setTheme(), [state.theme]);
  return html`<main class="page timeline">
    <section class="board-card">
      <${Tools} state=${state} actions=${actions} />
      <div class="board" ref=${place}></div>
      <${Mirror} state=${state} actions=${actions} />
    </section>
    <aside class="side">
      <section class="card" aria-label="Figure"><${FigurePanel} store=${store} isSought /></section>
      <section class="card about" aria-label="What is chosen" aria-live="polite"><${About} state=${state} actions=${actions} /></section>
    </aside>
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
    <span class="cursor-time">cursor <output>${timeText(state.cursor_s, 0.001)}</output></span>
    <${Legend} state=${state} />
  </div>`;
}

/** @param {{ state: State }} props */
function Legend({ state }) {
  const view = state.view;
  /** @type {[string, string][]} */
  const all = [["plan", "plan"], ["reading", "read"], ["predicted", "predicted error"], ["limit", "limit"]];
  if (view?.stretched.length) all.push(["stretched", "slowed"], ["authored", "authored"]);
  if (view?.given_up.length) all.push(["given-up", "angle given up"]);
  return html`<ul class="legend" aria-label="Legend">${all.map(([name, text]) => html`<li key=${name}><i class=${`swatch swatch-${name}`}></i>${text}</li>`)}
    <li><i class="swatch swatch-key"></i>key</li><li><i class="swatch swatch-anchor"></i>anchor</li></ul>`;
}

/** What is chosen, in words. @param {{ state: State, actions: import("../actions.js").Actions }} props */
function About({ state, actions }) {
  const { view, selection } = state;
  if (view === null) return html`<p class="muted">${whyNoPlan(state)}</p>`;
  if (selection?.kind === "key") {
    const key = view.lanes[selection.lane]?.keys[selection.key];
    return key === undefined ? null : html`<${AboutKey} view=${view} own=${key} lane=${view.lanes[selection.lane]} actions=${actions} />`;
  }
  if (selection?.kind === "span") {
    const span = view[selection.list][selection.index];
    const title = selection.list === "stretched" ? "Slowed" : "Angle given up";
    return span === undefined ? null : html`<h2>${title}</h2><p>${span.text}</p>`;
  }
  return html`<${AboutPlan} state=${state} actions=${actions} />`;
}

/** @param {{ view: import("../state.js").View, own: import("../state.js").Key, lane: import("../state.js").Lane | undefined, actions: import("../actions.js").Actions }} props */
function AboutKey({ view, own, lane, actions }) {
  const late_s = own.authored_s === null ? 0 : own.at_s - own.authored_s;
  return html`<h2>${own.is_anchor ? "Anchor" : "Key"} ${own.label}</h2>
    <p>at ${timeText(own.at_s, 0.001)}${Math.abs(late_s) > 5e-4 ? html`, <strong class="warn-text">${late_s.toFixed(3)} s later than authored</strong>` : null}
      ${own.line === null || !lane?.file ? "" : html`, <${FileLine} actions=${actions} file=${lane.file} line=${own.line} />`}, ${lane?.kind} ${lane?.name}, ease ${own.ease}${own.hold_s > 0 ? `, held ${own.hold_s.toFixed(2)} s` : ""}</p>
    <table class="small"><thead><tr><th>joint</th><th>key</th><th>plan</th><th>deg/s</th></tr></thead><tbody>
      ${Object.entries(own.deg).map(([joint, deg]) => {
        const curve = view.curves[joint]?.plan;
        if (curve === undefined) return null;
        return html`<tr key=${joint}><th scope="row">${joint}</th><td class="number">${lane?.is_added && deg > 0 ? "+" : ""}${String(deg).replace("-", "−")}</td>
          <td class="number">${number(angleAt(curve, own.at_s), 2)}</td><td class="number">${number(valueAt(curve, own.at_s, 1), 1)}</td></tr>`;
      })}</tbody></table>`;
}

/** @param {{ state: State, actions: import("../actions.js").Actions }} props */
function AboutPlan({ state, actions }) {
  const { view } = state;
  if (view === null) return null;
  const spans = /** @type {const} */ (["stretched", "given_up"]);
  return html`<h2>${view.name}</h2>
    <p class="muted">${view.joints.length} joints, ${view.lanes.reduce((sum, lane) => sum + lane.keys.length, 0)} keys, ${view.is_endless ? "without end" : timeText(view.duration_s ?? 0, 0.1)}</p>
    ${spans.every((list) => view[list].length === 0) ? html`<p>Nothing is slowed, no angle is given up.</p>` : null}
    <ul class="reasons scroll">${spans.flatMap((list) => view[list].map((span, index) => html`<li key=${`${list}-${index}`}>
      <button type="button" class="plain" onClick=${() => {
        actions.set({ selection: { kind: "span", list, index } });
        actions.moveTo(span.from_s);
      }}>${span.text}</button></li>`))}</ul>
    ${state.document?.notes.map((note) => html`<p class="muted">${note}</p>`)}`;
}
