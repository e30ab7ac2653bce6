// @ts-check
/** From where a figure is seen: directions, named views, and points of the world in pixels. Pure. */

/** @typedef {import("./kinematics.js").Box} Box */
/** @typedef {{yaw_deg: number, pitch_deg: number}} Direction from the figure to the eye */
/** @typedef {{width_px: number, height_px: number}} Size CSS pixels */
/** @typedef {{right: number[], up: number[], toward: number[]}} Axes of the screen, in the world */
/** @typedef {Axes & {centre: number[], px_per_mm: number, size: Size}} Projection */

/** @type {Record<string, Direction>} */
export const VIEWS = {
  Perspective: { yaw_deg: -55, pitch_deg: 18 },
  Front: { yaw_deg: 0, pitch_deg: 0 },
  Side: { yaw_deg: -90, pitch_deg: 0 },
  Top: { yaw_deg: -90, pitch_deg: 89.9 },
};

export const PITCH_MAX_DEG = 89.9;
export const ZOOM_LEAST = 0.3;
export const ZOOM_MOST = 6;

/** Share of the picture that the figure fills. */
const FILL_RATIO = 0.95;

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

/** @param {Box} box */
export function centreOf(box) {
  return box.low.map((low, axis) => (low + box.high[axis]) / 2);
}

/**
 * Return half of the width, height and depth of a box, as it is seen.
 * @param {Box} box @param {Axes} axes
 */
export function halvesOf(box, axes) {
  const centre = centreOf(box);
  const halves = [1, 1, 1];
  for (let corner = 0; corner < 8; corner += 1) {
    const point = [0, 1, 2].map(
      (axis) => ((corner >> axis) & 1 ? box.high[axis] : box.low[axis]) - centre[axis],
    );
    [axes.right, axes.up, axes.toward].forEach((along, i) => {
      halves[i] = Math.max(halves[i], Math.abs(dot(point, along)));
    });
  }
  return halves;
}

/**
 * Return the projection by which the box fills the picture, seen from `direction`.
 * @param {Box} box @param {Direction} direction @param {number} zoom @param {Size} size
 * @returns {Projection}
 */
export function projectionOf(box, direction, zoom, size) {
  const axes = axesOf(direction);
  const [half_width, half_height] = halvesOf(box, axes);
  const fit = Math.min(size.width_px / half_width, size.height_px / half_height) / 2;
  return { ...axes, centre: centreOf(box), px_per_mm: FILL_RATIO * fit * zoom, size };
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
