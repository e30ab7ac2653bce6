// @ts-check
/** From where a figure is seen: directions, named views, and points of the world in pixels. Pure. */

import { POINT } from "./kinematics.js";

/** @typedef {import("./kinematics.js").Cloud} Cloud */
/** @typedef {{yaw_deg: number, pitch_deg: number}} Direction from the figure to the eye */
/** @typedef {{width_px: number, height_px: number}} Size CSS pixels */
/** @typedef {{right: number[], up: number[], toward: number[]}} Axes of the screen, in the world */
/** @typedef {Axes & {centre: number[], px_per_mm: number, size: Size}} Projection */

/** @type {Record<string, Direction>} */
export const VIEWS = {
  Perspective: { yaw_deg: -32, pitch_deg: 12 },
  Front: { yaw_deg: 0, pitch_deg: 0 },
  Side: { yaw_deg: -90, pitch_deg: 0 },
  Top: { yaw_deg: -90, pitch_deg: 89.9 },
};

export const PITCH_MAX_DEG = 89.9;
export const ZOOM_LEAST = 0.3;
export const ZOOM_MOST = 6;

/** Share of the picture that the figure fills. */
const FILL_RATIO = 0.9;

/** @param {Direction} direction @returns {Axes} */
export function axesOf(direction) {
  const yaw = (direction.yaw_deg * Math.PI) / 180;
  const pitch = (direction.pitch_deg * Math.PI) / 180;
  return {
    toward: [Math.cos(pitch) * Math.cos(yaw), Math.cos(pitch) * Math.sin(yaw), Math.sin(pitch)],
    right: [-Math.sin(yaw), Math.cos(yaw), 0],
    up: [-Math.sin(pitch) * Math.cos(yaw), -Math.sin(pitch) * Math.sin(yaw), Math.cos(pitch)],
  };
}

/** @param {number[]} one @param {number[]} two */
export function dot(one, two) {
  return one[0] * two[0] + one[1] * two[1] + one[2] * two[2];
}

/**
 * Return the least and largest coordinate of a cloud along each axis of the screen.
 * @param {Cloud} cloud @param {Axes} axes
 */
export function extentsOf(cloud, axes) {
  const { points } = cloud;
  return [axes.right, axes.up, axes.toward].map(([x, y, z]) => {
    let [low, high] = [Infinity, -Infinity];
    for (let i = 0; i < points.length; i += POINT) {
      const at = x * points[i] + y * points[i + 1] + z * points[i + 2];
      low = Math.min(low, at - points[i + 3]);
      high = Math.max(high, at + points[i + 3]);
    }
    return low <= high ? { low, high } : { low: -1, high: 1 };
  });
}

/** Return the middle of a cloud, as it is seen. @param {{low: number, high: number}[]} extents @param {Axes} axes */
export function middleOf(extents, axes) {
  return [0, 1, 2].map((axis) =>
    [axes.right, axes.up, axes.toward].reduce(
      (sum, along, i) => sum + (along[axis] * (extents[i].low + extents[i].high)) / 2,
      0,
    ),
  );
}

/**
 * Return how far from `middle` an eye must be to see all of a cloud within these slopes.
 * @param {Cloud} cloud @param {Axes} axes @param {number[]} middle @param {number} slope_x @param {number} slope_y
 */
export function distanceFor(cloud, axes, middle, slope_x, slope_y) {
  const { points } = cloud;
  let distance_mm = 1;
  for (let i = 0; i < points.length; i += POINT) {
    const from = [points[i] - middle[0], points[i + 1] - middle[1], points[i + 2] - middle[2]];
    const across = Math.max(
      (Math.abs(dot(from, axes.right)) + points[i + 3]) / slope_x,
      (Math.abs(dot(from, axes.up)) + points[i + 3]) / slope_y,
    );
    distance_mm = Math.max(distance_mm, across + dot(from, axes.toward));
  }
  return distance_mm;
}

/**
 * Return the projection by which the cloud fills the picture, seen from `direction`.
 * @param {Cloud} cloud @param {Direction} direction @param {number} zoom @param {Size} size
 * @returns {Projection}
 */
export function projectionOf(cloud, direction, zoom, size) {
  const axes = axesOf(direction);
  const extents = extentsOf(cloud, axes);
  const [width_mm, height_mm] = extents.map(({ low, high }) => Math.max(1, high - low));
  const fit = Math.min(size.width_px / width_mm, size.height_px / height_mm);
  return { ...axes, centre: middleOf(extents, axes), px_per_mm: FILL_RATIO * fit * zoom, size };
}

/** Return x and y in pixels, and how near the point is. @param {Projection} to @param {number[]} point_mm */
export function projected(to, point_mm) {
  const from = [0, 1, 2].map((axis) => point_mm[axis] - to.centre[axis]);
  return [
    to.size.width_px / 2 + to.px_per_mm * dot(from, to.right),
    to.size.height_px / 2 - to.px_per_mm * dot(from, to.up),
    dot(from, to.toward),
  ];
}

/** Return the direction after a drag by so many pixels. @param {Direction} from @param {number} x_px @param {number} y_px @returns {Direction} */
export function dragged(from, x_px, y_px) {
  const pitch_deg = from.pitch_deg + 0.4 * y_px;
  return {
    yaw_deg: from.yaw_deg - 0.4 * x_px,
    pitch_deg: Math.min(Math.max(pitch_deg, -PITCH_MAX_DEG), PITCH_MAX_DEG),
  };
}

/** @param {number} zoom @param {number} wheel_px */
export function zoomed(zoom, wheel_px) {
  return Math.min(Math.max(zoom * Math.exp(-0.0015 * wheel_px), ZOOM_LEAST), ZOOM_MOST);
}
