// @ts-check
/** New tracks: which joints are free, and with which angles they begin. Pure. */

/** @typedef {{ name: string, range_deg?: [number, number] }} RobotJoint */
/** @typedef {{ joints?: RobotJoint[], poses?: Record<string, Record<string, number>> }} RobotView */

/** Return the joints of a robot that the file does not key itself. @param {any} value of the file @param {RobotView | null} robot */
export function freeJoints(value, robot) {
  const keyed = new Set();
  const lists = [value.keyframes ?? [], ...Object.values(value.tracks ?? {}).map((/** @type {any} */ track) => track.keyframes ?? [])];
  for (const key of lists.flat()) {
    for (const joint of Object.keys(key.deg ?? {})) keyed.add(joint);
    for (const joint of Object.keys(robot?.poses?.[key.pose] ?? {})) keyed.add(joint);
  }
  return (robot?.joints ?? []).map(({ name }) => name).filter((name) => !keyed.has(name));
}

/** Where a track begins: at 0°, or the end of the range that is nearest to it.
 * @param {RobotView | null} robot @param {string[]} joints @returns {Record<string, number>} */
export function startAngles(robot, joints) {
  return Object.fromEntries(joints.map((name) => {
    const [least, most] = robot?.joints?.find((own) => own.name === name)?.range_deg ?? [0, 0];
    return [name, Math.min(Math.max(0, least), most)];
  }));
}

/** Return a track with one key, and a name that no other has: that of its joint, if there is one.
 * @param {any} value of the file @param {string[]} joints @param {Record<string, number>} deg */
export function newTrack(value, joints, deg) {
  const taken = Object.keys(value.tracks ?? {});
  const base = joints.length === 1 ? joints[0] ?? "track" : "track";
  let name = base;
  for (let number = 2; taken.includes(name); number += 1) name = `${base}_${number}`;
  return { name, track: { keyframes: [{ at_s: 0, deg }] } };
}
