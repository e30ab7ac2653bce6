// @ts-check
/** What is at a point of the timeline. Pure; shares its rows with the drawing. */

import { lowerBound } from "../curves.js";
import { pixelOf, timeAt } from "./window.js";

/** @typedef {import("../state.js").View} View */
/** @typedef {import("./layout.js").Row} Row */
/** @typedef {import("./window.js").Window} Window */

/** Reach of a key to both sides: 12 px wide by mouse, 44 by touch. */
export const REACH_PX = 6;
export const TOUCH_REACH_PX = 22;

/**
 * @typedef {{ x_px: number, y_px: number, reach_px: number,
 *   yOf?: (row: Row, key: import("../state.js").JointKey) => number }} Point `yOf`: where the keys of
 * joints stand; without it they are as high as their row
 */
/**
 * @typedef {{ kind: "ruler", at_s: number }
 *   | { kind: "key", lane: number, key: number, joint: string | null, at_s: number }
 *   | { kind: "handle", lane: number, key: number, joint: string, side: 1 | -1, at_s: number }
 *   | { kind: "span", list: "stretched" | "given_up", index: number, at_s: number }
 *   | { kind: "event", event: number, at_s: number }
 *   | { kind: "mark", label: string, at_s: number }
 *   | { kind: "row", row: Row, at_s: number }
 *   | { kind: "nothing", at_s: number }} Hit
 */

/**
 * Return what is at a point. @param {View} view @param {Row[]} rows in sight @param {Window} seen
 * @param {Point} point @returns {Hit}
 */
export function hitAt(view, rows, seen, point) {
  const at_s = timeAt(seen, point.x_px);
  const row = rows.find((own) => point.y_px >= own.y_px && point.y_px < own.y_px + own.height_px);
  if (row === undefined) return { kind: "nothing", at_s };
  if (row.kind === "ruler") return { kind: "ruler", at_s };
  if (row.kind === "marks") {
    const index = nearest(view.marks.map((mark) => mark.at_s), seen, point);
    const mark = view.marks[index];
    if (mark !== undefined) return { kind: "mark", label: mark.label, at_s: mark.at_s };
  }
  if (row.kind === "events") {
    const event = nearest(view.events.map((own) => own.at_s), seen, point);
    const own = view.events[event];
    if (own !== undefined) return { kind: "event", event, at_s: own.at_s };
  }
  if (row.kind === "lane") {
    const lane = /** @type {import("../state.js").Lane} */ (view.lanes[row.index]);
    const key = nearest(lane.times_s, seen, point);
    const own = lane.keys[key];
    if (own !== undefined) return { kind: "key", lane: row.index, key, joint: null, at_s: own.at_s };
  }
  if (row.kind === "joint") return hitJoint(view, row, seen, point);
  return { kind: "row", row, at_s };
}

/** @param {View} view @param {Row} row @param {Window} seen
 * @param {Point} point @returns {Hit} */
function hitJoint(view, row, seen, point) {
  const at_s = timeAt(seen, point.x_px);
  const keys = view.keys[row.name] ?? [];
  const found = keys[nearest(keys.map((key) => key.at_s), seen, point)];
  const off_px = found === undefined || point.yOf === undefined ? 0 : Math.abs(point.yOf(row, found) - point.y_px);
  if (found !== undefined && off_px <= point.reach_px) {
    return { kind: "key", lane: found.lane, key: found.key, joint: row.name, at_s: found.at_s };
  }
  for (const list of /** @type {const} */ (["stretched", "given_up"])) {
    const margin_s = REACH_PX / seen.px_per_s;
    const index = view[list].findIndex(
      (span) => span.joint === row.name && at_s >= span.from_s - margin_s && at_s <= span.to_s + margin_s,
    );
    if (index >= 0) return { kind: "span", list, index, at_s };
  }
  return { kind: "row", row, at_s };
}

/** Return the index of the nearest instant within reach, or -1.
 * @param {ArrayLike<number>} times_s sorted @param {Window} seen
 * @param {{ x_px: number, reach_px: number }} point */
function nearest(times_s, seen, point) {
  const after = lowerBound(times_s, timeAt(seen, point.x_px));
  let best = -1;
  let best_px = point.reach_px;
  for (const index of [after - 1, after]) {
    const own_s = times_s[index];
    if (own_s === undefined) continue;
    const away_px = Math.abs(pixelOf(seen, own_s) - point.x_px);
    if (away_px <= best_px) {
      best = index;
      best_px = away_px;
    }
  }
  return best;
}
