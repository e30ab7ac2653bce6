// What plays a published page: figure, clock and sounds. `createFigure` stands above it in the page.

import { createFigure } from "./figure/figure.js";

/** @param {string} id */
const byId = (id) => /** @type {HTMLInputElement} */ (document.getElementById(id));
const data = JSON.parse(byId("lss_motion").textContent);
/** @type {{ joints: string[], deg: number[][], rate_hz: number, until_s: number }} */
const { joints, deg, rate_hz, until_s } = data.plan;

/** The angles of all joints at a time. @param {number} at_s */
function poseAt(at_s) {
  const place = Math.min(Math.max(at_s * rate_hz, 0), deg.length - 1);
  const before = /** @type {number[]} */ (deg[Math.floor(place)]);
  const after = /** @type {number[]} */ (deg[Math.ceil(place)]);
  const share = place - Math.floor(place);
  /** @param {number[]} own @param {number} n */
  const of = (own, n) => /** @type {number} */ (own[n]);
  return Object.fromEntries(joints.map((name, n) => [name, of(before, n) + share * (of(after, n) - of(before, n))]));
}

/** One player for each sound; it starts when the clock passes its time. */
const sounds = data.cues.flatMap((/** @type {{ at_s: number, sound: string }} */ { at_s, sound }) => {
  const packed = data.files[sound];
  if (packed?.base64 === undefined) return [];
  /** @type {Record<string, string>} */
  const kinds = { mp3: "mpeg", ogg: "ogg", flac: "flac" };
  const kind = kinds[sound.split(".").pop() ?? ""] ?? "wav";
  return [{ at_s, audio: new Audio(`data:audio/${kind};base64,${packed.base64}`) }];
});

const figure =
  data.figure === null
    ? null
    : createFigure(byId("figure"), data.figure, {
        schedule: (/** @type {() => void} */ draw) => requestAnimationFrame(draw),
        label: data.check.robot,
        is2d: true,
      });
if (figure === null) byId("figure").hidden = true;
else figure.frame(deg.filter((_, n) => n % Math.ceil(deg.length / 60) === 0).map((_, n) => poseAt((n * until_s) / 60)));

let at_s = 0;
/** When the clock was 0, while it runs. @type {number | null} */
let started = null;
byId("at").max = String(until_s);

function show() {
  byId("at").value = String(at_s);
  byId("clock").textContent = `${at_s.toFixed(1)} of ${until_s.toFixed(1)} s`;
  figure?.setPose({ solid: poseAt(at_s), isRead: false, authored: null, line: null });
}

function stop() {
  started = null;
  byId("play").textContent = "Play";
  for (const { audio } of sounds) audio.pause();
}

/** @param {number} now_ms */
function turn(now_ms) {
  if (started === null) return;
  const before_s = at_s;
  at_s = (now_ms - started) / 1000;
  for (const sound of sounds) {
    if (before_s <= sound.at_s && sound.at_s < at_s) {
      sound.audio.currentTime = 0;
      void sound.audio.play();
    }
  }
  if (at_s >= until_s) {
    at_s = until_s;
    stop();
  }
  show();
  if (started !== null) requestAnimationFrame(turn);
}

byId("play").onclick = () => {
  if (started !== null) {
    stop();
    return;
  }
  if (at_s >= until_s) at_s = 0;
  started = performance.now() - 1000 * at_s;
  byId("play").textContent = "Pause";
  for (const { at_s: from_s, audio } of sounds) {
    if (from_s < at_s && at_s < from_s + (audio.duration || 0)) {
      audio.currentTime = at_s - from_s;
      void audio.play();
    }
  }
  requestAnimationFrame(turn);
};
byId("at").oninput = () => {
  stop();
  at_s = Number(byId("at").value);
  show();
};
show();
