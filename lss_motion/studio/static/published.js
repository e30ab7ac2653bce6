// What plays a published page: figure, clock and sounds. `createFigure` stands above it in the page.

const data = JSON.parse(document.getElementById("lss_motion").textContent);
const { joints, deg, rate_hz, until_s } = data.plan;
const byId = (id) => document.getElementById(id);

/** The angles of all joints at a time. */
function poseAt(at_s) {
  const place = Math.min(Math.max(at_s * rate_hz, 0), deg.length - 1);
  const before = deg[Math.floor(place)];
  const after = deg[Math.ceil(place)];
  const share = place - Math.floor(place);
  return Object.fromEntries(joints.map((name, n) => [name, before[n] + share * (after[n] - before[n])]));
}

/** One player for each sound; it starts when the clock passes its time. */
const sounds = data.cues.flatMap(({ at_s, sound }) => {
  const packed = data.files[sound];
  if (packed?.base64 === undefined) return [];
  const kind = { mp3: "mpeg", ogg: "ogg", flac: "flac" }[sound.split(".").pop()] ?? "wav";
  return [{ at_s, audio: new Audio(`data:audio/${kind};base64,${packed.base64}`) }];
});

const figure =
  data.figure === null
    ? null
    : createFigure(byId("figure"), data.figure, {
        schedule: (draw) => requestAnimationFrame(draw),
        label: data.check.robot,
        is2d: true,
      });
if (figure === null) byId("figure").hidden = true;
else figure.frame(deg.filter((_, n) => n % Math.ceil(deg.length / 60) === 0).map((_, n) => poseAt((n * until_s) / 60)));

let at_s = 0;
let started = null; // when the clock was 0, while it runs
byId("at").max = until_s;

function show() {
  byId("at").value = at_s;
  byId("clock").textContent = `${at_s.toFixed(1)} of ${until_s.toFixed(1)} s`;
  figure?.setPose({ solid: poseAt(at_s), isRead: false, authored: null, line: null });
}

function stop() {
  started = null;
  byId("play").textContent = "Play";
  for (const { audio } of sounds) audio.pause();
}

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
byId("at").oninput = (event) => {
  stop();
  at_s = Number(event.target.value);
  show();
};
show();
