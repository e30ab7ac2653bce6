// @ts-check
/** How a walking figure stands: its feet on the ground, the polygon between them, and the margin. Pure. */

import { angleAt } from "../curves.js";
import { placeLinks, pointAt } from "../figure/kinematics.js";

/** @typedef {import("../figure/kinematics.js").Figure} Figure */
/** @typedef {[number, number]} Point seen from above: x forward, y left, mm */
/** @typedef {{ at_mm: Point, isDown: boolean }} Foot */
/** @typedef {{ feet: Foot[], polygon: Point[], margin_mm: number }} Footing */

/** A foot that is higher than this over the lowest one is in the air. Chosen: half of a low step. */
const DOWN_MM = 2;
/** Instants at which the least margin is looked for are so far apart. Chosen: no step is shorter. */
const STEP_S = 0.05;

/**
 * Return how the figure stands with these angles; the margin is from the middle between the hips to the nearest
 * edge, negative where that is outside. @param {Figure} figure @param {Record<string, number>} pose @returns {Footing}
 */
export function footingOf(figure, pose) {
  const placed = placeLinks(figure, pose);
  const points = figure.feet.map(([link, point_mm]) => pointAt(placed, link, point_mm));
  const ground_mm = Math.min(...points.map((point) => Number(point[2])));
  const feet = points.map((point) => ({
    at_mm: /** @type {Point} */ ([Number(point[0]), Number(point[1])]), isDown: Number(point[2]) - ground_mm < DOWN_MM,
  }));
  const polygon = hullOf(feet.filter((foot) => foot.isDown).map((foot) => foot.at_mm));
  return { feet, polygon, margin_mm: marginOf(polygon, [0, 0]) };
}

/** The convex hull of points, counterclockwise. @param {Point[]} points @returns {Point[]} */
export function hullOf(points) {
  const sorted = [...points].sort((one, other) => one[0] - other[0] || one[1] - other[1]);
  /** @param {Point[]} all */
  const half = (all) => {
    /** @type {Point[]} */
    const found = [];
    for (const point of all) {
      while (found.length > 1 && turnOf(/** @type {Point} */ (found.at(-2)), /** @type {Point} */ (found.at(-1)), point) <= 0) found.pop();
      found.push(point);
    }
    return found.slice(0, -1);
  };
  return sorted.length < 3 ? sorted : [...half(sorted), ...half(sorted.reverse())];
}

/** Above 0 where the way bends to the left. @param {Point} one @param {Point} two @param {Point} three */
function turnOf(one, two, three) {
  return (two[0] - one[0]) * (three[1] - one[1]) - (two[1] - one[1]) * (three[0] - one[0]);
}

/** How far a point is inside of a polygon; less than 0 outside of it. @param {Point[]} polygon counterclockwise @param {Point} point */
export function marginOf(polygon, point) {
  if (polygon.length < 3) return -Infinity;
  return Math.min(...polygon.map((one, index) => {
    const other = /** @type {Point} */ (polygon[(index + 1) % polygon.length]);
    return turnOf(one, other, point) / Math.hypot(other[0] - one[0], other[1] - one[1]);
  }));
}

/** The pose of the plan at an instant. @param {import("../state.js").View} view @param {number} at_s @returns {Record<string, number>} */
export function poseAt(view, at_s) {
  return Object.fromEntries(view.joints.flatMap(({ name }) => {
    const curve = view.curves[name]?.plan;
    return curve === undefined ? [] : [[name, angleAt(curve, at_s)]];
  }));
}

/** The least margin of the show while it stands or walks, and when. @param {Figure} figure @param {import("../state.js").View} view */
export function leastMargin(figure, view) {
  let least = { margin_mm: Infinity, at_s: 0 };
  for (let at_s = 0; at_s <= view.view_s; at_s += STEP_S) {
    const { margin_mm } = footingOf(figure, poseAt(view, at_s));
    if (margin_mm < least.margin_mm) least = { margin_mm, at_s };
  }
  return least;
}
