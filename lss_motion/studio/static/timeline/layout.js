// @ts-check
/**
 * Where everything of the timeline stands: the same rows for drawing, hit test and mirror. Pure.
 *
 * Rows have heights of content; what is above the scrolled joints (ruler, events, lanes) stays.
 */

/** @typedef {import("../state.js").View} View */
/**
 * @typedef {object} Row
 * @property {"ruler" | "marks" | "parts" | "events" | "wave" | "lane" | "joint" | "line"} kind
 * @property {string} name
 * @property {number} index of the lane, joint, waveform or line
 * @property {number} y_px of its top; of a scrolled row, below the top of the scrolled rows
 * @property {number} height_px
 */
/** @typedef {{ fixed: Row[], scrolled: Row[], fixed_px: number, scrolled_px: number }} Layout */

export const NAMES_PX = 150;
export const RULER_PX = 26;
const MARKS_PX = 20;
const EVENTS_PX = 22;
const WAVE_PX = 40;
const LANE_PX = 22;
const LINE_PX = 34;
export const JOINT_PX = 76;
/** A show with many joints gets lower rows. */
const JOINT_LOW_PX = 64;
const MANY_JOINTS = 9;
/** A show with few joints gets higher ones, in which an angle can be taken well. */
const JOINT_HIGH_PX = 200;
/** More lanes than these are scrolled with the joints. */
const FIXED_LANES_MAX = 4;

/** Return the rows of a view, as high as there is room. @param {View} view @param {number} [height_px] @returns {Layout} */
export function layoutOf(view, height_px = 0) {
  /** @type {Row[]} */
  const fixed = [];
  /** @type {Row[]} */
  const scrolled = [];
  /** @param {Row[]} to @param {Row["kind"]} kind @param {string} name @param {number} index @param {number} height_px */
  const add = (to, kind, name, index, height_px) => {
    to.push({ kind, name, index, y_px: heightOf(to), height_px });
  };
  add(fixed, "ruler", "", 0, RULER_PX);
  if (view.marks.length > 0) add(fixed, "marks", "labels", 0, MARKS_PX);
  if (view.parts.length > 0) add(fixed, "parts", "parts", 0, MARKS_PX);
  if (view.events.length > 0) add(fixed, "events", "events", 0, EVENTS_PX);
  view.waveforms.forEach((form, index) => {
    if (index === 0 || form.is_bed) add(fixed, "wave", form.text, index, WAVE_PX);
  });
  const lanes = view.lanes.length > FIXED_LANES_MAX ? scrolled : fixed;
  view.lanes.forEach((lane, index) => add(lanes, "lane", lane.name, index, LANE_PX));
  const least_px = view.joints.length > MANY_JOINTS ? JOINT_LOW_PX : JOINT_PX;
  const room_px = height_px - heightOf(fixed) - heightOf(scrolled) - LINE_PX * Object.keys(view.line).length;
  const joint_px = Math.max(Math.min(Math.floor(room_px / view.joints.length), JOINT_HIGH_PX), least_px);
  view.joints.forEach((joint, index) => add(scrolled, "joint", joint.name, index, joint_px));
  Object.keys(view.line).forEach((bus, index) => add(scrolled, "line", bus, index, LINE_PX));
  return { fixed, scrolled, fixed_px: heightOf(fixed), scrolled_px: heightOf(scrolled) };
}

/** @param {Row[]} rows */
function heightOf(rows) {
  const last = rows.at(-1);
  return last === undefined ? 0 : last.y_px + last.height_px;
}

/** Return the rows that can be walked through by keyboard. @param {Layout} layout */
export function walkedRows(layout) {
  return [...layout.fixed, ...layout.scrolled].filter((row) => row.kind === "lane" || row.kind === "joint");
}

/** Return the rows that are seen, with their place on the canvas.
 * @param {Layout} layout @param {number} scroll_px @param {number} height_px @returns {Row[]} */
export function rowsInSight(layout, scroll_px, height_px) {
  const top_px = layout.fixed_px;
  const seen = layout.scrolled
    .map((row) => ({ ...row, y_px: row.y_px + top_px - scroll_px }))
    .filter((row) => row.y_px + row.height_px > top_px && row.y_px < height_px);
  return [...layout.fixed, ...seen];
}

/** Return how far the rows may be scrolled. @param {Layout} layout @param {number} height_px */
export function scrollMax(layout, height_px) {
  return Math.max(0, layout.scrolled_px + layout.fixed_px - height_px);
}

/** Return how far to scroll so that a row is seen.
 * @param {Layout} layout @param {Row} row @param {number} scroll_px @param {number} height_px */
export function scrolledTo(layout, row, scroll_px, height_px) {
  if (!layout.scrolled.includes(row)) return scroll_px;
  const room_px = Math.max(height_px - layout.fixed_px, row.height_px);
  if (row.y_px < scroll_px) return row.y_px;
  return Math.max(scroll_px, row.y_px + row.height_px - room_px);
}

/** Return least and largest value of a joint's row. @param {import("../state.js").JointView} joint
 * @param {0 | 1 | 2} order @param {[number, number]} used_deg least and largest angle of the plan */
export function rangeOf(joint, order, used_deg) {
  if (order === 1) return /** @type {const} */ ([-1.15 * joint.speed_max_deg_s, 1.15 * joint.speed_max_deg_s]);
  if (order === 2) return /** @type {const} */ ([-1.15 * joint.accel_max_deg_s2, 1.15 * joint.accel_max_deg_s2]);
  const room_deg = Math.max(0.12 * (used_deg[1] - used_deg[0]), 2);
  return /** @type {const} */ ([used_deg[0] - room_deg, used_deg[1] + room_deg]);
}
