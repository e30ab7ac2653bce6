// @ts-check
/**
 * The timeline for keyboard and screen reader: a grid off the screen with the rows and keys of the
 * same layout. It holds the keys near the chosen one only, however long the show is.
 */

import { html } from "./vendor/preact.js";
import { isChosen } from "./timeline/keys.js";
import { layoutOf, walkedRows } from "./timeline/layout.js";
import { timeText } from "./timeline/window.js";

/** Keys on both sides of the chosen one. */
const AROUND = 8;

/** @param {{ state: import("./state.js").State, actions: import("./actions.js").Actions }} props */
export function Mirror({ state, actions }) {
  const { view, row, selection } = state;
  if (view === null) return null;
  const rows = walkedRows(layoutOf(view));
  const chosen = selection?.kind === "keys" ? selection.keys : null;
  return html`<div class="mirror" role="grid" tabindex="0" id="mirror"
    aria-label=${`Timeline of ${view.name}: rows are lanes and joints, cells are keys`}
    aria-rowcount=${rows.length} aria-activedescendant=${chosen === null ? `row-${row}` : "chosen-key"}>
    ${rows.map((own, index) => html`<div role="row" id=${`row-${index}`} key=${`${own.kind}-${own.index}`}
      aria-rowindex=${index + 1} aria-selected=${index === row}>
      <span role="rowheader">${nameOf(view, own)}</span>
      ${index === row ? cellsOf(view, own, state).map((cell, _, all) => html`<span role="gridcell"
        key=${cell.key} aria-colindex=${cell.index + 1} id=${cell === all.find((one) => one.isChosen) ? "chosen-key" : undefined}
        aria-selected=${cell.isChosen} onClick=${() => {
          actions.editor.choose([cell.ref]);
          actions.moveTo(cell.at_s);
        }}>${cell.text}</span>`) : null}
    </div>`)}
  </div>`;
}

/** @param {import("./state.js").View} view @param {import("./timeline/layout.js").Row} row */
function nameOf(view, row) {
  if (row.kind === "lane") return `${view.lanes[row.index]?.kind} ${row.name}, ${view.lanes[row.index]?.keys.length} keys`;
  const joint = view.joints[row.index];
  const error = view.error[row.name];
  return `joint ${row.name}, range ${joint?.range_deg.join(" to ")} deg, at most ${joint?.speed_max_deg_s} deg/s, ` +
    `horn at most ${error?.max_deg.toFixed(2)} deg off`;
}

/** @param {import("./state.js").View} view @param {import("./timeline/layout.js").Row} row
 * @param {import("./state.js").State} state */
function cellsOf(view, row, state) {
  const { selection, cursor_s } = state;
  const keys = row.kind === "joint"
    ? (view.keys[row.name] ?? []).map((key) => ({ at_s: key.at_s, lane: key.lane, key: key.key, text: `${key.deg} deg` }))
    : (view.lanes[row.index]?.keys ?? []).map((key, index) => (
      { at_s: key.at_s, lane: row.index, key: index, text: `${key.label} ${Object.keys(key.deg).length} joints`.trim() }));
  const chosen = selection?.kind === "keys" ? selection.keys : [];
  const joint = row.kind === "joint" ? row.name : null;
  const isOneChosen = (/** @type {{ lane: number, key: number }} */ key) => isChosen(chosen, key.lane, key.key, joint);
  let middle = keys.findIndex(isOneChosen);
  if (middle < 0) middle = Math.max(keys.findIndex((key) => key.at_s >= cursor_s), 0);
  const first = Math.max(middle - AROUND, 0);
  return keys.slice(first, middle + AROUND + 1).map((key, offset) => {
    const own = view.lanes[key.lane]?.keys[key.key];
    const more = [own?.is_anchor ? "anchor" : "", own?.hold_s ? `held ${own.hold_s.toFixed(2)} s` : ""].filter(Boolean).join(", ");
    return {
      key: `${key.lane}-${key.key}`, index: first + offset, at_s: key.at_s, isChosen: isOneChosen(key),
      ref: { lane: key.lane, key: key.key, joint },
      text: `${timeText(key.at_s, 0.001)}: ${key.text}${more ? `, ${more}` : ""}`,
    };
  });
}
