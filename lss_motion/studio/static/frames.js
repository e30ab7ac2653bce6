// @ts-check
/**
 * The only place that asks for animation frames. Input changes state; the next frame runs what was
 * asked for once, then every drawer. Nothing runs while nothing changes.
 */

/** @type {Set<() => void>} */
const drawers = new Set();
/** @type {Set<() => void>} */
let asked = new Set();
let isScheduled = false;

/** Milliseconds of script of the frames so far, for the bench. */
export const work = { frames: 0, total_ms: 0, max_ms: 0 };

/** Draw in every frame that is requested; returns how to end that. @param {() => void} draw */
export function onFrame(draw) {
  drawers.add(draw);
  requestFrame();
  return () => void drawers.delete(draw);
}

/** Run once in the next frame, however often it is asked for. @param {() => void} run */
export function nextFrame(run) {
  asked.add(run);
  requestFrame();
}

/** Ask for a frame. */
export function requestFrame() {
  if (isScheduled) return;
  isScheduled = true;
  requestAnimationFrame(run);
}

function run() {
  isScheduled = false;
  const started_ms = performance.now();
  const due = asked;
  asked = new Set();
  for (const task of due) task();
  for (const draw of drawers) draw();
  const spent_ms = performance.now() - started_ms;
  work.frames += 1;
  work.total_ms += spent_ms;
  work.max_ms = Math.max(work.max_ms, spent_ms);
}

/** Resolve when nothing waits for a frame; for tests. @returns {Promise<void>} */
export async function idle() {
  for (let quiet = 0; quiet < 2; ) {
    await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
    quiet = isScheduled ? 0 : quiet + 1;
  }
}
