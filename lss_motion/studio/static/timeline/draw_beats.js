// @ts-check
/** The beats of the music over its waveform: those of the file, and those that are proposed. Pure. */

import { isInSight, pixelOf } from "./window.js";

/** Closer together than this they would be a grey area: then only some are drawn. */
const APART_PX = 4;

/** Draw beats over each waveform. @param {CanvasRenderingContext2D} ctx @param {import("./draw.js").Scene} scene
 * @param {number[]} beats_s in order of time @param {string} colour */
export function drawBeats(ctx, { rows, seen }, beats_s, colour) {
  ctx.fillStyle = colour;
  for (const row of rows) {
    if (row.kind !== "wave") continue;
    let last_px = -Infinity;
    for (const at_s of beats_s) {
      const x_px = Math.round(pixelOf(seen, at_s));
      if (!isInSight(seen, at_s) || x_px - last_px < APART_PX) continue;
      last_px = x_px;
      ctx.fillRect(x_px, row.y_px + 2, 1, row.height_px - 4);
    }
  }
}
