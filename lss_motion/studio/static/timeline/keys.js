// @ts-check
/** Which keys are chosen. Pure. */

import { lowerBound } from "../curves.js";
import { timeAt } from "./window.js";

/** @typedef {import("../state.js").View} View */
/** @typedef {import("../state.js").KeyRef} KeyRef */
/** @typedef {import("./layout.js").Row} Row */
/** @typedef {{ left_px: number, right_px: number, top_px: number, bottom_px: number }} Box */
/**
 * @typedef {{ lane: string, at_s: number, joint: string | null, nth?: number, of?: number }} Place
 * a key by what a person sees: when it is, else the how manieth of how many of its lane
 */

/** Keys of two plans at instants closer together than this are the same one. */
const SAME_S = 2e-3;

/** @param {KeyRef} one @param {KeyRef} other */
export function isSame(one, other) {
  return one.lane === other.lane && one.key === other.key && one.joint === other.joint;
}

/** Chosen keys by lane and number, and by joint: asked for every key of a plan while one is dragged.
 * @type {WeakMap<KeyRef[], { any: Set<string>, whole: Set<string>, joints: Set<string> }>} */
const indices = new WeakMap();

/** @param {KeyRef[]} keys */
function indexOf(keys) {
  let own = indices.get(keys);
  if (own === undefined) {
    own = { any: new Set(), whole: new Set(), joints: new Set() };
    for (const { lane, key, joint } of keys) {
      own.any.add(`${lane} ${key}`);
      if (joint === null) own.whole.add(`${lane} ${key}`);
      else own.joints.add(`${lane} ${key} ${joint}`);
    }
    indices.set(keys, own);
  }
  return own;
}

/** Whether a key is chosen: in its lane for any of its joints, in the row of a joint for that one.
 * @param {KeyRef[]} keys never changed @param {number} lane @param {number} key @param {string | null} joint */
export function isChosen(keys, lane, key, joint) {
  const own = indexOf(keys);
  const name = `${lane} ${key}`;
  return joint === null ? own.any.has(name) : own.whole.has(name) || own.joints.has(`${name} ${joint}`);
}

/** Whether the angle of a joint is chosen by itself, so that it can be turned.
 * @param {KeyRef[]} keys never changed @param {number} lane @param {number} key @param {string} joint */
export function isJointChosen(keys, lane, key, joint) {
  return indexOf(keys).joints.has(`${lane} ${key} ${joint}`);
}

/** Return the keys with more of them; with `isToggled` those that are there already leave.
 * @param {KeyRef[]} keys @param {KeyRef[]} more @param {boolean} isToggled @returns {KeyRef[]} */
export function joined(keys, more, isToggled) {
  const fresh = more.filter((own) => !keys.some((one) => isSame(one, own)));
  const kept = isToggled ? keys.filter((own) => !more.some((one) => isSame(one, own))) : keys;
  return [...kept, ...fresh];
}

/** Return every key once: that of a lane whole, also where joints of it are chosen.
 * @param {KeyRef[]} keys @returns {{ lane: number, key: number, joints: string[] | null }[]} */
export function wholeKeys(keys) {
  /** @type {Map<string, { lane: number, key: number, joints: string[] | null }>} */
  const found = new Map();
  for (const { lane, key, joint } of keys) {
    const name = `${lane} ${key}`;
    const own = found.get(name);
    if (own === undefined) found.set(name, { lane, key, joints: joint === null ? null : [joint] });
    else if (joint === null) own.joints = null;
    else own.joints?.push(joint);
  }
  return [...found.values()];
}

/** Return all keys of a row, or of all lanes. @param {View} view @param {Row | null} row @returns {KeyRef[]} */
export function allKeys(view, row) {
  if (row?.kind === "joint") return (view.keys[row.name] ?? []).map(({ lane, key }) => ({ lane, key, joint: row.name }));
  return view.lanes.flatMap((own, lane) => (
    row === null || row.index === lane ? own.keys.map((_, key) => ({ lane, key, joint: null })) : []));
}

/**
 * Return the keys within a box. @param {View} view @param {Row[]} rows in sight
 * @param {import("./window.js").Window} seen @param {Box} box
 * @param {(row: Row, key: import("../state.js").JointKey) => number} yOf where a joint's key stands
 * @returns {KeyRef[]}
 */
export function keysInBox(view, rows, seen, box, yOf) {
  const [from_s, to_s] = [timeAt(seen, box.left_px), timeAt(seen, box.right_px)];
  /** @param {number} y_px */
  const isWithin = (y_px) => y_px >= box.top_px && y_px <= box.bottom_px;
  return rows.flatMap((row) => {
    if (row.kind === "lane") return isWithin(row.y_px + row.height_px / 2) ? ofLane(view, row.index, from_s, to_s) : [];
    if (row.kind !== "joint" || row.y_px > box.bottom_px || row.y_px + row.height_px < box.top_px) return [];
    return (view.keys[row.name] ?? [])
      .filter((key) => key.at_s >= from_s && key.at_s <= to_s && isWithin(yOf(row, key)))
      .map(({ lane, key }) => ({ lane, key, joint: /** @type {string | null} */ (row.name) }));
  });
}

/** @param {View} view @param {number} lane @param {number} from_s @param {number} to_s @returns {KeyRef[]} */
function ofLane(view, lane, from_s, to_s) {
  const { times_s } = /** @type {import("../state.js").Lane} */ (view.lanes[lane]);
  const first = lowerBound(times_s, from_s);
  return Array.from({ length: Math.max(lowerBound(times_s, to_s) - first, 0) }, (_, n) => ({ lane, key: first + n, joint: null }));
}

/** Return where a key of a joint is drawn: what is added to other angles stands on their sum.
 * @param {import("../state.js").JointKey} key @param {(deg: number) => number} y
 * @param {(at_s: number) => number} sumAt @returns {number} */
export function heightOf(key, y, sumAt) {
  return y(key.is_added ? sumAt(key.at_s) : key.deg);
}

/** Return what stays of the chosen keys when the plan is another: lane, authored instant and joint.
 * @param {View} view @param {KeyRef[]} keys @param {number} [by_s] moved by so much @returns {Place[]} */
export function placesOf(view, keys, by_s = 0) {
  return keys.flatMap(({ lane, key, joint }) => {
    const own = view.lanes[lane];
    const found = own?.keys[key];
    if (own === undefined || found === undefined) return [];
    return [{ lane: own.name, at_s: (found.authored_s ?? found.at_s) + by_s, joint, nth: key, of: own.keys.length }];
  });
}

/** Return the keys at places, as far as they are there. @param {View} view @param {Place[]} places @returns {KeyRef[]} */
export function refound(view, places) {
  return places.flatMap(({ lane: name, at_s, joint, nth, of }) => {
    const lane = view.lanes.findIndex((own) => own.name === name);
    const keys = view.lanes[lane]?.keys ?? [];
    /** @param {import("../state.js").Key | undefined} own */
    const has = (own) => own !== undefined && (joint === null || joint in own.deg);
    let key = keys.findIndex((own) => Math.abs((own.authored_s ?? own.at_s) - at_s) < SAME_S && has(own));
    if (key < 0 && nth !== undefined && keys.length === of && has(keys[nth])) key = nth;
    return key < 0 ? [] : [{ lane, key, joint }];
  });
}
