// @ts-check
/** Where a dragged instant or angle comes to rest: at what is near, or at an even number. Pure. */

import { lowerBound } from "../curves.js";

/** @typedef {{ at_s: number, what: string }} Target */

/** Steps of what is dragged freely, and with Shift. */
export const STEPS_S = { coarse: 0.01, fine: 0.001 };
export const STEPS_DEG = { coarse: 0.5, fine: 0.1 };

/**
 * Return what an instant can come to rest at, in order of time.
 * @param {import("../state.js").View} view @param {number} cursor_s
 * @param {(lane: number, key: number) => boolean} isMoved those that are dragged are no target
 * @returns {Target[]}
 */
export function targetsOf(view, cursor_s, isMoved) {
  const found = [{ at_s: 0, what: "the start" }, { at_s: cursor_s, what: "the cursor" }];
  for (const mark of view.marks) if (mark.label !== "") found.push({ at_s: mark.at_s, what: mark.label });
  view.beats.forEach((at_s, index) => found.push({ at_s, what: `beat ${index + 1}` }));
  for (const event of view.events) found.push({ at_s: event.at_s, what: event.text });
  view.lanes.forEach((lane, index) => lane.keys.forEach((key, number) => {
    if (!isMoved(index, number)) found.push({ at_s: key.at_s, what: `a key of ${lane.name}` });
  }));
  return found.sort((one, other) => one.at_s - other.at_s);
}

/**
 * Return the nearest target within reach, else the nearest tick of a grid.
 * @param {number} at_s @param {Target[]} targets in order of time @param {number} reach_s
 * @param {number} grid_s @returns {Target}
 */
export function snapped(at_s, targets, reach_s, grid_s) {
  const after = lowerBound(targets.map((own) => own.at_s), at_s);
  /** @type {Target | undefined} */
  let best;
  for (const own of [targets[after - 1], targets[after]]) {
    if (own !== undefined && Math.abs(own.at_s - at_s) <= Math.min(reach_s, Math.abs((best?.at_s ?? Infinity) - at_s))) best = own;
  }
  return best ?? { at_s: evened(at_s, grid_s), what: "the grid" };
}

/** Return the nearest multiple of a step, without the noise of its division.
 * @param {number} value @param {number} step */
export function evened(value, step) {
  return Number((Math.round(value / step) * step).toFixed(6));
}
