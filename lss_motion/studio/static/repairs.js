// @ts-check
/** The smallest changes by which a key that is late could be in time, and what time is to spare. Pure. */

import { moveOf, setOf } from "./edits.js";
import { around, splitOf } from "./timeline/draft.js";
import { farthest, leastTime, rests } from "./timeline/estimate.js";
import { evened, STEPS_DEG, STEPS_S } from "./timeline/snap.js";

/** @typedef {import("./state.js").View} View */
/** @typedef {import("./state.js").KeyRef} KeyRef */
/** @typedef {import("./edits.js").Edit} Edit */
/** @typedef {{ text: string, edit: Edit }} Repair */

const LATE_MIN_S = 5e-4;
const UNMOVED = { by_s: 0, by_deg: 0 };

/** Return by how much a key is reached later than authored. @param {View} view @param {KeyRef} ref */
export function lateOf(view, { lane, key }) {
  const own = view.lanes[lane]?.keys[key];
  const late_s = own === undefined || own.authored_s === null ? 0 : own.at_s - own.authored_s;
  return late_s > LATE_MIN_S ? late_s : 0;
}

/** Return which joint is too slow to be at a key in time, as the plan says. @param {View} view @param {KeyRef} ref */
function slowJoint(view, { lane, key }) {
  const own = view.lanes[lane]?.keys[key];
  const span = view.stretched.filter((one) => own !== undefined && one.from_s < own.at_s - 1e-6 && one.to_s > own.at_s - 1e-3).at(-1);
  return span === undefined || own?.deg[span.joint] === undefined ? null : span.joint;
}

/**
 * Return what could bring a key that is late in time again, the smallest first: the planner has to
 * say which of it does. @param {View} view @param {KeyRef} ref @returns {Repair[]}
 */
export function repairsOf(view, ref) {
  const late_s = lateOf(view, ref);
  if (late_s === 0) return [];
  const key = { ...ref, joint: null };
  const by_s = evened(Math.ceil(late_s / STEPS_S.coarse) * STEPS_S.coarse, STEPS_S.coarse);
  const later = { by_s, by_deg: 0 };
  /** @type {{ text: string, edit: Edit | null }[]} */
  const found = [
    { text: `+${by_s.toFixed(2)} s here`, edit: moveOf(view, [key], { ...later, ripple: false }) },
    nearer(view, ref),
    { text: "keep its time, reach less far", edit: setOf(view, [key], { values: { keep: "time" } }) },
    { text: `+${by_s.toFixed(2)} s here and for all that is later`, edit: moveOf(view, [key], { ...later, ripple: true }) },
  ];
  return found.flatMap(({ text, edit }) => (edit === null ? [] : [{ text, edit }]));
}

/** Not so far as is authored: what the joint reaches in its time. @param {View} view @param {KeyRef} ref
 * @returns {{ text: string, edit: Edit | null }} */
function nearer(view, ref) {
  const joint = slowJoint(view, ref);
  const limits = view.joints.find((own) => own.name === joint);
  if (joint === null || limits === undefined) return { text: "", edit: null };
  const { stops, own } = around(splitOf(view, ref.lane, joint, [{ ...ref, joint }]), 0, UNMOVED);
  const [before, held] = [stops[own - 1], stops[own]];
  if (before === undefined || held === undefined) return { text: "", edit: null };
  const isRest = rests(stops, own - 1) && rests(stops, own);
  const reach_deg = farthest(held.at_s - before.at_s - before.hold_s, limits, isRest);
  const wanted_deg = before.deg + Math.sign(held.deg - before.deg) * Math.max(reach_deg - STEPS_DEG.coarse / 2, 0);
  const deg = evened(wanted_deg, STEPS_DEG.coarse);
  const edit = Math.abs(deg - before.deg) > Math.abs(held.deg - before.deg) ? null
    : setOf(view, [{ ...ref, joint: null }], { deg: { [joint]: deg } });
  return { text: `${joint} ${held.deg}° → ${deg}°`, edit };
}

/**
 * Return how much time a key has to spare at most, before and after it: the least of its joints.
 * @param {View} view @param {KeyRef} ref @returns {{ before_s: number | null, after_s: number | null }}
 */
export function slackOf(view, ref) {
  const joints = ref.joint === null ? Object.keys(view.lanes[ref.lane]?.keys[ref.key]?.deg ?? {}) : [ref.joint];
  /** @type {[number | null, number | null]} */
  const spare = [null, null];
  for (const joint of joints) {
    const limits = view.joints.find((own) => own.name === joint);
    const split = splitOf(view, ref.lane, joint, [{ ...ref, joint }]);
    if (limits === undefined || split.moved.length === 0) continue;
    const { stops, own } = around(split, 0, UNMOVED);
    [own, own + 1].forEach((to, side) => {
      const [from, at] = [stops[to - 1], stops[to]];
      if (from === undefined || at === undefined) return;
      const { least_s } = leastTime(at.deg - from.deg, limits, rests(stops, to - 1) && rests(stops, to));
      spare[side] = Math.min(spare[side] ?? Infinity, Math.max(at.at_s - from.at_s - from.hold_s - least_s, 0));
    });
  }
  return { before_s: spare[0], after_s: spare[1] };
}
