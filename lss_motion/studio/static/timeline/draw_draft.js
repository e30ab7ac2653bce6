// @ts-check
/** What is drawn while keys are dragged or a box is drawn: above the plan, as the playhead is. Pure. */

import { corridor } from "./estimate.js";
import { around, draggedStop, draggedTime, isLate, splitOf } from "./draft.js";
import { diamond, KEY_PX, scaleOf } from "./draw.js";
import { isChosen } from "./keys.js";
import { isInSight, pixelOf, timeAt } from "./window.js";

/** @typedef {import("./draw.js").Scene} Scene */
/** @typedef {import("./draft.js").Draft} Draft */
/** @typedef {CanvasRenderingContext2D} Ctx */

const CORRIDOR_PX = 4;
const LINE_PX = 18;
const CHAR_PX = 6.8;
const WORDS_MAX_CHARS = 56;
/** The ways of more keys than these are not drawn: they are a carpet. */
const WAYS_MAX = 60;

/**
 * Draw the keys where they would be, the way to their neighbours, how far a joint can get, and words.
 * @param {Ctx} ctx @param {Scene} scene @param {Draft} draft
 * @param {{ held: import("./gestures.js").KeyHit, at: { x_px: number, y_px: number }, words: string[],
 *   tried: import("../state.js").Tried | null }} more the key that the pointer has, where it is, and
 * what the planner says of the draft
 */
export function drawDraft(ctx, scene, draft, { held, at, words, tried }) {
  const { palette, rows, view, seen } = scene;
  const hasTrouble = isLate(draft, tried);
  const colour = hasTrouble ? palette.stretched : palette.selected;
  for (const row of rows) {
    if (row.kind === "lane") {
      const y_px = row.y_px + row.height_px / 2;
      const points = (view.lanes[row.index]?.keys ?? []).flatMap(({ at_s }, index) => (
        isChosen(draft.keys, row.index, index, null) && isInSight(seen, draggedTime(draft, at_s)) ? [{ x_px: pixelOf(seen, draggedTime(draft, at_s)), y_px }] : []));
      drawPoints(ctx, points, colour, palette.surface);
    }
    if (row.kind !== "joint" || scene.order !== 0) continue;
    if (tried?.window != null) drawWindow(ctx, scene, row, tried.window, colour);
    drawJoint(ctx, scene, row, draft, held, colour);
  }
  drawWords(ctx, scene, words, at, hasTrouble);
}

/** An instant that is dragged over all rows, with words. @param {Ctx} ctx @param {Scene} scene @param {number} at_s
 * @param {string[]} words @param {{ x_px: number, y_px: number }} at */
export function drawInstant(ctx, scene, at_s, words, at) {
  const x_px = Math.round(pixelOf(scene.seen, at_s)) + 0.5;
  ctx.strokeStyle = scene.palette.selected;
  ctx.lineWidth = 1;
  ctx.beginPath();
  ctx.moveTo(x_px, 0);
  ctx.lineTo(x_px, scene.height_px);
  ctx.stroke();
  drawWords(ctx, scene, [`${at_s.toFixed(3)} s`, ...words.filter((own) => own !== "")], at, false);
}

/** @param {Ctx} ctx @param {Scene} scene @param {import("./layout.js").Row} row @param {Draft} draft
 * @param {import("./gestures.js").KeyHit} held @param {string} colour */
function drawJoint(ctx, scene, row, draft, held, colour) {
  const { view, seen, palette } = scene;
  const { y } = scaleOf(scene, row);
  for (const lane of new Set(draft.keys.map((one) => one.lane))) {
    if (view.lanes[lane]?.is_added) continue;
    const split = splitOf(view, lane, row.name, draft.keys, draft.isCopy);
    if (split.moved.length === 0) continue;
    if (split.moved.length <= WAYS_MAX) drawWays(ctx, scene, split, draft, colour, y);
    if (held.joint === row.name && held.lane === lane && draft.keys.length === 1) drawCorridor(ctx, scene, row, around(split, 0, draft));
    const points = split.moved.map((stop) => draggedStop(stop, draft)).filter((own) => isInSight(seen, own.at_s))
      .map((own) => ({ x_px: pixelOf(seen, own.at_s), y_px: y(own.deg) }));
    drawPoints(ctx, points, colour, palette.surface);
  }
}

/** Keys that are dragged: diamonds, and small where they are many. @param {Ctx} ctx
 * @param {{ x_px: number, y_px: number }[]} points @param {string} colour @param {string} edge */
function drawPoints(ctx, points, colour, edge) {
  ctx.fillStyle = colour;
  if (points.length > WAYS_MAX) {
    for (const { x_px, y_px } of points) ctx.fillRect(Math.round(x_px) - 1, Math.round(y_px) - 2, 2, 4);
    return;
  }
  ctx.beginPath();
  for (const { x_px, y_px } of points) diamond(ctx, x_px, y_px, KEY_PX + 1);
  ctx.fill();
  ctx.strokeStyle = edge;
  ctx.lineWidth = 1;
  ctx.stroke();
}

/** The straight ways to the keys before and after those that are dragged. @param {Ctx} ctx @param {Scene} scene
 * @param {import("./draft.js").Split} split @param {Draft} draft @param {string} colour @param {(deg: number) => number} y */
function drawWays(ctx, { seen }, split, draft, colour, y) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1;
  ctx.setLineDash([4, 3]);
  ctx.beginPath();
  split.moved.forEach((_, index) => {
    const { stops, own } = around(split, index, draft);
    for (const to of [own, own + 1]) {
      const [before, after] = [stops[to - 1], stops[to]];
      if (before === undefined || after === undefined) continue;
      ctx.moveTo(pixelOf(seen, before.at_s + before.hold_s), y(before.deg));
      ctx.lineTo(pixelOf(seen, after.at_s), y(after.deg));
    }
  });
  ctx.stroke();
  ctx.setLineDash([]);
}

/** The plan that the edit would have. @param {Ctx} ctx @param {Scene} scene @param {import("./layout.js").Row} row
 * @param {import("../state.js").TriedWindow} window @param {string} colour */
export function drawWindow(ctx, scene, row, window, colour) {
  const deg = window.deg[row.name];
  if (deg === undefined) return;
  const { y } = scaleOf(scene, row);
  ctx.strokeStyle = colour;
  ctx.lineWidth = 2;
  ctx.beginPath();
  deg.forEach((own, index) => ctx.lineTo(pixelOf(scene.seen, window.from_s + index * window.step_s), y(own)));
  ctx.stroke();
}

/** Shade where the key can be without being late. @param {Ctx} ctx @param {Scene} scene
 * @param {import("./layout.js").Row} row @param {ReturnType<typeof around>} place */
function drawCorridor(ctx, scene, row, { stops, own }) {
  const { view, seen, palette } = scene;
  const limits = view.joints[row.index];
  if (limits === undefined) return;
  const [before, after] = [stops[own - 1], stops[own + 1]];
  const from_px = Math.max(before === undefined ? 0 : pixelOf(seen, before.at_s + before.hold_s), 0);
  const to_px = Math.min(after === undefined ? seen.width_px : pixelOf(seen, after.at_s), seen.width_px);
  const { y, low, high } = scaleOf(scene, row);
  /** @param {number} deg */
  const yOf = (deg) => y(Math.min(Math.max(deg, low), high));
  ctx.fillStyle = palette.selected;
  ctx.globalAlpha = 0.13;
  for (let x_px = from_px; x_px < to_px; x_px += CORRIDOR_PX) {
    const [least, most] = corridor(limits, before, after, timeAt(seen, x_px + CORRIDOR_PX / 2));
    if (most > least) ctx.fillRect(x_px, yOf(most), Math.min(CORRIDOR_PX, to_px - x_px), yOf(least) - yOf(most));
  }
  ctx.globalAlpha = 1;
}

/** @param {Ctx} ctx @param {Scene} scene @param {string[]} whole @param {{ x_px: number, y_px: number }} at @param {boolean} hasTrouble */
export function drawWords(ctx, scene, whole, at, hasTrouble) {
  const texts = whole.flatMap((text) => wrapped(text, WORDS_MAX_CHARS));
  if (texts.length === 0) return;
  const { palette, seen, height_px } = scene;
  const width_px = Math.max(...texts.map((text) => text.length)) * CHAR_PX + 16;
  const tall_px = texts.length * LINE_PX + 8;
  const x_px = Math.max(Math.min(at.x_px + 16, seen.width_px - width_px - 4), 4);
  const y_px = Math.max(Math.min(at.y_px - tall_px - 12, height_px - tall_px - 4), 4);
  ctx.fillStyle = palette.raised;
  ctx.fillRect(x_px, y_px, width_px, tall_px);
  ctx.strokeStyle = hasTrouble ? palette.stretched : palette.selected;
  ctx.lineWidth = 1;
  ctx.strokeRect(x_px + 0.5, y_px + 0.5, width_px - 1, tall_px - 1);
  ctx.font = "12px system-ui, sans-serif";
  ctx.textBaseline = "middle";
  ctx.fillStyle = palette.text;
  texts.forEach((text, index) => ctx.fillText(text, x_px + 8, y_px + 4 + LINE_PX * (index + 0.5)));
}

/** Return a text in lines of so many signs, broken between words. @param {string} text @param {number} most */
export function wrapped(text, most) {
  /** @type {string[]} */
  const lines = [];
  for (const word of text.split(" ")) {
    const last = lines.at(-1);
    if (last === undefined || last.length + word.length + 1 > most) lines.push(word);
    else lines[lines.length - 1] = `${last} ${word}`;
  }
  return lines;
}

/** Draw the box that chooses keys. @param {Ctx} ctx @param {Scene} scene @param {import("./keys.js").Box} box */
export function drawBox(ctx, scene, box) {
  const { palette } = scene;
  ctx.strokeStyle = palette.selected;
  ctx.lineWidth = 1;
  ctx.setLineDash([4, 3]);
  ctx.strokeRect(box.left_px + 0.5, box.top_px + 0.5, box.right_px - box.left_px, box.bottom_px - box.top_px);
  ctx.setLineDash([]);
  ctx.fillStyle = palette.selected;
  ctx.globalAlpha = 0.12;
  ctx.fillRect(box.left_px, box.top_px, box.right_px - box.left_px, box.bottom_px - box.top_px);
  ctx.globalAlpha = 1;
}
