// @ts-check
/** The part of the show that is seen: from when, and how many pixels a second has. Pure. */

/** @typedef {{ start_s: number, px_per_s: number, width_px: number }} Window */

export const PX_PER_S_MAX = 4000;
/** Room at both ends of the show, in pixels. */
export const MARGIN_PX = 24;

/** Return the instant at a pixel. @param {Window} view @param {number} x_px */
export function timeAt(view, x_px) {
  return view.start_s + x_px / view.px_per_s;
}

/** Return the pixel of an instant. @param {Window} view @param {number} at_s */
export function pixelOf(view, at_s) {
  return (at_s - view.start_s) * view.px_per_s;
}

/** Return the instant at the right edge. @param {Window} view */
export function endOf(view) {
  return view.start_s + view.width_px / view.px_per_s;
}

/** Whether an instant is seen. @param {Window} view @param {number} at_s */
export function isInSight(view, at_s) {
  const x_px = pixelOf(view, at_s);
  return x_px >= 0 && x_px <= view.width_px;
}

/** Return the window that shows all of it. @param {number} length_s @param {number} width_px */
export function fitted(length_s, width_px) {
  const room_px = Math.max(width_px - 2 * MARGIN_PX, 1);
  const px_per_s = Math.min(room_px / Math.max(length_s, 0.01), PX_PER_S_MAX);
  return { start_s: -MARGIN_PX / px_per_s, px_per_s, width_px };
}

/** Return a window that lies over the show, at an allowed zoom.
 * @param {Window} view @param {number} length_s @returns {Window} */
export function kept(view, length_s) {
  const least = fitted(length_s, view.width_px).px_per_s;
  const px_per_s = Math.min(Math.max(view.px_per_s, least), PX_PER_S_MAX);
  const margin_s = MARGIN_PX / px_per_s;
  const latest_s = Math.max(length_s + margin_s - view.width_px / px_per_s, -margin_s);
  return { ...view, px_per_s, start_s: Math.min(Math.max(view.start_s, -margin_s), latest_s) };
}

/** Return the window zoomed by a factor about a pixel, which keeps its instant.
 * @param {Window} view @param {number} factor @param {number} x_px @param {number} length_s */
export function zoomed(view, factor, x_px, length_s) {
  const at_s = timeAt(view, x_px);
  const px_per_s = kept({ ...view, px_per_s: view.px_per_s * factor }, length_s).px_per_s;
  return kept({ ...view, px_per_s, start_s: at_s - x_px / px_per_s }, length_s);
}

/** Return the window moved by pixels. @param {Window} view @param {number} by_px @param {number} length_s */
export function panned(view, by_px, length_s) {
  return kept({ ...view, start_s: view.start_s + by_px / view.px_per_s }, length_s);
}

/** Return a window in which an instant is in sight; the same one if it is.
 * @param {Window} view @param {number} at_s @param {number} length_s */
export function following(view, at_s, length_s) {
  const x_px = pixelOf(view, at_s);
  if (x_px >= 0.05 * view.width_px && x_px <= 0.85 * view.width_px) return view;
  return kept({ ...view, start_s: at_s - (0.25 * view.width_px) / view.px_per_s }, length_s);
}

/** Return a step of the ruler: 1, 2 or 5 times a power of ten, at least `least_px` wide.
 * @param {Window} view @param {number} least_px */
export function tickStep(view, least_px) {
  const least_s = least_px / view.px_per_s;
  const steps_s = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600];
  return steps_s.find((step_s) => step_s >= least_s) ?? 1800;
}

/** Return a time as people read it, as exact as a step needs. @param {number} at_s @param {number} step_s */
export function timeText(at_s, step_s) {
  const digits = step_s >= 1 ? 0 : step_s >= 0.1 ? 1 : step_s >= 0.01 ? 2 : 3;
  const rounded_s = Number(Math.abs(at_s).toFixed(digits));
  const sign = at_s < 0 && rounded_s > 0 ? "−" : "";
  const minutes = Math.floor(rounded_s / 60);
  const seconds = (rounded_s - 60 * minutes).toFixed(digits);
  return `${sign}${minutes}:${seconds.padStart(digits === 0 ? 2 : digits + 3, "0")}`;
}
