// @ts-check
/**
 * Where the links of a figure stand, for joint angles. Pure: no document, no clock.
 *
 * The rule is that of `lss_motion/robot/figure.py`, which makes the figure:
 * link = parent · origin_mm · rotation · turn about axis by ratio · (deg - rest_deg).
 * mm; x forward, y left, z up.
 */

/**
 * @typedef {object} Shape
 * @property {"box" | "cylinder" | "sphere" | "capsule" | "ellipsoid" | "mesh"} kind
 * @property {number[]} size_mm as `Shape` of `robot/figure.py`
 * @property {number[]} origin_mm
 * @property {number[]} rotation nine numbers, by rows
 * @property {string | null} path
 * @property {null | "dark" | "light"} shade null: that of the figure
 * @property {number[][]} [corners_mm] of a mesh that is loaded, in its link
 */
/**
 * @typedef {object} Link
 * @property {string} name
 * @property {number} parent index of an earlier link; -1: the ground
 * @property {string | null} joint
 * @property {number} ratio
 * @property {number} rest_deg
 * @property {number[]} axis
 * @property {number[]} origin_mm
 * @property {number[]} rotation nine numbers, by rows
 * @property {number[][][]} lines_mm
 * @property {number} width_mm
 * @property {null | "dark" | "light"} shade null: that of the figure
 * @property {Shape[]} shapes
 */
/**
 * @typedef {object} Figure
 * @property {"figure" | "legs" | "urdf"} source
 * @property {Link[]} links
 * @property {[number, number[]][]} feet
 * @property {number} reach_mm
 * @property {string[]} notes
 */
/** @typedef {Record<string, number | null>} Pose joint angles in degrees; null or NaN: unknown */
/** @typedef {{points: number[], low: number[], high: number[]}} Cloud `POINT` numbers a point */

/** A bar that is thicker than this share of its length is drawn with flat ends and no knuckle. */
const THICK_RATIO = 0.25;

/** Numbers of one link in `placeLinks`: three rows of a rotation, each followed by its origin. */
export const STRIDE = 12;

/**
 * Return the frame of each link in the world, `STRIDE` numbers a link.
 * @param {Figure} figure @param {Pose} pose @returns {Float64Array}
 */
export function placeLinks(figure, pose) {
  const placed = new Float64Array(STRIDE * figure.links.length);
  const turn = new Float64Array(9);
  const local = new Float64Array(9);
  figure.links.forEach((link, index) => {
    const deg = link.joint === null ? null : pose[link.joint];
    const known_deg = typeof deg === "number" && Number.isFinite(deg) ? deg : link.rest_deg;
    turnAbout(link.axis, (link.ratio * (known_deg - link.rest_deg) * Math.PI) / 180, turn);
    multiply(link.rotation, turn, local);
    append(placed, link.parent * STRIDE, local, link.origin_mm, index * STRIDE);
  });
  return placed;
}

/**
 * Return a point of a link in the world.
 * @param {Float64Array} placed @param {number} link @param {number[]} point_mm
 */
export function pointAt(placed, link, point_mm) {
  const at = link * STRIDE;
  const [x, y, z] = point_mm;
  return [0, 4, 8].map(
    (row) =>
      placed[at + row] * x + placed[at + row + 1] * y + placed[at + row + 2] * z + placed[at + row + 3],
  );
}

/** From this difference on two poses can be told apart: a fast joint lags its plan by less. */
const APART_DEG = 4;

/** Return which links stand elsewhere in two poses. @param {Figure} figure @param {Pose} one @param {Pose} other */
export function linksApart(figure, one, other) {
  /** @type {boolean[]} */
  const apart = [];
  for (const { parent, joint } of figure.links) {
    const off_deg = joint === null ? 0 : Math.abs((one[joint] ?? NaN) - (other[joint] ?? NaN));
    apart.push(off_deg > APART_DEG || (apart[parent] ?? false));
  }
  return apart;
}

/** @param {number} width_mm @param {number[]} from @param {number[]} to */
export function isThick(width_mm, from, to) {
  return width_mm > THICK_RATIO * Math.hypot(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
}

/**
 * Return the height of the ground: below the lowest foot, or 0 without feet.
 * @param {Figure} figure @param {Float64Array} placed
 */
export function groundOf(figure, placed) {
  const heights = figure.feet.map(([link, point_mm]) => pointAt(placed, link, point_mm)[2]);
  return heights.length > 0 ? Math.min(...heights) : 0;
}

/** Numbers of one point of a cloud: x, y, z, and the radius of what is drawn there. */
export const POINT = 4;

/**
 * Return where a figure is drawn in these poses, added to what is `known`, over a ground at z 0.
 * With `isSparse` only points are added that lie beyond those that are known.
 * @param {Figure} figure @param {(Pose | null)[]} poses @param {Cloud | null} known
 * @returns {Cloud}
 */
export function cloudOf(figure, poses, known, isSparse = false) {
  const cloud = known ?? { points: [], low: [0, 0, 0], high: [0, 0, 0] };
  for (const pose of poses) {
    if (pose === null) continue;
    const placed = placeLinks(figure, pose);
    const ground_mm = groundOf(figure, placed);
    figure.links.forEach((link, index) => {
      const half_mm = link.lines_mm.length > 0 ? link.width_mm / 2 : 0;
      const points = [[0, 0, 0], ...link.lines_mm.flat(), ...link.shapes.flatMap(shapeCorners)];
      for (const point of points) {
        const at = pointAt(placed, index, point);
        at[2] -= ground_mm;
        if (widened(cloud, at, half_mm) || !isSparse) cloud.points.push(...at, half_mm);
      }
    });
  }
  return cloud;
}

/** Widen the bounds of a cloud; return whether that was needed. @param {Cloud} cloud @param {number[]} at @param {number} half_mm */
function widened(cloud, at, half_mm) {
  let isBeyond = false;
  for (let axis = 0; axis < 3; axis += 1) {
    isBeyond ||= at[axis] - half_mm < cloud.low[axis] || at[axis] + half_mm > cloud.high[axis];
    cloud.low[axis] = Math.min(cloud.low[axis], at[axis] - half_mm);
    cloud.high[axis] = Math.max(cloud.high[axis], at[axis] + half_mm);
  }
  return isBeyond;
}

/** @param {Shape} shape points that it does not reach beyond; of a mesh its corners once it is loaded */
function shapeCorners(shape) {
  if (shape.corners_mm !== undefined) return shape.corners_mm;
  return shape.kind === "mesh" ? [shape.origin_mm] : boxCorners(shape);
}

/** Corners of a box that are joined by an edge. */
export const BOX_EDGES = [...Array(8).keys()].flatMap((corner) =>
  [1, 2, 4].filter((bit) => !(corner & bit)).map((bit) => [corner, corner | bit]));

/** Return the corners of the box round a shape that is no mesh, in its link. @param {Shape} shape */
export function boxCorners(shape) {
  const [a, b = a, c = b] = shape.size_mm;
  const halves = {
    box: [a / 2, b / 2, c / 2],
    cylinder: [a, a, b / 2],
    sphere: [a, a, a],
    capsule: [a, a, a + b / 2],
    ellipsoid: [a, b, c],
    mesh: [0, 0, 0],
  }[shape.kind];
  return [...Array(8).keys()].map((corner) =>
    pointOn(shape, halves.map((half, axis) => (corner & (1 << axis) ? half : -half))));
}

/** Return a point of a shape in its link. @param {Shape} shape @param {number[]} point */
export function pointOn({ origin_mm, rotation }, point) {
  return [0, 1, 2].map((row) => origin_mm[row] + dot3(rotation, 3 * row, point));
}

/** @param {number[]} rotation @param {number} at @param {number[]} point */
function dot3(rotation, at, [x, y, z]) {
  return rotation[at] * x + rotation[at + 1] * y + rotation[at + 2] * z;
}

/**
 * Write the rotation about a unit vector into `turn` (Rodrigues).
 * @param {number[]} axis @param {number} angle_rad @param {Float64Array} turn
 */
function turnAbout(axis, angle_rad, turn) {
  const [x, y, z] = axis;
  const cosine = Math.cos(angle_rad);
  const sine = Math.sin(angle_rad);
  const rest = 1 - cosine;
  turn[0] = cosine + rest * x * x;
  turn[1] = rest * x * y - sine * z;
  turn[2] = rest * x * z + sine * y;
  turn[3] = rest * x * y + sine * z;
  turn[4] = cosine + rest * y * y;
  turn[5] = rest * y * z - sine * x;
  turn[6] = rest * x * z - sine * y;
  turn[7] = rest * y * z + sine * x;
  turn[8] = cosine + rest * z * z;
}

/** @param {ArrayLike<number>} one @param {ArrayLike<number>} two @param {Float64Array} product */
function multiply(one, two, product) {
  for (let row = 0; row < 9; row += 3) {
    for (let column = 0; column < 3; column += 1) {
      product[row + column] =
        one[row] * two[column] + one[row + 1] * two[column + 3] + one[row + 2] * two[column + 6];
    }
  }
}

/**
 * Write the frame of a link behind the frame at `parent` (below 0: the world) to `at`.
 * @param {Float64Array} placed @param {number} parent @param {Float64Array} rotation
 * @param {number[]} origin_mm @param {number} at
 */
function append(placed, parent, rotation, origin_mm, at) {
  for (let row = 0; row < 3; row += 1) {
    const own = parent < 0 ? null : placed.subarray(parent + 4 * row, parent + 4 * row + 4);
    const [a, b, c, origin] = own ?? [row === 0 ? 1 : 0, row === 1 ? 1 : 0, row === 2 ? 1 : 0, 0];
    for (let column = 0; column < 3; column += 1) {
      placed[at + 4 * row + column] =
        a * rotation[column] + b * rotation[column + 3] + c * rotation[column + 6];
    }
    placed[at + 4 * row + 3] = a * origin_mm[0] + b * origin_mm[1] + c * origin_mm[2] + origin;
  }
}
