// @ts-check
/** The keys that are dragged: where they would be, and what the limits say of that. Pure. */

import { angleAt } from "../curves.js";
import { number } from "../numbers.js";
import { latenessAt } from "./estimate.js";
import { draggedBy } from "./gestures.js";
import { isChosen, isJointChosen } from "./keys.js";
import { evened, snapped, STEPS_DEG, STEPS_S, targetsOf } from "./snap.js";
import { pixelOf, tickStep, timeText } from "./window.js";

/** @typedef {import("../state.js").View} View */
/** @typedef {import("../state.js").KeyRef} KeyRef */
/** @typedef {import("./estimate.js").Stop} Stop */
/** @typedef {{ ratio: number, about_s: number | null, about_deg: Record<string, number> }} Scale times about an instant, or angles about one of each joint */
/** @typedef {{ by_s: number, by_deg: number, scale?: Scale | null, isCopy?: boolean }} Change what is done to keys */
/** @typedef {Change & { keys: KeyRef[], what: string, late: { joint: string, late_s: number, limit: string } | null }} Draft */
/** @typedef {import("./gestures.js").Dragged} KeysGesture */

const SNAP_PX = 8;
const FINE = 0.1;
/** Keys are scaled by at least this: all at one instant they would be one key. */
const RATIO_MIN = 0.05;
/** Where the pointer is closer to the cursor than this it scales as from there. */
const ABOUT_PX = 60;
/** So far up, angles are twice as large. */
const DOUBLE_PX = 100;
/** An arrow key scales by 1 %. */
const STEP_RATIO = 0.01;

/**
 * Return the draft of a gesture. @param {KeysGesture} gesture
 * @param {{ view: View, seen: import("./window.js").Window, keys: KeyRef[], cursor_s: number, deg_per_px: number }} scene
 * `deg_per_px`: of the row in which a key was taken; 0 where it has no angle
 * @returns {Draft}
 */
export function draftOf(gesture, { view, seen, keys, cursor_s, deg_per_px }) {
  if (gesture.mode === "scale") return scaleDraft(gesture, { view, seen, keys, cursor_s });
  const { isFine, snaps, hit, steps } = gesture;
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
  const dragged_s = by_px === 0 ? 0 : to_s - at_s;
  const by_s = held?.authored_s === null ? 0 : withinShow(view, keys, evened(dragged_s + steps.by_s, STEPS_S.fine));
  const deg = hit.joint === null ? 0 : held?.deg[hit.joint] ?? 0;
  const to_deg = evened(deg + slow * up_px * deg_per_px, isFine ? STEPS_DEG.fine : STEPS_DEG.coarse);
  const dragged_deg = up_px === 0 || deg_per_px === 0 ? 0 : to_deg - deg;
  const by_deg = hit.joint === null ? 0 : withinRange(view, keys, evened(dragged_deg + steps.by_deg, STEPS_DEG.fine));
  const change = { by_s, by_deg, isCopy: gesture.mode === "copy" };
  return { ...change, keys, what, late: lateness(view, keys, change) };
}

/** Scale keys about the cursor: in time, or with the axis of the angle about where each joint is there.
 * @param {KeysGesture} gesture @param {{ view: View, seen: import("./window.js").Window, keys: KeyRef[], cursor_s: number }} scene
 * @returns {Draft} */
function scaleDraft({ at, from, axis, isFine, steps }, { view, seen, keys, cursor_s }) {
  const slow = isFine ? FINE : 1;
  /** @type {Scale} */
  let scale;
  if (axis === "angle") {
    const ratio = 1 + slow * (from.y_px - at.y_px) / DOUBLE_PX + STEP_RATIO * steps.by_deg / STEPS_DEG.coarse;
    const joints = keys.flatMap(({ lane, key, joint }) => (joint === null ? Object.keys(view.lanes[lane]?.keys[key]?.deg ?? {}) : [joint]));
    const about_deg = Object.fromEntries([...new Set(joints)].map((joint) => [joint, plannedAt(view, joint, cursor_s)]));
    scale = { ratio: evened(ratio, STEP_RATIO), about_s: null, about_deg };
  } else {
    const off_px = from.x_px - pixelOf(seen, cursor_s);
    const share = (at.x_px - from.x_px) / Math.max(Math.abs(off_px), ABOUT_PX);
    const ratio = 1 + slow * (off_px < 0 ? -share : share) + STEP_RATIO * steps.by_s / STEPS_S.coarse;
    scale = { ratio: Math.max(evened(ratio, STEP_RATIO), RATIO_MIN), about_s: cursor_s, about_deg: {} };
  }
  const change = { by_s: 0, by_deg: 0, scale };
  return { ...change, keys, what: "", late: lateness(view, keys, change) };
}

/** Whether a change leaves all as it is. @param {Change} change */
export function isNothing({ by_s, by_deg, scale }) {
  return by_s === 0 && by_deg === 0 && (scale == null || scale.ratio === 1);
}

/** Return when a key would be. @param {Change} change @param {number} at_s */
export function draggedTime({ by_s, scale }, at_s) {
  return scale?.about_s == null ? at_s + by_s : scale.about_s + (at_s - scale.about_s) * scale.ratio;
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

/** @typedef {Stop & { joint: string, isTurned: boolean }} KeyStop */
/** @typedef {{ moved: KeyStop[], still: KeyStop[] }} Split the keys of a joint in a lane, each in order of time */
/** A drag asks for them at every move of the pointer. @type {WeakMap<KeyRef[], Map<string, Split>>} */
const splits = new WeakMap();

/** Return which keys of a joint in a lane are dragged. @param {View} view @param {number} lane @param {string} joint
 * @param {KeyRef[]} keys never changed @param {boolean} [isCopy] those that are dragged stay, too @returns {Split} */
export function splitOf(view, lane, joint, keys, isCopy = false) {
  let all = splits.get(keys);
  if (all === undefined) splits.set(keys, all = new Map());
  const name = `${lane} ${joint} ${isCopy}`;
  let found = all.get(name);
  if (found !== undefined) return found;
  all.set(name, found = { moved: [], still: [] });
  const { moved, still } = found;
  (view.lanes[lane]?.keys ?? []).forEach((own, key) => {
    const deg = own.deg[joint];
    if (deg === undefined) return;
    const isTurned = isJointChosen(keys, lane, key, joint);
    const stop = { at_s: own.authored_s ?? own.at_s, deg, hold_s: own.hold_s, joint, isTurned };
    const isMoved = isChosen(keys, lane, key, joint);
    if (isMoved) moved.push(stop);
    if (!isMoved || isCopy) still.push(stop);
  });
  for (const stops of [moved, still]) stops.sort((one, other) => one.at_s - other.at_s);
  return found;
}

/** Return a dragged key as it would be. @param {KeyStop} stop @param {Change} change @returns {KeyStop} */
export function draggedStop(stop, change) {
  const about_deg = change.scale?.about_deg[stop.joint];
  const deg = about_deg === undefined ? stop.deg + (stop.isTurned ? change.by_deg : 0)
    : about_deg + (stop.deg - about_deg) * /** @type {Scale} */ (change.scale).ratio;
  return { ...stop, at_s: draggedTime(change, stop.at_s), deg };
}

/** Return the first key that is not before an instant. @param {KeyStop[]} stops @param {number} at_s */
function placeOf(stops, at_s) {
  let low = 0;
  for (let high = stops.length; low < high;) {
    const middle = (low + high) >> 1;
    if (/** @type {KeyStop} */ (stops[middle]).at_s < at_s) low = middle + 1;
    else high = middle;
  }
  return low;
}

/**
 * Return a dragged key as it would be with two keys to each side, as far as there are, and which it is.
 * @param {Split} split @param {number} index of the key among those that are dragged
 * @param {Change} draft @returns {{ stops: KeyStop[], own: number }}
 */
export function around({ moved, still }, index, draft) {
  const held = draggedStop(/** @type {KeyStop} */ (moved[index]), draft);
  const place = placeOf(still, held.at_s);
  const stops = [
    ...still.slice(Math.max(place - 2, 0), place + 2),
    ...moved.slice(Math.max(index - 2, 0), index).map((own) => draggedStop(own, draft)),
    held,
    ...moved.slice(index + 1, index + 3).map((own) => draggedStop(own, draft)),
  ].sort((one, other) => one.at_s - other.at_s);
  const own = stops.indexOf(held);
  const first = Math.max(own - 2, 0);
  return { stops: stops.slice(first, own + 3), own: own - first };
}

/** @param {View} view @param {KeyRef[]} keys @param {Change} change @returns {Draft["late"]} */
function lateness(view, keys, change) {
  const isRigid = change.by_deg === 0 && change.scale == null;
  /** @type {Draft["late"]} */
  let worst = null;
  for (const lane of new Set(keys.map((one) => one.lane))) {
    for (const limits of view.joints) {
      const split = splitOf(view, lane, limits.name, keys, change.isCopy);
      // Keys that are all dragged keep their distance.
      if (split.still.length === 0 && isRigid) continue;
      split.moved.forEach((_, index) => {
        const { stops, own } = around(split, index, change);
        const found = latenessAt(stops, own, limits);
        if (found !== null && found.late_s > (worst?.late_s ?? 0)) worst = { joint: limits.name, ...found };
      });
    }
  }
  return worst;
}

/** By this the answer of the planner is known to be that of a draft. @param {Change} draft */
export function draftName({ by_s, by_deg, scale, isCopy }) {
  return `${by_s} ${by_deg} ${scale?.ratio} ${scale?.about_s} ${isCopy}`;
}

/** Whether a draft breaks a limit: by the planner's answer, else by the estimate.
 * @param {Draft} draft @param {import("../state.js").Tried | null} tried */
export function isLate(draft, tried) {
  if (tried === null || tried.window === null) return draft.late !== null || (tried?.problem ?? null) !== null;
  return tried.window.slow.length > 0;
}

/** Return what the planner says of a draft. @param {import("../state.js").Tried} tried @returns {string[]} */
export function triedTexts({ problem, window }) {
  if (problem !== null) return [problem];
  if (window === null) return [];
  const missed = window.keys.filter((key) => key.is_missed).map((key) => (
    `anchor ${key.label || key.place} fails by ${(key.planned_s - key.authored_s).toFixed(2)} s`));
  const later = window.later_s > 1e-3 ? [`what follows is ${window.later_s.toFixed(2)} s later`] : [];
  const slow = window.slow.slice(0, 2).map((span) => span.text);
  return slow.length + missed.length === 0 ? ["within all limits"] : [...missed, ...slow, ...later];
}

/** Return a draft in words: what the planner says of it, until then an estimate. @param {View} view @param {Draft} draft
 * @param {{ lane: number, key: number, joint: string | null }} held @param {import("../state.js").Tried | null} tried */
export function draftText(view, draft, held, tried) {
  const own = view.lanes[held.lane]?.keys[held.key];
  if (own === undefined) return [];
  const { by_s, by_deg, what, late, scale, isCopy } = draft;
  const texts = isCopy ? ["copy"] : [];
  if (scale != null) texts.push(`${number(100 * scale.ratio, 0)} % of ${scale.about_s === null ? "the angles" : "the times"}, about the cursor (X time, Y angle)`);
  if (by_s !== 0) texts.push(`${timeText((own.authored_s ?? own.at_s) + by_s, 0.001)} (${signed(by_s, 3)} s)${what === "" ? "" : `, at ${what}`}`);
  if (by_deg !== 0 && held.joint !== null) texts.push(`${number((own.deg[held.joint] ?? 0) + by_deg, 1)}° (${signed(by_deg, 1)}°)`);
  const told = tried === null ? [] : triedTexts(tried);
  if (told.length > 0) texts.push(...told);
  else if (late !== null) texts.push(`estimate: ${late.joint} at least ${late.late_s.toFixed(2)} s late (${late.limit})`);
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
