// @ts-check
/** The keys that are dragged: where they would be, and what the limits say of that. Pure. */

import { angleAt } from "../curves.js";
import { number } from "../numbers.js";
import { latenessOf } from "./estimate.js";
import { draggedBy } from "./gestures.js";
import { isChosen, isJointChosen } from "./keys.js";
import { evened, snapped, STEPS_DEG, STEPS_S, targetsOf } from "./snap.js";
import { tickStep, timeText } from "./window.js";

/** @typedef {import("../state.js").View} View */
/** @typedef {import("../state.js").KeyRef} KeyRef */
/** @typedef {import("./estimate.js").Stop} Stop */
/** @typedef {{ keys: KeyRef[], by_s: number, by_deg: number, what: string, late: { joint: string, late_s: number, limit: string } | null }} Draft */
/** @typedef {Extract<import("./gestures.js").Gesture, { kind: "keys" }>} KeysGesture */

const SNAP_PX = 8;
const FINE = 0.1;

/**
 * Return the draft of a gesture. @param {KeysGesture} gesture
 * @param {{ view: View, seen: import("./window.js").Window, keys: KeyRef[], cursor_s: number, deg_per_px: number }} scene
 * `deg_per_px`: of the row in which a key was taken; 0 where it has no angle
 * @returns {Draft}
 */
export function draftOf(gesture, { view, seen, keys, cursor_s, deg_per_px }) {
  const { isFine, snaps, hit } = gesture;
  const { by_px, up_px } = draggedBy(gesture);
  const slow = isFine ? FINE : 1;
  const held = view.lanes[hit.lane]?.keys[hit.key];
  const at_s = held?.at_s ?? hit.at_s;
  const wanted_s = at_s + (slow * by_px) / seen.px_per_s;
  let what = "";
  let to_s = evened(wanted_s, isFine ? STEPS_S.fine : STEPS_S.coarse);
  if (snaps && by_px !== 0) {
    const targets = targetsOf(view, cursor_s, (lane, key) => isChosen(keys, lane, key, null));
    ({ at_s: to_s, what } = snapped(wanted_s, targets, SNAP_PX / seen.px_per_s, tickStep(seen, SNAP_PX)));
  }
  const by_s = by_px === 0 || held?.authored_s === null ? 0 : withinShow(view, keys, to_s - at_s);
  const deg = hit.joint === null ? 0 : held?.deg[hit.joint] ?? 0;
  const to_deg = evened(deg + slow * up_px * deg_per_px, isFine ? STEPS_DEG.fine : STEPS_DEG.coarse);
  const by_deg = up_px === 0 || deg_per_px === 0 || hit.joint === null ? 0 : withinRange(view, keys, to_deg - deg);
  return { keys, by_s, by_deg, what, late: lateness(view, keys, by_s, by_deg) };
}

/** No key is before the start. @param {View} view @param {KeyRef[]} keys @param {number} by_s */
export function withinShow(view, keys, by_s) {
  const first_s = Math.min(...keys.map(({ lane, key }) => {
    const own = view.lanes[lane]?.keys[key];
    return own?.authored_s ?? own?.at_s ?? 0;
  }));
  return Math.max(by_s, -first_s);
}

/** No joint is beyond its range. @param {View} view @param {KeyRef[]} keys @param {number} by_deg */
export function withinRange(view, keys, by_deg) {
  let found = by_deg;
  for (const { lane, key, joint } of keys) {
    const own = view.lanes[lane];
    const limits = view.joints.find((one) => one.name === joint);
    const deg = joint === null ? undefined : own?.keys[key]?.deg[joint];
    if (limits === undefined || deg === undefined || own?.is_added) continue;
    found = Math.min(Math.max(found, limits.range_deg[0] - deg), limits.range_deg[1] - deg);
  }
  return found;
}

/** Return the keys of a joint in a lane as they would be, in order of time.
 * @param {View} view @param {number} lane @param {string} joint
 * @param {{ keys: KeyRef[], by_s: number, by_deg: number }} draft @returns {(Stop & { isMoved: boolean })[]} */
export function stopsOf(view, lane, joint, { keys, by_s, by_deg }) {
  return (view.lanes[lane]?.keys ?? []).flatMap((own, key) => {
    const deg = own.deg[joint];
    if (deg === undefined) return [];
    const isMoved = isChosen(keys, lane, key, joint);
    const at_s = (own.authored_s ?? own.at_s) + (isMoved ? by_s : 0);
    return [{ at_s, deg: deg + (isJointChosen(keys, lane, key, joint) ? by_deg : 0), hold_s: own.hold_s, isMoved }];
  }).sort((one, other) => one.at_s - other.at_s);
}

/** @param {View} view @param {KeyRef[]} keys @param {number} by_s @param {number} by_deg @returns {Draft["late"]} */
function lateness(view, keys, by_s, by_deg) {
  /** @type {Draft["late"]} */
  let worst = null;
  for (const lane of new Set(keys.map((one) => one.lane))) {
    for (const limits of view.joints) {
      const joint = limits.name;
      const found = latenessOf(stopsOf(view, lane, joint, { keys, by_s, by_deg }), limits);
      if (found !== null && found.late_s > (worst?.late_s ?? 0)) worst = { joint, ...found };
    }
  }
  return worst;
}

/** Return a draft in words. @param {View} view @param {Draft} draft @param {{ lane: number, key: number, joint: string | null }} held */
export function draftText(view, draft, held) {
  const own = view.lanes[held.lane]?.keys[held.key];
  if (own === undefined) return [];
  const { by_s, by_deg, what, late } = draft;
  const texts = [];
  if (by_s !== 0) texts.push(`${timeText((own.authored_s ?? own.at_s) + by_s, 0.001)} (${signed(by_s, 3)} s)${what === "" ? "" : `, at ${what}`}`);
  if (by_deg !== 0 && held.joint !== null) texts.push(`${number((own.deg[held.joint] ?? 0) + by_deg, 1)}° (${signed(by_deg, 1)}°)`);
  if (late !== null) texts.push(`estimate: ${late.joint} at least ${late.late_s.toFixed(2)} s late (${late.limit})`);
  return texts;
}

/** @param {number} value @param {number} digits */
function signed(value, digits) {
  return `${value > 0 ? "+" : ""}${number(value, digits)}`;
}

/** Return the angle of a joint that a new key would have: that of the plan, evened.
 * @param {View} view @param {string} joint @param {number} at_s */
export function plannedAt(view, joint, at_s) {
  const curve = view.curves[joint]?.plan;
  return curve === undefined ? 0 : evened(angleAt(curve, at_s), STEPS_DEG.fine);
}
