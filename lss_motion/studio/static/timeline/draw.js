// @ts-check
/**
 * The timeline as a picture: rows, keys, holds, curves with limits, spans. Pure: everything is an
 * argument, so that a test can record what is drawn. Only what is in sight is drawn, and of a curve
 * the least and largest value of each column of pixels.
 */

import { angleAt, fillColumns, lowerBound, valueAt } from "../curves.js";
import { number } from "../numbers.js";
import { heightOf, isChosen } from "./keys.js";
import { rangeOf } from "./layout.js";
import { endOf, pixelOf, tickStep, timeText } from "./window.js";

/** @typedef {import("../state.js").View} View */
/** @typedef {import("../state.js").State} State */
/** @typedef {import("./layout.js").Row} Row */
/** @typedef {import("./window.js").Window} Window */
/** @typedef {import("./palette.js").Palette} Palette */
/** @typedef {CanvasRenderingContext2D} Ctx */
/**
 * @typedef {object} Scene what is drawn
 * @property {View} view @property {Row[]} rows in sight @property {Window} seen
 * @property {number} fixed_px height of the rows that stay @property {number} height_px
 * @property {0 | 1 | 2} order @property {State["selection"]} selection @property {number} row
 * @property {Palette} palette @property {import("../state.js").Ghosts} [ghosts] default: all but the predicted horn
 * @property {Record<string, [number, number]>} used_deg least and largest angle of each joint
 */

export const KEY_PX = 4.5;
/** Keys closer together than this are small ticks; closer than `CROWDED_PX` they hide the curve. */
const TIGHT_PX = 9;
const CROWDED_PX = 4;
/** A text is shortened to no less than this. */
const SHORT_PX = 40;
const FONT = "12px system-ui, sans-serif";
const SMALL = "11px system-ui, sans-serif";
const ERROR_PX = 9;
/** Readings of a joint that is polled normally are closer together. */
const GAP_S = 0.3;
export const UNITS = /** @type {const} */ (["deg", "deg/s", "deg/s²"]);

/** Columns of a curve, reused. */
const room = { lows: new Float32Array(0), highs: new Float32Array(0), other: new Float32Array(0), more: new Float32Array(0) };

/** Draw all rows; returns how many keys were drawn. @param {Ctx} ctx @param {Scene} scene */
export function drawTimeline(ctx, scene) {
  const { seen, rows, palette, fixed_px, height_px } = scene;
  ctx.fillStyle = palette.surface;
  ctx.fillRect(0, 0, seen.width_px, height_px);
  let keys = 0;
  ctx.save();
  clip(ctx, 0, fixed_px, seen.width_px, height_px - fixed_px);
  drawGrid(ctx, scene, fixed_px);
  for (const row of rows) if (row.y_px + row.height_px > fixed_px && isScrolled(scene, row)) keys += drawRow(ctx, scene, row);
  ctx.restore();
  drawGrid(ctx, scene, 0, fixed_px);
  for (const row of rows) if (!isScrolled(scene, row)) keys += drawRow(ctx, scene, row);
  ctx.fillStyle = palette.line;
  ctx.fillRect(0, fixed_px - 1, seen.width_px, 1);
  return keys;
}

/** @param {Scene} scene @param {Row} row */
function isScrolled(scene, row) {
  if (row.kind === "joint" || row.kind === "line") return true;
  return row.kind === "lane" && scene.view.lanes.length > 4;
}

/** @param {Ctx} ctx @param {number} x @param {number} y @param {number} width @param {number} height */
function clip(ctx, x, y, width, height) {
  ctx.beginPath();
  ctx.rect(x, y, width, height);
  ctx.clip();
}

/** @param {Ctx} ctx @param {Scene} scene @param {Row} row @returns {number} keys drawn */
function drawRow(ctx, scene, row) {
  const { palette, seen } = scene;
  ctx.fillStyle = palette.line;
  ctx.fillRect(0, row.y_px + row.height_px - 1, seen.width_px, 1);
  switch (row.kind) {
    case "ruler":
      drawRuler(ctx, scene, row);
      return 0;
    case "marks":
      drawTexts(ctx, scene, row, scene.view.marks.map((mark) => (
        { at_s: mark.at_s, text: mark.label, colour: mark.is_anchor ? palette.anchor : palette.text })));
      return 0;
    case "parts":
      drawParts(ctx, scene, row);
      return 0;
    case "events":
      drawEvents(ctx, scene, row);
      return 0;
    case "wave":
      drawWave(ctx, scene, row);
      return 0;
    case "lane":
      return drawLane(ctx, scene, row);
    case "joint":
      return drawJoint(ctx, scene, row);
    default:
      drawLine(ctx, scene, row);
      return 0;
  }
}

/** Vertical lines at the ticks. @param {Ctx} ctx @param {Scene} scene @param {number} top_px
 * @param {number} [bottom_px] */
function drawGrid(ctx, scene, top_px, bottom_px = scene.height_px) {
  const { seen, palette } = scene;
  const step_s = tickStep(seen, 84);
  ctx.fillStyle = palette.line;
  ctx.globalAlpha = 0.45;
  for (let tick = Math.ceil(seen.start_s / step_s); tick * step_s <= endOf(seen); tick += 1) {
    ctx.fillRect(Math.round(pixelOf(seen, tick * step_s)), top_px, 1, bottom_px - top_px);
  }
  ctx.globalAlpha = 1;
  // Outside of the show.
  ctx.fillStyle = palette.ground;
  const start_px = pixelOf(seen, 0);
  const end_px = pixelOf(seen, scene.view.view_s);
  if (start_px > 0) ctx.fillRect(0, top_px, start_px, bottom_px - top_px);
  if (end_px < seen.width_px) ctx.fillRect(end_px, top_px, seen.width_px - end_px, bottom_px - top_px);
}

/** @param {Ctx} ctx @param {Scene} scene @param {Row} row */
function drawRuler(ctx, scene, row) {
  const { seen, palette } = scene;
  const step_s = tickStep(seen, 84);
  ctx.font = FONT;
  ctx.fillStyle = palette.muted;
  ctx.textBaseline = "middle";
  for (let tick = Math.ceil(seen.start_s / step_s); tick * step_s <= endOf(seen); tick += 1) {
    const x_px = pixelOf(seen, tick * step_s) + 4;
    const text = timeText(tick * step_s, step_s);
    if (tick >= 0 && x_px + ctx.measureText(text).width <= seen.width_px) ctx.fillText(text, x_px, row.y_px + row.height_px / 2);
  }
  const { repeat } = scene.view;
  if (repeat !== null) {
    ctx.fillStyle = palette.authored;
    const x_px = pixelOf(seen, repeat.from_s);
    ctx.fillRect(x_px, row.y_px + 1, (repeat.to_s - repeat.from_s) * seen.px_per_s, 3);
  }
}

/** Texts in order, each beside its mark where it has room: it is whole, or shortened by "…", or left out.
 * @param {Ctx} ctx @param {Scene} scene @param {Row} row
 * @param {{ at_s: number, text: string, colour: string }[]} texts */
function drawTexts(ctx, scene, row, texts) {
  const { seen } = scene;
  ctx.font = FONT;
  ctx.textBaseline = "middle";
  let free_px = 0;
  for (const { at_s, text, colour } of texts) {
    const x_px = pixelOf(seen, at_s);
    if (x_px < -1 || x_px > seen.width_px) continue;
    ctx.fillStyle = colour;
    const width_px = ctx.measureText(text).width;
    const isLeft = x_px + 5 + width_px > seen.width_px && x_px - 4 - width_px >= free_px;
    const room_px = isLeft ? width_px : seen.width_px - x_px - 5;
    const hasRoom = isLeft || x_px >= free_px && room_px >= Math.min(width_px, SHORT_PX);
    ctx.fillRect(x_px - 0.5, row.y_px + (hasRoom ? 3 : row.height_px - 6), 1.5, hasRoom ? row.height_px - 6 : 5);
    if (!hasRoom) continue;
    ctx.fillText(fittedText(ctx, text, room_px), isLeft ? x_px - 4 - width_px : x_px + 5, row.y_px + row.height_px / 2);
    free_px = isLeft ? seen.width_px : x_px + 10 + Math.min(width_px, room_px);
  }
}

/** @param {Ctx} ctx @param {Scene} scene @param {Row} row */
function drawParts(ctx, scene, row) {
  const { seen, palette, view } = scene;
  ctx.font = FONT;
  ctx.textBaseline = "middle";
  for (const part of view.parts) {
    const x_px = pixelOf(seen, part.from_s);
    const width_px = (part.to_s - part.from_s) * seen.px_per_s;
    if (x_px > seen.width_px || x_px + width_px < 0) continue;
    ctx.fillStyle = palette.hold;
    ctx.fillRect(x_px + 1, row.y_px + 3, Math.max(width_px - 2, 1), row.height_px - 6);
    const left_px = Math.max(x_px, 0) + 6;
    const room_px = Math.min(x_px + width_px, seen.width_px) - left_px - 4;
    if (room_px < Math.min(ctx.measureText(part.name).width, SHORT_PX)) continue;
    ctx.fillStyle = palette.text;
    ctx.fillText(fittedText(ctx, part.name, room_px), left_px, row.y_px + row.height_px / 2);
  }
}

/** Events have a shape for their kind. @param {Ctx} ctx @param {Scene} scene @param {Row} row */
function drawEvents(ctx, scene, row) {
  const signs = /** @type {Record<string, string>} */ ({ sound: "♪", run: "ƒ", led: "◉", say: "“", wait: "⧗" });
  const { palette, view } = scene;
  drawTexts(ctx, scene, row, view.events.map((event) => (
    { at_s: event.at_s, text: `${signs[event.kind] ?? ""} ${event.text}`, colour: palette.event })));
}

/** @param {Ctx} ctx @param {Scene} scene @param {Row} row */
function drawWave(ctx, scene, row) {
  const { seen, palette, view } = scene;
  const form = view.waveforms[row.index];
  if (form === undefined) return;
  const middle_px = row.y_px + row.height_px / 2;
  if (form.peaks === undefined || form.rate_hz === undefined) {
    ctx.fillStyle = palette.muted;
    ctx.font = SMALL;
    const left_px = Math.max(pixelOf(seen, form.from_s), 4);
    if (left_px + SHORT_PX < seen.width_px) ctx.fillText(fittedText(ctx, form.error ?? "", seen.width_px - left_px), left_px, middle_px);
    return;
  }
  const pairs = form.peaks.length / 2;
  const first_px = Math.max(0, Math.floor(pixelOf(seen, form.from_s)));
  const last_px = Math.min(seen.width_px, Math.ceil(pixelOf(seen, form.to_s)));
  const per_px = form.rate_hz / seen.px_per_s;
  ctx.fillStyle = palette.wave;
  for (let x_px = first_px; x_px < last_px; x_px += 1) {
    const from = (seen.start_s + x_px / seen.px_per_s - form.from_s) * form.rate_hz;
    let low = 127;
    let high = -128;
    const count = Math.max(1, Math.min(Math.ceil(per_px), 400));
    for (let step = 0; step < count; step += 1) {
      let index = Math.floor(from + (step * per_px) / count);
      if (form.is_looped) index = ((index % pairs) + pairs) % pairs;
      if (index < 0 || index >= pairs) continue;
      low = Math.min(low, /** @type {number} */ (form.peaks[2 * index]));
      high = Math.max(high, /** @type {number} */ (form.peaks[2 * index + 1]));
    }
    if (high < low) continue;
    const scale = (row.height_px / 2 - 3) / 127;
    ctx.fillRect(x_px, middle_px - high * scale, 1, Math.max((high - low) * scale, 1));
  }
}

/** @param {Ctx} ctx @param {Scene} scene @param {Row} row */
function drawLane(ctx, scene, row) {
  const lane = /** @type {import("../state.js").Lane} */ (scene.view.lanes[row.index]);
  const y_px = row.y_px + row.height_px / 2;
  const chosen = chosenKeys(scene);
  return drawKeys(ctx, scene, lane.times_s, (index) => /** @type {import("../state.js").Key} */ (lane.keys[index]), y_px, (index) => isChosen(chosen, row.index, index, null));
}

/** @param {Scene} scene */
function chosenKeys({ selection }) {
  return selection?.kind === "keys" ? selection.keys : [];
}

/**
 * Draw the holds and keys of a row, a diamond each, an anchor as a square with a bar; return how
 * many. Keys on one pixel are one. @param {Ctx} ctx @param {Scene} scene
 * @param {ArrayLike<number>} times_s @param {(index: number) => { hold_s: number, is_anchor: boolean }} keyAt
 * @param {number} y_px @param {(index: number) => boolean} isOneChosen
 */
function drawKeys(ctx, scene, times_s, keyAt, y_px, isOneChosen) {
  const { seen, palette } = scene;
  const margin_s = 2 / seen.px_per_s + 30;
  const first = lowerBound(times_s, seen.start_s - margin_s);
  const end = lowerBound(times_s, endOf(seen) + KEY_PX / seen.px_per_s);
  ctx.fillStyle = palette.hold;
  for (let index = first; index < end; index += 1) {
    const { hold_s } = keyAt(index);
    if (hold_s > 0) ctx.fillRect(pixelOf(seen, /** @type {number} */ (times_s[index])), y_px - 2.5, hold_s * seen.px_per_s, 5);
  }
  let drawn = 0;
  const size_px = sizeOf(first, end, times_s, seen);
  for (const isAnchor of [false, true]) {
    ctx.fillStyle = isAnchor ? palette.anchor : palette.key;
    ctx.beginPath();
    let previous_px = -Infinity;
    for (let index = first; index < end; index += 1) {
      const key = keyAt(index);
      if (key.is_anchor !== isAnchor) continue;
      const x_px = pixelOf(seen, /** @type {number} */ (times_s[index]));
      if (x_px < -KEY_PX || x_px - previous_px < 1) continue;
      keyPath(ctx, x_px, y_px, isAnchor, size_px);
      previous_px = x_px;
      drawn += 1;
    }
    ctx.fill();
  }
  ctx.strokeStyle = palette.selected;
  ctx.lineWidth = 2;
  for (let index = first; index < end; index += 1) {
    if (isOneChosen(index)) ctx.strokeRect(pixelOf(seen, /** @type {number} */ (times_s[index])) - 7, y_px - 8, 14, 16);
  }
  return drawn;
}

/** Return half the width of the keys in sight: smaller where they are close together.
 * @param {number} first @param {number} end @param {ArrayLike<number>} times_s @param {Window} seen */
function sizeOf(first, end, times_s, seen) {
  if (end - first < 3) return KEY_PX;
  const span_s = /** @type {number} */ (times_s[end - 1]) - /** @type {number} */ (times_s[first]);
  const spacing_px = (span_s * seen.px_per_s) / (end - first - 1);
  return spacing_px >= TIGHT_PX ? KEY_PX : Math.max(spacing_px / 2 - 0.3, 0.8);
}

/** @param {Ctx} ctx @param {number} x @param {number} y @param {boolean} isAnchor @param {number} size_px */
function keyPath(ctx, x, y, isAnchor, size_px) {
  if (size_px < KEY_PX && !isAnchor) {
    ctx.rect(x - size_px, y - 4, Math.max(2 * size_px, 1), 8);
    return;
  }
  if (isAnchor) {
    ctx.rect(x - 4, y - 4, 8, 8);
    ctx.rect(x - 1, y - 9, 2, 18);
    return;
  }
  diamond(ctx, x, y, KEY_PX);
}

/** @param {Ctx} ctx @param {number} x @param {number} y @param {number} size_px */
export function diamond(ctx, x, y, size_px) {
  ctx.moveTo(x, y - size_px);
  ctx.lineTo(x + size_px, y);
  ctx.lineTo(x, y + size_px);
  ctx.lineTo(x - size_px, y);
  ctx.closePath();
}

/** Return the function from value to pixel of a joint's row.
 * @param {Pick<Scene, "view" | "order" | "used_deg">} scene @param {Row} row @returns {{ y: (value: number) => number, low: number, high: number }} */
export function scaleOf(scene, row) {
  const joint = /** @type {import("../state.js").JointView} */ (scene.view.joints[row.index]);
  const [low, high] = rangeOf(joint, scene.order, scene.used_deg[row.name] ?? [0, 0]);
  const room_px = row.height_px - ERROR_PX - 4;
  return { y: (value) => row.y_px + 2 + room_px * (1 - (value - low) / (high - low)), low, high };
}

/** @param {Ctx} ctx @param {Scene} scene @param {Row} row */
function drawJoint(ctx, scene, row) {
  const { view, seen, palette, order } = scene;
  const joint = /** @type {import("../state.js").JointView} */ (view.joints[row.index]);
  const curves = view.curves[row.name];
  if (curves === undefined) return 0;
  const scale = scaleOf(scene, row);
  drawSpans(ctx, scene, row);
  drawLimits(ctx, scene, row, joint, scale);
  if (order !== 0) {
    ctx.fillStyle = palette.line;
    ctx.fillRect(0, scale.y(0), seen.width_px, 1);
  }
  const { ghosts } = scene;
  if (curves.authored !== null && ghosts?.authored !== false && isAway(scene, row.name)) drawCurve(ctx, scene, curves.authored, scale.y, palette.authored, [4, 3]);
  if (order === 0) drawAsked(ctx, scene, row.name, scale.y);
  if (ghosts?.plan !== false) drawCurve(ctx, scene, curves.plan, scale.y, palette.plan, []);
  // Above the plan, from which it is mostly less than a pixel away.
  if (ghosts?.predicted) drawCurve(ctx, scene, curves.predicted, scale.y, palette.predicted, [5, 5]);
  drawError(ctx, scene, row, curves);
  const keys = view.keys[row.name] ?? [];
  const chosen = chosenKeys(scene);
  const isOneChosen = (/** @type {import("../state.js").JointKey} */ key) => isChosen(chosen, key.lane, key.key, row.name);
  return drawPoints(ctx, scene, keys, scale.y, curves.plan, isOneChosen);
}

/** Whether any of a joint's spans is slowed in sight: elsewhere authored and plan are the same.
 * @param {Scene} scene @param {string} joint */
function isAway(scene, joint) {
  const end_s = endOf(scene.seen);
  const isSlow = scene.view.stretched.some((span) => span.from_s < end_s && span.to_s > scene.seen.start_s);
  return isSlow && joint !== "";
}

/** @param {Ctx} ctx @param {Scene} scene @param {import("../curves.js").Curve} curve
 * @param {(value: number) => number} y @param {string} colour @param {number[]} dash */
function drawCurve(ctx, scene, curve, y, colour, dash) {
  const { seen, view, order } = scene;
  const first_px = Math.max(0, Math.floor(pixelOf(seen, 0)));
  const width_px = Math.min(seen.width_px, Math.ceil(pixelOf(seen, view.view_s))) - first_px;
  if (width_px <= 0) return;
  const [lows, highs, edges] = columns(width_px);
  const start_s = seen.start_s + first_px / seen.px_per_s;
  fillColumns(curve, order, start_s, 1 / seen.px_per_s, lows, highs, edges);
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1.5;
  ctx.setLineDash(dash);
  ctx.beginPath();
  let last = valueAt(curve, start_s, order);
  ctx.moveTo(first_px, y(last));
  for (let column = 0; column < width_px; column += 1) {
    const x_px = first_px + column;
    const low = /** @type {number} */ (lows[column]);
    const high = /** @type {number} */ (highs[column]);
    const edge = /** @type {number} */ (edges[column]);
    // What swings out within a column, as where it holds many keys, is a stroke of its own.
    if (high > Math.max(last, edge)) ctx.lineTo(x_px + 0.5, y(high));
    if (low < Math.min(last, edge)) ctx.lineTo(x_px + 0.5, y(low));
    ctx.lineTo(x_px + 1, y(edge));
    last = edge;
  }
  ctx.stroke();
  ctx.setLineDash([]);
}

/** @param {number} width_px */
function columns(width_px) {
  if (room.lows.length < width_px) {
    for (const name of /** @type {const} */ (["lows", "highs", "other", "more"])) room[name] = new Float32Array(2 * width_px);
  }
  return [room.lows.subarray(0, width_px), room.highs.subarray(0, width_px),
    room.other.subarray(0, width_px), room.more.subarray(0, width_px)];
}

/** @param {Ctx} ctx @param {Scene} scene @param {Row} row @param {import("../state.js").JointView} joint
 * @param {{ y: (value: number) => number, low: number, high: number }} scale */
function drawLimits(ctx, scene, row, joint, scale) {
  const { order, palette, seen } = scene;
  const limits = order === 0 ? joint.range_deg
    : order === 1 ? [-joint.speed_max_deg_s, joint.speed_max_deg_s]
      : [-joint.accel_max_deg_s2, joint.accel_max_deg_s2];
  ctx.strokeStyle = palette.limit;
  ctx.lineWidth = 1;
  ctx.setLineDash([6, 4]);
  ctx.beginPath();
  for (const limit of limits) {
    if (limit <= scale.low || limit >= scale.high) continue;
    const y_px = Math.round(scale.y(limit)) + 0.5;
    if (y_px < row.y_px) continue;
    ctx.moveTo(0, y_px);
    ctx.lineTo(seen.width_px, y_px);
  }
  ctx.stroke();
  ctx.setLineDash([]);
}

/** Height of the strip that marks a span: the row below it stays readable. */
const SPAN_PX = 7;

/** Stretched spans are hatched one way, angle given up the other, in a strip at the top. @param {Ctx} ctx
 * @param {Scene} scene @param {Row} row */
function drawSpans(ctx, scene, row) {
  const { view, seen, palette, selection } = scene;
  for (const list of /** @type {const} */ (["stretched", "given_up"])) {
    view[list].forEach((span, index) => {
      if (span.joint !== row.name) return;
      const x_px = pixelOf(seen, span.from_s);
      const width_px = Math.max((span.to_s - span.from_s) * seen.px_per_s, 3);
      if (x_px > seen.width_px || x_px + width_px < 0) return;
      const left_px = Math.max(x_px, -8);
      const right_px = Math.min(x_px + width_px, seen.width_px + 8);
      ctx.fillStyle = list === "stretched" ? palette.stretched : palette.given_up;
      ctx.globalAlpha = 0.08;
      ctx.fillRect(left_px, row.y_px, right_px - left_px, row.height_px - 1);
      ctx.globalAlpha = 1;
      hatch(ctx, { left_px, right_px, top_px: row.y_px, bottom_px: row.y_px + SPAN_PX }, list === "stretched" ? 1 : -1);
      ctx.globalAlpha = 1;
      if (selection?.kind === "span" && selection.list === list && selection.index === index) {
        ctx.strokeStyle = palette.selected;
        ctx.lineWidth = 2;
        ctx.strokeRect(left_px, row.y_px + 1, right_px - left_px, row.height_px - 3);
      }
    });
  }
}

/** @param {Ctx} ctx @param {{ left_px: number, right_px: number, top_px: number, bottom_px: number }} box
 * @param {1 | -1} slope */
function hatch(ctx, box, slope) {
  ctx.save();
  clip(ctx, box.left_px, box.top_px, box.right_px - box.left_px, box.bottom_px - box.top_px);
  ctx.strokeStyle = /** @type {string} */ (ctx.fillStyle);
  ctx.lineWidth = 2;
  ctx.beginPath();
  const height_px = box.bottom_px - box.top_px;
  const step_px = Math.max(6, (box.right_px - box.left_px) / 200);
  for (let x_px = box.left_px - height_px; x_px < box.right_px + height_px; x_px += step_px) {
    ctx.moveTo(x_px, box.bottom_px);
    ctx.lineTo(x_px + slope * height_px, box.top_px);
  }
  ctx.stroke();
  ctx.restore();
}

/** What the author asks for where a joint gives up angle. @param {Ctx} ctx @param {Scene} scene
 * @param {string} joint @param {(value: number) => number} y */
function drawAsked(ctx, scene, joint, y) {
  const { seen, palette, view } = scene;
  ctx.strokeStyle = palette.given_up;
  ctx.lineWidth = 1;
  ctx.setLineDash([3, 3]);
  for (const span of view.asked) {
    if (span.joint !== joint || span.to_s < seen.start_s || span.from_s > endOf(seen)) continue;
    ctx.beginPath();
    span.deg.forEach((deg, index) => {
      const at_s = span.from_s + ((span.to_s - span.from_s) * index) / Math.max(span.deg.length - 1, 1);
      ctx.lineTo(pixelOf(seen, at_s), y(deg));
    });
    ctx.stroke();
  }
  ctx.setLineDash([]);
}

/** The predicted error of the horn as a band below the curve: full at twice the tolerance.
 * @param {Ctx} ctx @param {Scene} scene @param {Row} row @param {import("../state.js").JointCurves} curves */
function drawError(ctx, scene, row, curves) {
  const { seen, view, palette } = scene;
  const first_px = Math.max(0, Math.floor(pixelOf(seen, 0)));
  const width_px = Math.min(seen.width_px, Math.ceil(pixelOf(seen, view.view_s))) - first_px;
  if (width_px <= 0) return;
  const [lows, highs, other, more] = columns(width_px);
  const start_s = seen.start_s + first_px / seen.px_per_s;
  fillColumns(curves.plan, 0, start_s, 1 / seen.px_per_s, lows, highs);
  fillColumns(curves.predicted, 0, start_s, 1 / seen.px_per_s, other, more);
  const bottom_px = row.y_px + row.height_px - 1;
  ctx.fillStyle = palette.predicted;
  ctx.beginPath();
  for (let column = 0; column < width_px; column += 1) {
    // Where a column holds much motion, its extremes differ by less than the error within it.
    const off = Math.max(
      Math.abs(/** @type {number} */ (lows[column]) - /** @type {number} */ (other[column])),
      Math.abs(/** @type {number} */ (highs[column]) - /** @type {number} */ (more[column])),
    );
    const height_px = Math.min((off / (2 * view.tolerance_deg)) * ERROR_PX, ERROR_PX);
    if (height_px > 0.3) ctx.rect(first_px + column, bottom_px - height_px, 1, height_px);
  }
  ctx.fill();
}

/** Keys of a joint on its curve. @param {Ctx} ctx @param {Scene} scene
 * @param {import("../state.js").JointKey[]} keys @param {(value: number) => number} y
 * @param {import("../curves.js").Curve} plan @param {(key: import("../state.js").JointKey) => boolean} isOneChosen */
function drawPoints(ctx, scene, keys, y, plan, isOneChosen) {
  const { seen, palette, order } = scene;
  if (order !== 0 || plan.times_s.length === 0) return 0;
  let first = 0;
  let end = keys.length;
  const from_s = seen.start_s - 10 / seen.px_per_s;
  while (first < end && /** @type {import("../state.js").JointKey} */ (keys[first]).at_s < from_s) first += 1;
  while (end > first && /** @type {import("../state.js").JointKey} */ (keys[end - 1]).at_s > endOf(seen)) end -= 1;
  const isCrowded = end - first > 2 && (seen.width_px / (end - first)) < CROWDED_PX;
  let previous_px = -Infinity;
  let drawn = 0;
  /** @param {import("../state.js").JointKey} key */
  const yOf = (key) => heightOf(key, y, (at_s) => angleAt(plan, at_s));
  ctx.fillStyle = palette.hold;
  for (let index = first; index < end; index += 1) {
    const key = /** @type {import("../state.js").JointKey} */ (keys[index]);
    if (key.hold_s > 0) ctx.fillRect(pixelOf(seen, key.at_s), yOf(key) - 2, key.hold_s * seen.px_per_s, 4);
  }
  const size_px = Math.min(KEY_PX, Math.max(seen.width_px / Math.max(end - first, 1) / 4, 1.5));
  for (const isAnchor of [false, true]) {
    ctx.fillStyle = isAnchor ? palette.anchor : palette.key;
    ctx.beginPath();
    for (let index = first; index < end; index += 1) {
      const key = /** @type {import("../state.js").JointKey} */ (keys[index]);
      if (key.is_anchor !== isAnchor || (isCrowded && !isAnchor)) continue;
      const x_px = pixelOf(seen, key.at_s);
      if (x_px - previous_px < 2 && x_px >= previous_px) continue;
      const y_px = yOf(key);
      if (isAnchor) keyPath(ctx, x_px, y_px, true, KEY_PX);
      else diamond(ctx, x_px, y_px, size_px);
      previous_px = x_px;
      drawn += 1;
    }
    ctx.fill();
  }
  ctx.strokeStyle = palette.selected;
  ctx.lineWidth = 2;
  for (const own of keys.slice(first, end)) if (isOneChosen(own)) ctx.strokeRect(pixelOf(seen, own.at_s) - 7, yOf(own) - 7, 14, 14);
  return drawn;
}

/** The use of a bus by commands, as bars; the dashed line is a full line. @param {Ctx} ctx
 * @param {Scene} scene @param {Row} row */
function drawLine(ctx, scene, row) {
  const { view, seen, palette } = scene;
  const use = view.line[row.name];
  if (use === undefined) return;
  const bottom_px = row.y_px + row.height_px - 2;
  const room_px = row.height_px - 6;
  const first = Math.max(0, Math.floor(seen.start_s / use.step_s));
  const end = Math.min(use.use_ratio.length, Math.ceil(endOf(seen) / use.step_s));
  ctx.fillStyle = palette.event;
  ctx.beginPath();
  for (let index = first; index < end; index += 1) {
    const height_px = Math.min(/** @type {number} */ (use.use_ratio[index]), 1) * room_px;
    if (height_px > 0.2) ctx.rect(pixelOf(seen, index * use.step_s), bottom_px - height_px, Math.max(use.step_s * seen.px_per_s - 0.5, 0.7), height_px);
  }
  ctx.fill();
  ctx.strokeStyle = palette.limit;
  ctx.setLineDash([6, 4]);
  ctx.lineWidth = 1;
  ctx.beginPath();
  ctx.moveTo(0, Math.round(bottom_px - room_px) + 0.5);
  ctx.lineTo(seen.width_px, Math.round(bottom_px - room_px) + 0.5);
  ctx.stroke();
  ctx.setLineDash([]);
}

/**
 * Draw the names of the rows, with the values of each joint. @param {Ctx} ctx @param {Scene} scene
 * @param {number} width_px @param {number} chosen_y_px top of the row that has the focus, or NaN
 */
export function drawNames(ctx, scene, width_px, chosen_y_px) {
  const { rows, palette, fixed_px, height_px, view } = scene;
  ctx.fillStyle = palette.raised;
  ctx.fillRect(0, 0, width_px, height_px);
  ctx.textBaseline = "middle";
  for (const scrolled of [true, false]) {
    ctx.save();
    if (scrolled) clip(ctx, 0, fixed_px, width_px, height_px - fixed_px);
    for (const row of rows) {
      if (isScrolled(scene, row) !== scrolled) continue;
      if (row.y_px === chosen_y_px) {
        ctx.fillStyle = palette.selected;
        ctx.fillRect(0, row.y_px, 3, row.height_px - 1);
      }
      ctx.fillStyle = palette.line;
      ctx.fillRect(0, row.y_px + row.height_px - 1, width_px, 1);
      drawName(ctx, scene, row, width_px, view);
    }
    ctx.restore();
  }
}

/** @param {Ctx} ctx @param {Scene} scene @param {Row} row @param {number} width_px @param {View} view */
function drawName(ctx, scene, row, width_px, view) {
  const { palette, order } = scene;
  ctx.font = row.kind === "joint" ? `600 ${FONT}` : FONT;
  ctx.fillStyle = row.kind === "joint" ? palette.text : palette.muted;
  const isTall = row.kind === "joint" || row.kind === "line";
  const y_px = isTall ? row.y_px + 13 : row.y_px + row.height_px / 2;
  const name = row.kind === "line" ? `line ${row.name}` : row.name;
  /** @param {string} text @param {number} at_px */
  const write = (text, at_px) => ctx.fillText(fittedText(ctx, text, width_px - 14), 10, at_px);
  write(name, y_px);
  ctx.font = SMALL;
  ctx.fillStyle = palette.muted;
  if (row.kind === "joint") {
    const joint = /** @type {import("../state.js").JointView} */ (view.joints[row.index]);
    const [low, high] = rangeOf(joint, order, scene.used_deg[row.name] ?? [0, 0]);
    const limit = order === 0 ? `${round(low)} to ${round(high)}` : `± ${round(order === 1 ? joint.speed_max_deg_s : joint.accel_max_deg_s2)}`;
    write(`${joint.servo} · id ${joint.id}`, row.y_px + 26);
    write(`${limit} ${UNITS[order]}`, row.y_px + 40);
    const error = view.error[row.name];
    if (error !== undefined) {
      ctx.fillStyle = palette.predicted;
      write(`horn ≤ ${error.max_deg.toFixed(2)} deg off`, row.y_px + row.height_px - 10);
    }
  }
  if (row.kind === "line") {
    const use = view.line[row.name];
    if (use !== undefined) write(`${Math.round(100 * use.mean_ratio)} %, worst ${Math.round(100 * use.worst_100_ms_ratio)} %`, row.y_px + 26);
  }
}

/** @param {number} value */
function round(value) {
  return number(value, Math.abs(value) >= 100 ? 0 : 1);
}

/** Return a text, shortened where it is wider than its room. @param {Ctx} ctx @param {string} text @param {number} width_px */
function fittedText(ctx, text, width_px) {
  if (ctx.measureText(text).width <= width_px) return text;
  let most = text.length - 1;
  while (most > 1 && ctx.measureText(`${text.slice(0, most)}…`).width > width_px) most -= 1;
  return `${text.slice(0, most)}…`;
}

/**
 * Draw what moves over the plan: readings, playhead and cursor. @param {Ctx} ctx @param {Scene} scene
 * @param {{ playhead_s: number | null, cursor_s: number, order: string[],
 *   segments: import("../readings.js").Segment[], toView: (at_s: number) => number }} live
 */
export function drawLive(ctx, scene, live) {
  const { seen, palette, fixed_px, height_px } = scene;
  ctx.clearRect(0, 0, seen.width_px, height_px);
  if (scene.order === 0 && scene.ghosts?.reading !== false) {
    ctx.save();
    clip(ctx, 0, fixed_px, seen.width_px, height_px - fixed_px);
    for (const row of scene.rows) {
      const joint = row.kind === "joint" ? live.order.indexOf(row.name) : -1;
      if (joint >= 0) drawReadings(ctx, scene, row, joint, live);
    }
    ctx.restore();
  }
  drawHead(ctx, scene, live.cursor_s, palette.cursor, false);
  if (live.playhead_s !== null) drawHead(ctx, scene, live.playhead_s, palette.playhead, true);
}

/** @param {Ctx} ctx @param {Scene} scene @param {Row} row @param {number} joint
 * @param {{ segments: import("../readings.js").Segment[], toView: (at_s: number) => number }} live */
function drawReadings(ctx, scene, row, joint, live) {
  const { seen, palette } = scene;
  const { y } = scaleOf(scene, row);
  const least_s = 0.7 / seen.px_per_s;
  // Where readings are far apart, the line between them is thin: it is not known what was there.
  for (const isClose of [false, true]) {
    ctx.strokeStyle = palette.reading;
    ctx.lineWidth = isClose ? 2.25 : 0.75;
    ctx.beginPath();
    for (const segment of live.segments) {
      const deg = /** @type {Float32Array} */ (segment.deg[joint]);
      let last_s = -Infinity;
      let last_deg = NaN;
      for (let index = 0; index < segment.count; index += 1) {
        const own = /** @type {number} */ (deg[index]);
        if (Number.isNaN(own)) continue;
        const at_s = live.toView(/** @type {number} */ (segment.times_s[index]));
        const gap_s = at_s - last_s;
        if (gap_s >= 0 && gap_s < least_s) continue;
        const isSeen = at_s >= seen.start_s && last_s <= endOf(seen);
        // A part that is played again begins a new line.
        if (isSeen && gap_s >= 0 && gap_s < Infinity && gap_s <= GAP_S === isClose) {
          ctx.moveTo(pixelOf(seen, last_s), y(last_deg));
          ctx.lineTo(pixelOf(seen, at_s), y(own));
        }
        last_s = at_s;
        last_deg = own;
      }
    }
    ctx.stroke();
  }
}

/** @param {Ctx} ctx @param {Scene} scene @param {number} at_s @param {string} colour @param {boolean} isFull */
function drawHead(ctx, scene, at_s, colour, isFull) {
  const x_px = Math.round(pixelOf(scene.seen, at_s));
  if (x_px < -8 || x_px > scene.seen.width_px + 8) return;
  ctx.fillStyle = colour;
  ctx.fillRect(x_px - (isFull ? 1 : 0), 0, isFull ? 2 : 1, scene.height_px);
  ctx.beginPath();
  ctx.moveTo(x_px - 6, 0);
  ctx.lineTo(x_px + 6, 0);
  ctx.lineTo(x_px, isFull ? 11 : 8);
  ctx.fill();
}
