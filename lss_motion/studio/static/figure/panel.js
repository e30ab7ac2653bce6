// @ts-check
/** The figure of a show: the plan at the cursor, and the robot while it plays. */

import { html, useEffect, useRef } from "../vendor/preact.js";
import { angleAt, withinView } from "../curves.js";
import { nextFrame, onFrame } from "../frames.js";
import { createFigure } from "./figure.js";

/** @typedef {import("../store.js").Store} Store */
/** @typedef {import("../state.js").View} View */
/** @typedef {import("../state.js").Telemetry} Telemetry */
/** @typedef {import("./stick.js").Poses} Poses */
/** @typedef {import("./kinematics.js").Pose} Pose */

const PLAYING = new Set(["playing", "paused", "stopping"]);

/**
 * Return the poses of a show at an instant of its view: predicted, and authored as the ghost.
 * @param {View} view @param {number} at_s @returns {Poses}
 */
export function posesAt(view, at_s) {
  /** @type {Pose} */
  const predicted = {};
  /** @type {Pose} */
  const authored = {};
  for (const { name } of view.joints) {
    const curves = view.curves[name];
    if (curves === undefined) continue;
    predicted[name] = angleAt(curves.predicted, at_s);
    authored[name] = angleAt(curves.authored ?? curves.plan, at_s);
  }
  return { predicted, authored, read: null };
}

/**
 * How far each joint was from its prediction when it was read last. A frame repeats readings, which
 * are old while the joint moves on: drawn as they are, they would look like a lag that is not there.
 */
export class Deviations {
  /** @type {number[]} */
  #read_deg = [];
  /** @type {number[]} */
  #away_deg = [];

  /** Take a frame; only a reading that differs is new. @param {Telemetry} telemetry */
  take(telemetry) {
    telemetry.read_deg.forEach((read_deg, joint) => {
      if (!Number.isFinite(read_deg) || read_deg === this.#read_deg[joint]) return;
      this.#read_deg[joint] = read_deg;
      this.#away_deg[joint] = read_deg - (telemetry.predicted_deg[joint] ?? NaN);
    });
  }

  /** Return the deviation of a joint; NaN: it was not read yet. @param {number} joint */
  of(joint) {
    return this.#away_deg[joint] ?? NaN;
  }
}

/**
 * Return the poses of a running show: as it is predicted, and as far from it as the servos reported.
 * @param {View} view @param {Telemetry} telemetry @param {Deviations} deviations @returns {Poses}
 */
export function posesOf(view, telemetry, deviations) {
  const poses = posesAt(view, withinView(view, Math.max(0, telemetry.show_s)));
  /** @type {Pose} */
  const read = {};
  let isRead = false;
  view.joints.forEach(({ name }, index) => {
    const predicted_deg = telemetry.predicted_deg[index] ?? NaN;
    if (Number.isFinite(predicted_deg)) poses.predicted[name] = predicted_deg;
    const away_deg = deviations.of(index);
    // A joint that was not read yet stands where it is predicted.
    read[name] = (poses.predicted[name] ?? NaN) + (Number.isFinite(away_deg) ? away_deg : 0);
    isRead ||= Number.isFinite(away_deg);
  });
  return { ...poses, read: isRead ? read : null };
}

/** Instants of a view whose poses are kept in the picture. */
const FRAMED_INSTANTS = 120;

/** Return poses all over a view. @param {View} view */
export function posesAllOver(view) {
  return Array.from({ length: FRAMED_INSTANTS }, (_, i) => {
    const poses = posesAt(view, (i * view.view_s) / (FRAMED_INSTANTS - 1));
    return [poses.predicted, poses.authored ?? {}];
  }).flat();
}

/**
 * What is drawn now: it changes exactly when the picture does.
 * @param {Store} store @returns {[View | null, Telemetry | number, string]}
 */
function drawnState(store) {
  const state = store.state.peek();
  const telemetry = store.telemetry.peek();
  const isPlaying = PLAYING.has(state.player.state) && telemetry?.plan === state.view?.plan;
  return [state.view, isPlaying && telemetry !== null ? telemetry : state.cursor_s, state.theme];
}

/** Why there is nothing to draw. @param {{ robot: import("../pages/robot_view.js").RobotJson }} props */
export function NoFigure({ robot }) {
  return robot.figure_problem === null
    ? html`<p class="quiet">The robot file has no figure: see the guide, “What it looks like”.</p>`
    : html`<p class="quiet figure-problem"><b>⚠ There is no figure.</b> ${robot.figure_problem}</p>`;
}

/** @param {{ store: Store }} props */
export function FigurePanel({ store }) {
  const place = useRef(/** @type {HTMLDivElement | null} */ (null));
  const robot = /** @type {import("../pages/robot_view.js").RobotJson | null} */ (
    store.state.value.robot
  );
  const figure = robot?.figure ?? null;
  useEffect(() => {
    if (place.current === null || figure === null) return undefined;
    const label = "figure: predicted horn solid, authored pose as a ghost, readings thin";
    const shown = createFigure(place.current, figure, { schedule: nextFrame, label });
    /** @type {unknown[]} */
    let drawn = [];
    const deviations = new Deviations();
    const end = onFrame(() => {
      const [view, at, theme] = drawnState(store);
      if (view === null || (view === drawn[0] && at === drawn[1] && theme === drawn[2])) return;
      if (theme !== drawn[2]) shown.setTheme();
      if (view !== drawn[0]) shown.frame(posesAllOver(view));
      drawn = [view, at, theme];
      if (typeof at === "number") {
        shown.show(posesAt(view, at));
        return;
      }
      deviations.take(at);
      shown.show(posesOf(view, at, deviations));
    });
    return () => {
      end();
      shown.dispose();
    };
  }, [figure]);
  if (robot === null) return null;
  if (figure === null) return html`<${NoFigure} robot=${robot} />`;
  return html`<div ref=${place} class="figure-panel"></div>
    <ul class="figure-legend" aria-label="legend of the figure">
      <li class="is-solid">predicted</li>
      <li class="is-ghost">authored</li>
      <li class="is-reading">read</li>
    </ul>`;
}
