// @ts-check
/** What is drawn while keys are dragged or a box is drawn: above the plan, as the playhead is. Pure. */

import { corridor } from "./estimate.js";
import { draftText, stopsOf } from "./draft.js";
import { diamond, KEY_PX, scaleOf } from "./draw.js";
import { isChosen } from "./keys.js";
import { pixelOf, timeAt } from "./window.js";

/** @typedef {import("./draw.js").Scene} Scene */
/** @typedef {import("./draft.js").Draft} Draft */
/** @typedef {CanvasRenderingContext2D} Ctx */

const CORRIDOR_PX = 4;
const LINE_PX = 18;
const CHAR_PX = 6.8;

/**
 * Draw the keys where they would be, the way to their neighbours, how far a joint can get, and words.
 * @param {Ctx} ctx @param {Scene} scene @param {Draft} draft
 * @param {import("./gestures.js").KeyHit} held the key that the pointer has @param {{ x_px: number, y_px: number }} at
 */
export function drawDraft(ctx, scene, draft, held, at) {
  const { palette, rows, view, seen } = scene;
  const isLate = draft.late !== null;
  const colour = isLate ? palette.stretched : palette.selected;
  for (const row of rows) {
    if (row.kind === "lane") {
      ctx.fillStyle = colour;
      ctx.beginPath();
      view.lanes[row.index]?.keys.forEach((key, index) => {
        if (isChosen(draft.keys, row.index, index, null)) diamond(ctx, pixelOf(seen, key.at_s + draft.by_s), row.y_px + row.height_px / 2, KEY_PX + 1);
      });
      ctx.fill();
    }
    if (row.kind === "joint" && scene.order === 0) drawJoint(ctx, scene, row, draft, held, colour);
  }
  drawWords(ctx, scene, draftText(view, draft, held), at, isLate);
}

/** @param {Ctx} ctx @param {Scene} scene @param {import("./layout.js").Row} row @param {Draft} draft
 * @param {import("./gestures.js").KeyHit} held @param {string} colour */
function drawJoint(ctx, scene, row, draft, held, colour) {
  const { view, seen, palette } = scene;
  const { y } = scaleOf(scene, row);
  const lanes = new Set(draft.keys.map((one) => one.lane));
  for (const lane of lanes) {
    if (view.lanes[lane]?.is_added) continue;
    const stops = stopsOf(view, lane, row.name, draft);
    if (!stops.some((own) => own.isMoved)) continue;
    if (held.joint === row.name && held.lane === lane) drawCorridor(ctx, scene, row, stops, draft);
    ctx.strokeStyle = colour;
    ctx.lineWidth = 1;
    ctx.setLineDash([4, 3]);
    ctx.beginPath();
    stops.forEach((own, index) => {
      const next = stops[index + 1];
      if (next === undefined || !own.isMoved && !next.isMoved) return;
      ctx.moveTo(pixelOf(seen, own.at_s + own.hold_s), y(own.deg));
      ctx.lineTo(pixelOf(seen, next.at_s), y(next.deg));
    });
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.fillStyle = colour;
    ctx.beginPath();
    for (const own of stops) if (own.isMoved) diamond(ctx, pixelOf(seen, own.at_s), y(own.deg), KEY_PX + 1);
    ctx.fill();
    ctx.strokeStyle = palette.surface;
    ctx.stroke();
  }
}

/** Shade where the key can be without being late. @param {Ctx} ctx @param {Scene} scene
 * @param {import("./layout.js").Row} row @param {ReturnType<typeof stopsOf>} stops @param {Draft} draft */
function drawCorridor(ctx, scene, row, stops, draft) {
  const { view, seen, palette } = scene;
  const limits = view.joints[row.index];
  const index = stops.findIndex((own) => own.isMoved);
  if (limits === undefined || draft.keys.length !== 1 || index < 0) return;
  const [before, after] = [stops[index - 1], stops[index + 1]];
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

/** @param {Ctx} ctx @param {Scene} scene @param {string[]} texts @param {{ x_px: number, y_px: number }} at @param {boolean} isLate */
function drawWords(ctx, scene, texts, at, isLate) {
  if (texts.length === 0) return;
  const { palette, seen, height_px } = scene;
  const width_px = Math.max(...texts.map((text) => text.length)) * CHAR_PX + 16;
  const tall_px = texts.length * LINE_PX + 8;
  const x_px = Math.max(Math.min(at.x_px + 16, seen.width_px - width_px - 4), 4);
  const y_px = Math.max(Math.min(at.y_px - tall_px - 12, height_px - tall_px - 4), 4);
  ctx.fillStyle = palette.raised;
  ctx.fillRect(x_px, y_px, width_px, tall_px);
  ctx.strokeStyle = isLate ? palette.stretched : palette.selected;
  ctx.lineWidth = 1;
  ctx.strokeRect(x_px + 0.5, y_px + 0.5, width_px - 1, tall_px - 1);
  ctx.font = "12px system-ui, sans-serif";
  ctx.textBaseline = "middle";
  ctx.fillStyle = palette.text;
  texts.forEach((text, index) => ctx.fillText(text, x_px + 8, y_px + 4 + LINE_PX * (index + 0.5)));
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
