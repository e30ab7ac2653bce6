// @ts-check
/** A figure on a 2D canvas. It works in every browser. `drawStick` is pure but for its context. */

import { boxCorners, cloudOf, groundOf, isThick, linksApart, placeLinks, pointAt, pointOn, STRIDE } from "./kinematics.js";
import { dot, projected, projectionOf } from "./camera.js";
import { Orbit } from "./orbit.js";

/** @typedef {import("./kinematics.js").Figure} Figure */
/** @typedef {import("./kinematics.js").Pose} Pose */
/** @typedef {import("./kinematics.js").Cloud} Cloud */
/** @typedef {import("./camera.js").Projection} Projection */
/**
 * @typedef {object} Poses
 * @property {Pose} solid where the robot is, as far as it `isRead`; else the plan
 * @property {boolean} isRead
 * @property {Pose | null} authored drawn as a dashed ghost
 * @property {Pose | null} line the other one of plan and reading, as a thin line
 */
/** @typedef {Record<"plan" | "reading" | "edge" | "authored" | "ground" | "dark" | "light", string>} Palette */

/** Lines of the ground on each side of its middle. */
const GROUND_LINES = 5;
const GHOST_DASH_PX = [5, 4];
const GHOST_WIDTH_PX = 1.5;
const LINE_WIDTH_PX = 1.5;
const LINE_DOT_PX = 2.5;
const WIDTH_LEAST_PX = 2;

/** Colours of the solid figure and of the thin line. @param {Poses} poses @param {Palette} palette */
export function coloursOf({ isRead }, palette) {
  return isRead ? { solid: palette.reading, line: palette.plan } : { solid: palette.plan, line: palette.reading };
}

/**
 * Draw the figure in its poses: one solid, authored as a dashed ghost, the other as a thin line.
 * @param {CanvasRenderingContext2D} ctx @param {Figure} figure @param {Poses} poses
 * @param {Projection} to @param {Palette} palette
 */
export function drawStick(ctx, figure, poses, to, palette) {
  ctx.clearRect(0, 0, to.size.width_px, to.size.height_px);
  ctx.lineCap = "round";
  ctx.lineJoin = "round";
  const placed = placeLinks(figure, poses.solid);
  const colours = coloursOf(poses, palette);
  const ground_mm = groundOf(figure, placed);
  drawGround(ctx, figure.reach_mm, to, palette);
  if (poses.authored !== null) {
    ctx.strokeStyle = palette.authored;
    ctx.lineWidth = GHOST_WIDTH_PX;
    ctx.setLineDash(GHOST_DASH_PX);
    strokeLines(ctx, figure, placeLinks(figure, poses.authored), ground_mm, to);
    ctx.setLineDash([]);
  }
  drawSolid(ctx, figure, placed, ground_mm, to, { ...palette, solid: colours.solid });
  if (poses.line !== null) {
    ctx.strokeStyle = colours.line;
    ctx.fillStyle = colours.line;
    ctx.lineWidth = LINE_WIDTH_PX;
    const apart = linksApart(figure, poses.solid, poses.line);
    strokeLines(ctx, figure, placeLinks(figure, poses.line), ground_mm, to, LINE_DOT_PX, (link) => apart[link] ?? false);
  }
}

/**
 * Return the lines of all links in pixels, each with its width and how near it is, farthest first.
 * @param {Figure} figure @param {Float64Array} placed @param {number} ground_mm @param {Projection} to
 */
export function segmentsOf(figure, placed, ground_mm, to) {
  /** @type {{from: number[], to: number[], width_px: number, isThick: boolean, near: number, link: number, shade: null | "dark" | "light"}[]} */
  const segments = [];
  figure.links.forEach((link, index) => {
    for (const line of link.lines_mm) {
      const points = line.map((point) => onScreen(placed, index, point, ground_mm, to));
      for (let i = 1; i < points.length; i += 1) {
        segments.push({
          from: points[i - 1],
          to: points[i],
          width_px: Math.max(WIDTH_LEAST_PX, link.width_mm * to.px_per_mm),
          isThick: isThick(link.width_mm, line[i - 1], line[i]),
          near: (points[i - 1][2] + points[i][2]) / 2,
          link: index,
          shade: link.shade,
        });
      }
    }
    for (const shape of link.shapes) {
      if (shape.kind !== "capsule") continue;
      const [radius_mm, length_mm] = shape.size_mm;
      const [from, end] = [-1, 1].map((side) =>
        onScreen(placed, index, pointOn(shape, [0, 0, (side * length_mm) / 2]), ground_mm, to));
      segments.push({
        from, to: end, width_px: Math.max(WIDTH_LEAST_PX, 2 * radius_mm * to.px_per_mm), isThick: false,
        near: (from[2] + end[2]) / 2, link: index, shade: shape.shade,
      });
    }
  });
  return segments.sort((one, two) => one.near - two.near);
}

/** @param {Float64Array} placed @param {number} link @param {number[]} point @param {number} ground_mm @param {Projection} to */
function onScreen(placed, link, point, ground_mm, to) {
  const at = pointAt(placed, link, point);
  at[2] -= ground_mm;
  return projected(to, at);
}

/**
 * Return the boxes of all links as polygons in pixels.
 * @param {Figure} figure @param {Float64Array} placed @param {number} ground_mm @param {Projection} to
 */
export function boxesOf(figure, placed, ground_mm, to) {
  return figure.links.flatMap((link, index) => link.shapes.filter((shape) => shape.kind === "box").map((shape) => {
    const corners = boxCorners(shape).map((corner) => onScreen(placed, index, corner, ground_mm, to));
    const near = corners.reduce((sum, corner) => sum + corner[2], 0) / corners.length;
    return { link: index, near, shade: shape.shade, hull: hullOf(corners) };
  }));
}

/** Return the convex polygon around points of the screen (Andrew's monotone chain). @param {number[][]} points */
export function hullOf(points) {
  const sorted = [...points].sort((one, two) => one[0] - two[0] || one[1] - two[1]);
  const half = (/** @type {number[][]} */ row) => {
    /** @type {number[][]} */
    const chain = [];
    for (const point of row) {
      while (chain.length > 1 && !turnsLeft(chain[chain.length - 2], chain[chain.length - 1], point)) chain.pop();
      chain.push(point);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

/** @param {number[]} a @param {number[]} b @param {number[]} c */
function turnsLeft(a, b, c) {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0;
}

/** @param {CanvasRenderingContext2D} ctx @param {ReturnType<typeof boxesOf>[number]} box */
function boxPath(ctx, { hull }) {
  hull.forEach(([x_px, y_px], i) => (i === 0 ? ctx.moveTo(x_px, y_px) : ctx.lineTo(x_px, y_px)));
  ctx.closePath();
}

/**
 * Return the ellipsoids of all links as ellipses in pixels.
 * @param {Figure} figure @param {Float64Array} placed @param {number} ground_mm @param {Projection} to
 */
export function ballsOf(figure, placed, ground_mm, to) {
  return figure.links.flatMap((link, index) => link.shapes.filter((shape) => shape.kind === "ellipsoid").map((shape) => {
    const [x_px, y_px, near] = onScreen(placed, index, shape.origin_mm, ground_mm, to);
    // What the three half axes of it cover of the screen, as a 2 x 2 matrix of moments.
    let [xx, xy, yy] = [0, 0, 0];
    shape.size_mm.forEach((radius_mm, axis) => {
      const along = [0, 4, 8].map((row) => placed[index * STRIDE + row + axis]);
      const across_px = to.px_per_mm * radius_mm * dot(along, to.right);
      const up_px = -to.px_per_mm * radius_mm * dot(along, to.up);
      [xx, xy, yy] = [xx + across_px * across_px, xy + across_px * up_px, yy + up_px * up_px];
    });
    const [middle, spread] = [(xx + yy) / 2, Math.hypot((xx - yy) / 2, xy)];
    return {
      link: index, x_px, y_px, near, shade: shape.shade, turn_rad: Math.atan2(2 * xy, xx - yy) / 2,
      long_px: Math.sqrt(middle + spread), short_px: Math.sqrt(Math.max(middle - spread, 0)),
    };
  }));
}

/** @param {CanvasRenderingContext2D} ctx @param {ReturnType<typeof ballsOf>[number]} ball */
function ballPath(ctx, ball) {
  ctx.moveTo(ball.x_px + ball.long_px * Math.cos(ball.turn_rad), ball.y_px + ball.long_px * Math.sin(ball.turn_rad));
  ctx.ellipse(ball.x_px, ball.y_px, ball.long_px, ball.short_px, ball.turn_rad, 0, 2 * Math.PI);
}

/** @param {CanvasRenderingContext2D} ctx @param {Figure} figure @param {Float64Array} placed @param {number} ground_mm @param {Projection} to @param {Palette & { solid: string }} palette */
function drawSolid(ctx, figure, placed, ground_mm, to, palette) {
  const parts = [
    ...segmentsOf(figure, placed, ground_mm, to), ...ballsOf(figure, placed, ground_mm, to),
    ...boxesOf(figure, placed, ground_mm, to),
  ];
  // An edge around each part, so that parts in front of each other can be told apart.
  for (const part of parts.sort((one, two) => one.near - two.near)) {
    const shade = part.shade === null ? palette.solid : palette[part.shade];
    if (!("from" in part)) {
      ctx.fillStyle = shade;
      ctx.strokeStyle = palette.edge;
      ctx.lineWidth = 1;
      ctx.beginPath();
      if ("hull" in part) boxPath(ctx, part);
      else ballPath(ctx, part);
      ctx.fill();
      ctx.stroke();
      continue;
    }
    ctx.lineCap = part.isThick ? "butt" : "round";
    for (const [style, grow_px] of /** @type {[string, number][]} */ ([[palette.edge, 2], [shade, 0]])) {
      ctx.strokeStyle = style;
      ctx.lineWidth = part.width_px + grow_px;
      ctx.beginPath();
      ctx.moveTo(part.from[0], part.from[1]);
      ctx.lineTo(part.to[0], part.to[1]);
      ctx.stroke();
    }
  }
  ctx.lineCap = "round";
  ctx.fillStyle = palette.edge;
  figure.links.forEach((link, index) => {
    const line = link.lines_mm[0];
    if (link.joint === null || line === undefined) return;
    if (link.shapes.length > 0 || isThick(link.width_mm, line[0], line[1])) return;
    const [x_px, y_px] = onScreen(placed, index, [0, 0, 0], ground_mm, to);
    ctx.beginPath();
    ctx.arc(x_px, y_px, Math.max(1.5, 0.22 * link.width_mm * to.px_per_mm), 0, 2 * Math.PI);
    ctx.fill();
  });
}

/** @param {CanvasRenderingContext2D} ctx @param {Figure} figure @param {Float64Array} placed @param {number} ground_mm @param {Projection} to */
function strokeLines(ctx, figure, placed, ground_mm, to, dot_px = 0, isDrawn = (/** @type {number} */ _link) => true) {
  ctx.beginPath();
  const segments = segmentsOf(figure, placed, ground_mm, to).filter((own) => isDrawn(own.link));
  for (const segment of segments) {
    ctx.moveTo(segment.from[0], segment.from[1]);
    ctx.lineTo(segment.to[0], segment.to[1]);
  }
  for (const ball of ballsOf(figure, placed, ground_mm, to)) if (isDrawn(ball.link)) ballPath(ctx, ball);
  for (const box of boxesOf(figure, placed, ground_mm, to)) if (isDrawn(box.link)) boxPath(ctx, box);
  ctx.stroke();
  if (dot_px === 0) return;
  ctx.beginPath();
  for (const { to: end } of segments) {
    ctx.moveTo(end[0] + dot_px, end[1]);
    ctx.arc(end[0], end[1], dot_px, 0, 2 * Math.PI);
  }
  ctx.fill();
}

/** @param {CanvasRenderingContext2D} ctx @param {number} reach_mm @param {Projection} to @param {Palette} palette */
function drawGround(ctx, reach_mm, to, palette) {
  ctx.strokeStyle = palette.ground;
  ctx.lineWidth = 1;
  ctx.beginPath();
  for (let line = -GROUND_LINES; line <= GROUND_LINES; line += 1) {
    const across_mm = (line / GROUND_LINES) * reach_mm;
    for (const [from, end] of [
      [[across_mm, -reach_mm, 0], [across_mm, reach_mm, 0]],
      [[-reach_mm, across_mm, 0], [reach_mm, across_mm, 0]],
    ]) {
      const [x_px, y_px] = projected(to, from);
      const [end_x_px, end_y_px] = projected(to, end);
      ctx.moveTo(x_px, y_px);
      ctx.lineTo(end_x_px, end_y_px);
    }
  }
  ctx.stroke();
}

/** A figure on a 2D canvas. */
export class StickFigure {
  kind = /** @type {const} */ ("2d");
  /** @type {Cloud | null} */
  #cloud = null;

  /** Keep these poses in the picture. @param {import("./kinematics.js").Pose[]} poses */
  frame(poses) {
    this.#cloud = cloudOf(this.figure, poses, null);
  }

  /** @param {HTMLCanvasElement} canvas @param {Figure} figure @param {() => void} changed */
  constructor(canvas, figure, changed) {
    this.canvas = canvas;
    this.figure = figure;
    this.orbit = new Orbit(canvas, changed);
  }

  /** @param {Poses} poses @param {Palette} palette @param {import("./camera.js").Size} size @param {number} ratio device pixels per CSS pixel */
  draw(poses, palette, size, ratio) {
    const ctx = this.canvas.getContext("2d");
    if (ctx === null) return;
    this.#cloud = cloudOf(this.figure, [poses.solid, poses.authored], this.#cloud, true);
    const [width, height] = [Math.round(size.width_px * ratio), Math.round(size.height_px * ratio)];
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    const to = projectionOf(this.#cloud, this.orbit.direction, this.orbit.zoom, size);
    drawStick(ctx, this.figure, poses, to, palette);
  }

  dispose() {
    this.orbit.dispose();
  }
}
