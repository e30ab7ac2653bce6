// @ts-check
/** What a person does with keys as operations of the server (`lss-motion schema remote`). Pure. */

import { wholeKeys } from "./timeline/keys.js";

/** @typedef {import("./state.js").View} View */
/** @typedef {import("./state.js").KeyRef} KeyRef */
/** @typedef {import("./state.js").Key} Key */
/** @typedef {{ op: string, fields: Record<string, unknown> }} Edit */
/** @typedef {{ file: string, place: (string | number)[], joints?: string[] }} Address */
/** @typedef {{ lane: string, after_s: number, deg: Record<string, number>, values: Record<string, unknown> }} Copied */

/** The ways in which joints travel to a key, in the order in which `T` goes through them. */
export const EASES = /** @type {const} */ (["smooth", "spline", "linear", "hold"]);

/**
 * Return where keys stand in their files: each item once, also one that is played often.
 * @param {View} view @param {KeyRef[]} keys @returns {Address[]}
 */
export function addressesOf(view, keys) {
  /** @type {Map<string, Address>} */
  const found = new Map();
  for (const { lane, key, joints } of wholeKeys(keys)) {
    const own = view.lanes[lane];
    const item = own?.keys[key];
    if (own === undefined || item?.place == null) continue;
    const isWhole = joints === null || Object.keys(item.deg).every((joint) => joints.includes(joint));
    const name = `${own.file} ${JSON.stringify(item.place)}`;
    const before = found.get(name);
    const named = { file: own.file, place: item.place, ...(isWhole ? {} : { joints }) };
    if (before === undefined) found.set(name, named);
    else if (before.joints !== undefined) found.set(name, isWhole ? named : { ...before, joints: [...new Set([...before.joints, ...(joints ?? [])])] });
  }
  return [...found.values()];
}

/** Move keys in time, and those of a joint in angle. @param {View} view @param {KeyRef[]} keys
 * @param {{ by_s: number, by_deg: number, ripple: boolean, gesture?: string }} by @returns {Edit | null} */
export function moveOf(view, keys, { by_s, by_deg, ripple, gesture }) {
  const own = addressesOf(view, keys);
  if (own.length === 0 || by_s === 0 && by_deg === 0) return null;
  const turned = new Set(keys.flatMap(({ joint }) => joint ?? []));
  const more = gesture === undefined ? {} : { gesture };
  const angles = by_deg === 0 ? {} : Object.fromEntries([...turned].map((joint) => [joint, by_deg]));
  return { op: "key.move", fields: { keys: own, by_s, by_deg: angles, ripple, ...more } };
}

/** @param {View} view @param {KeyRef[]} keys @param {import("./timeline/draft.js").Scale} scale @returns {Edit | null} */
export function scaleOf(view, keys, { about_s, about_deg, ratio }) {
  const own = addressesOf(view, about_s === null ? keys : keys.map((one) => ({ ...one, joint: null })));
  return own.length === 0 || ratio === 1 ? null : { op: "key.scale", fields: { keys: own, about_s, about_deg, ratio } };
}

/** Exchange left and right. @param {View} view @param {KeyRef[]} keys @returns {Edit | null} */
export function mirrorOf(view, keys) {
  const own = addressesOf(view, keys);
  return own.length === 0 ? null : { op: "key.mirror", fields: { keys: own } };
}

/** What a draft does when it is taken. @param {View} view @param {KeyRef[]} keys
 * @param {import("./timeline/draft.js").Change} change @param {boolean} ripple @returns {Edit | null} */
export function editOf(view, keys, { by_s, by_deg, scale, isCopy }, ripple) {
  if (scale != null) return scaleOf(view, keys, scale);
  if (!isCopy) return moveOf(view, keys, { by_s, by_deg, ripple });
  const turned = new Set(keys.flatMap(({ joint }) => joint ?? []));
  const own = copied(view, keys).map((one) => ({
    ...one, deg: Object.fromEntries(Object.entries(one.deg).map(([joint, deg]) => [joint, turned.has(joint) ? deg + by_deg : deg])),
  }));
  const first_s = Math.min(...keys.map(({ lane, key }) => view.lanes[lane]?.keys[key]?.at_s ?? Infinity));
  return by_s === 0 && by_deg === 0 ? null : pasteOf(view, own, first_s + by_s);
}

/** @param {View} view @param {KeyRef[]} keys @param {boolean} ripple @returns {Edit | null} */
export function deleteOf(view, keys, ripple) {
  const own = addressesOf(view, keys);
  return own.length === 0 ? null : { op: "key.delete", fields: { keys: own, ripple } };
}

/** Set angles or values of keys; null removes. @param {View} view @param {KeyRef[]} keys
 * @param {{ deg?: Record<string, number | null>, slope_deg_s?: Record<string, number | null>, values?: Record<string, unknown> }} change @returns {Edit | null} */
export function setOf(view, keys, change) {
  const own = addressesOf(view, keys.map((one) => ({ ...one, joint: null })));
  return own.length === 0 ? null : { op: "key.set", fields: { keys: own, ...change } };
}

/** Add keys to the list of a lane. @param {View} view @param {number} lane
 * @param {{ at_s: number, deg: Record<string, number>, values?: Record<string, unknown> }[]} keys @returns {Edit | null} */
export function addOf(view, lane, keys) {
  const list = listOf(view, lane);
  if (list === null || keys.length === 0) return null;
  return { op: "key.add", fields: { keys: keys.map((own) => ({ ...list, ...own })) } };
}

/** Return the list in which the keys of a lane stand. @param {View} view @param {number} lane
 * @returns {{ file: string, place: (string | number)[] } | null} */
export function listOf(view, lane) {
  const own = view.lanes[lane];
  const place = own?.keys[0]?.place;
  return own === undefined || place == null ? null : { file: own.file, place: place.slice(0, -1) };
}

/** Return keys as they can be pasted: by their lane, from the first of them on.
 * @param {View} view @param {KeyRef[]} keys @returns {Copied[]} */
export function copied(view, keys) {
  const own = wholeKeys(keys).flatMap(({ lane, key, joints }) => {
    const item = view.lanes[lane]?.keys[key];
    return item === undefined ? [] : [{ lane: view.lanes[lane]?.name ?? "", item, joints }];
  });
  const first_s = Math.min(...own.map(({ item }) => item.at_s));
  return own.map(({ lane, item, joints }) => ({
    lane, after_s: item.at_s - first_s, deg: joints === null ? item.deg
      : Object.fromEntries(joints.map((joint) => [joint, item.deg[joint] ?? 0])), values: valuesOf(item, joints),
  }));
}

/** What a key says besides its angles; a label is a name, which a copy does not have. @param {Key} item @param {string[] | null} joints */
function valuesOf(item, joints) {
  const slopes = Object.entries(item.slope_deg_s).filter(([joint]) => joints === null || joints.includes(joint));
  return { ...(slopes.length > 0 ? { slope_deg_s: Object.fromEntries(slopes) } : {}), ...(item.hold_s > 0 ? { hold_s: Number(item.hold_s.toFixed(3)) } : {}), ...(item.ease === "smooth" ? {} : { ease: item.ease }) };
}

/** Paste keys from an instant on, each into its lane.
 * @param {View} view @param {Copied[]} keys @param {number} at_s @returns {Edit | null} */
export function pasteOf(view, keys, at_s) {
  const added = keys.flatMap(({ lane, after_s, deg, values }) => {
    const list = listOf(view, view.lanes.findIndex((own) => own.name === lane));
    return list === null ? [] : [{ ...list, at_s: Number((at_s + after_s).toFixed(4)), deg, ...(Object.keys(values).length > 0 ? { values } : {}) }];
  });
  return added.length === 0 ? null : { op: "key.add", fields: { keys: added } };
}

/** Return the ease after that of the keys. @param {string} ease */
export function nextEase(ease) {
  const index = EASES.findIndex((own) => own === ease);
  return /** @type {string} */ (EASES[(index + 1) % EASES.length]);
}
