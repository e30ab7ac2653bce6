// @ts-check
/**
 * What a joint's limits say of keys while they are dragged: at least so late, or how far it can get.
 * An estimate: no motion is faster than this, and the planner says what the real one is. Pure.
 */

/** @typedef {{ at_s: number, deg: number, hold_s: number }} Stop a key of one joint */
/** @typedef {{ speed_max_deg_s: number, accel_max_deg_s2: number, range_deg: [number, number] }} Limits */
/** @typedef {{ late_s: number, limit: "speed" | "acceleration" }} Estimate */

/** Less than this is no lateness that anybody sees. */
const LATE_MIN_S = 5e-3;

/**
 * Return the least time between two angles, and which limit asks for it.
 * @param {number} by_deg @param {Limits} limits @param {boolean} isRest whether it rests at both
 * @returns {{ least_s: number, limit: "speed" | "acceleration" }}
 */
export function leastTime(by_deg, limits, isRest) {
  const size_deg = Math.abs(by_deg);
  const { speed_max_deg_s: speed, accel_max_deg_s2: accel } = limits;
  if (!isRest) return { least_s: size_deg / speed, limit: "speed" };
  if (size_deg < (speed * speed) / accel) return { least_s: 2 * Math.sqrt(size_deg / accel), limit: "acceleration" };
  return { least_s: size_deg / speed + speed / accel, limit: "speed" };
}

/** Return how far a joint gets in a time at most: what `leastTime` takes that long for.
 * @param {number} time_s @param {Limits} limits @param {boolean} isRest */
export function farthest(time_s, { speed_max_deg_s: speed, accel_max_deg_s2: accel }, isRest) {
  const own_s = Math.max(time_s, 0);
  if (!isRest) return own_s * speed;
  return own_s < (2 * speed) / accel ? (accel * own_s * own_s) / 4 : speed * (own_s - speed / accel);
}

/**
 * Return by how much a key or the one after it is late at least, or null. There are two keys to
 * each side, or the joint has no more. @param {Stop[]} stops in order of time @param {number} index
 * @param {Limits} limits @returns {Estimate | null}
 */
export function latenessAt(stops, index, limits) {
  /** @type {Estimate | null} */
  let worst = null;
  for (const to of [index, index + 1]) {
    const [before, own] = [stops[to - 1], stops[to]];
    if (before === undefined || own === undefined) continue;
    const room_s = own.at_s - before.at_s - before.hold_s;
    const isRest = rests(stops, to - 1) && rests(stops, to);
    const { least_s, limit } = leastTime(own.deg - before.deg, limits, isRest);
    const late_s = least_s - room_s;
    if (late_s > Math.max(LATE_MIN_S, worst?.late_s ?? 0)) worst = { late_s, limit };
  }
  return worst;
}

/** Whether a joint rests at a key: it is held, turns round there, or is the first or last.
 * @param {Stop[]} stops @param {number} index */
export function rests(stops, index) {
  const [before, own, after] = [stops[index - 1], stops[index], stops[index + 1]];
  if (before === undefined || own === undefined || after === undefined || own.hold_s > 0) return true;
  return (own.deg - before.deg) * (after.deg - own.deg) <= 0;
}

/**
 * Return the least and largest angle at an instant that its neighbours and the range allow.
 * @param {Limits} limits @param {Stop | undefined} before @param {Stop | undefined} after
 * @param {number} at_s @returns {[number, number]}
 */
export function corridor(limits, before, after, at_s) {
  let [low, high] = limits.range_deg;
  for (const [near, away_s] of /** @type {[Stop | undefined, number][]} */ ([
    [before, before === undefined ? 0 : at_s - before.at_s - before.hold_s],
    [after, after === undefined ? 0 : after.at_s - at_s],
  ])) {
    if (near === undefined) continue;
    const reach_deg = Math.max(away_s, 0) * limits.speed_max_deg_s;
    low = Math.max(low, near.deg - reach_deg);
    high = Math.min(high, near.deg + reach_deg);
  }
  return [low, high];
}
