// @ts-check
/**
 * Handles of a key on its curve: they show with which slope a joint passes it, and change that. Of a
 * key whose slope nobody has given, they stand as the plan has it. Pure.
 */

import { angleAt, valueAt } from "../curves.js";
import { number } from "../numbers.js";
import { evened } from "./snap.js";
import { isInSight, pixelOf } from "./window.js";

/** @typedef {import("./draw.js").Scene} Scene */
/** @typedef {import("../state.js").View} View */
/** @typedef {import("../state.js").Key} Key */
/** @typedef {import("../state.js").KeyRef} KeyRef */
/** @typedef {(value: number) => number} ToPixel */
/** @typedef {{ lane: number, key: number, joint: string, at_s: number, deg: number, slope: number, isGiven: boolean }} Handle */

export const HANDLE_PX = 42;
/** The pointer tells a slope from at least so far beside the key. */
const BESIDE_PX = 8;
/** Steps of a slope that is dragged, and with Shift. */
const STEPS = { coarse: 1, fine: 0.1 };
/** As in the file. */
const SLOPE_MAX_DEG_S = 10_000;
/** Handles of more keys than these are not drawn: they cover the curve. */
const HANDLES_MAX = 12;
const FLOWING = ["smooth", "spline"];

/** Return the handles of chosen keys. @param {View} view @param {KeyRef[]} keys @returns {Handle[]} */
export function handlesOf(view, keys) {
  return keys.length > HANDLES_MAX ? [] : keys.flatMap((ref) => handleOf(view, ref) ?? []);
}

/** Return the handle of a joint at a key; null where it stands there and cannot have one.
 * @param {View} view @param {KeyRef} ref @returns {Handle | null} */
export function handleOf(view, { lane, key, joint }) {
  if (joint === null || view.lanes[lane]?.is_added) return null;
  const plan = view.curves[joint]?.plan;
  const { own, before, after } = around(view, lane, key, joint);
  const isPassed = before !== undefined && after !== undefined && own?.hold_s === 0 && own.authored_s !== null;
  if (plan === undefined || own === undefined || !isPassed) return null;
  if (![own.ease, after.ease].every((ease) => FLOWING.includes(ease))) return null;
  const given = own.slope_deg_s[joint];
  const slope = given ?? evened(valueAt(plan, own.at_s, 1), STEPS.fine);
  return { lane, key, joint, at_s: own.at_s, deg: own.deg[joint] ?? 0, slope, isGiven: given !== undefined };
}

/** Return a key, and the keys of a joint before and after it. @param {View} view @param {number} lane @param {number} key
 * @param {string} joint @returns {{ own: Key | undefined, before: Key | undefined, after: Key | undefined }} */
function around(view, lane, key, joint) {
  const keys = (view.lanes[lane]?.keys ?? []).filter((one) => joint in one.deg);
  const own = view.lanes[lane]?.keys[key];
  const place = own === undefined ? -1 : keys.indexOf(own);
  return place < 0 ? { own: undefined, before: undefined, after: undefined }
    : { own, before: keys[place - 1], after: keys[place + 1] };
}

/** Return the ends of a handle: before the key, and after it. @param {Handle} handle
 * @param {import("./window.js").Window} seen @param {ToPixel} y @returns {{ x_px: number, y_px: number, side: 1 | -1 }[]} */
export function endsOf({ at_s, deg, slope }, seen, y) {
  const rise_px = (slope / seen.px_per_s) * (y(1) - y(0));
  const along_px = HANDLE_PX / Math.hypot(1, rise_px);
  const sides = /** @type {const} */ ([-1, 1]);
  return sides.map((side) => ({ x_px: pixelOf(seen, at_s) + side * along_px, y_px: y(deg) + side * along_px * rise_px, side }));
}

/** Return which end of a handle is at a point; undefined: none. @param {Handle} handle @param {import("./window.js").Window} seen
 * @param {ToPixel} y @param {{ x_px: number, y_px: number, reach_px: number }} point */
export function endAt(handle, seen, y, { x_px, y_px, reach_px }) {
  return endsOf(handle, seen, y).find((end) => Math.hypot(end.x_px - x_px, end.y_px - y_px) <= reach_px);
}

/** Return the handle as it points to a place. @param {Handle} handle @param {1 | -1} side
 * @param {{ x_px: number, y_px: number }} at @param {import("./window.js").Window} seen @param {ToPixel} y
 * @param {boolean} isFine @returns {Handle} */
export function turned(handle, side, at, seen, y, isFine) {
  const beside_px = Math.max(side * (at.x_px - pixelOf(seen, handle.at_s)), BESIDE_PX);
  const up_deg = (at.y_px - y(handle.deg)) / (y(1) - y(0));
  const slope = (side * up_deg * seen.px_per_s) / beside_px;
  const within = Math.min(Math.max(slope, -SLOPE_MAX_DEG_S), SLOPE_MAX_DEG_S);
  return { ...handle, slope: evened(within, isFine ? STEPS.fine : STEPS.coarse), isGiven: true };
}

/** Return the slope after one of V: flat, then free, then none that is given.
 * @param {View} view @param {Handle} handle @returns {number | null} */
export function nextSlope(view, handle) {
  if (!handle.isGiven) return 0;
  return handle.slope === 0 ? freeSlope(view, handle) : null;
}

/** The slope of the straight line from the key before to the one after: where a free handle begins.
 * @param {View} view @param {Handle} handle */
function freeSlope(view, { lane, key, joint }) {
  const { before, after } = around(view, lane, key, joint);
  if (before === undefined || after === undefined) return 0;
  const over_s = (after.authored_s ?? after.at_s) - (before.authored_s ?? before.at_s) - before.hold_s;
  const slope = ((after.deg[joint] ?? 0) - (before.deg[joint] ?? 0)) / Math.max(over_s, 1e-3);
  return evened(slope, STEPS.fine) || STEPS.coarse;
}

/** Draw handles: filled where the slope is given. @param {CanvasRenderingContext2D} ctx @param {Scene} scene
 * @param {Handle[]} handles @param {ToPixel} y @param {string} colour */
export function drawHandles(ctx, { seen, palette }, handles, y, colour) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1.5;
  for (const handle of handles) {
    if (!isInSight(seen, handle.at_s)) continue;
    const ends = endsOf(handle, seen, y);
    ctx.beginPath();
    for (const end of ends) ctx.lineTo(end.x_px, end.y_px);
    ctx.stroke();
    ctx.fillStyle = handle.isGiven ? colour : palette.surface;
    for (const end of ends) {
      ctx.beginPath();
      ctx.arc(end.x_px, end.y_px, 4, 0, 2 * Math.PI);
      ctx.fill();
      ctx.stroke();
    }
  }
}

/** Draw the curve around a key as it would be without limits, while its handle is dragged.
 * @param {CanvasRenderingContext2D} ctx @param {Scene} scene @param {Handle} handle @param {ToPixel} y @param {string} colour */
export function drawBent(ctx, { view, seen }, handle, y, colour) {
  const plan = view.curves[handle.joint]?.plan;
  const { before, after } = around(view, handle.lane, handle.key, handle.joint);
  if (plan === undefined || before === undefined || after === undefined) return;
  /** @param {number} at_s @param {Key} key */
  const other = (at_s, key) => ({ at_s, deg: key.deg[handle.joint] ?? 0, slope: key.slope_deg_s[handle.joint] ?? valueAt(plan, at_s, 1) });
  const knots = [other(before.at_s + before.hold_s, before), handle, other(after.at_s, after)];
  const bent = {
    times_s: Float64Array.from(knots, (one) => one.at_s), deg: Float32Array.from(knots, (one) => one.deg),
    deg_s: Float32Array.from(knots, (one) => one.slope),
  };
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1.5;
  ctx.setLineDash([4, 3]);
  ctx.beginPath();
  for (let x_px = pixelOf(seen, before.at_s + before.hold_s); x_px <= pixelOf(seen, after.at_s); x_px += 2) {
    ctx.lineTo(x_px, y(angleAt(bent, seen.start_s + x_px / seen.px_per_s)));
  }
  ctx.stroke();
  ctx.setLineDash([]);
}

/** @param {Handle} handle */
export function slopeText({ joint, slope }) {
  return `${joint} passes with ${number(slope, 1)} deg/s`;
}
