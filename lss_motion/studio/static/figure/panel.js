// @ts-check
/** The figure of a show: the plan at the cursor, and the robot while it plays. */

import { html, useEffect, useRef, useState } from "../vendor/preact.js";
import { angleAt, withinView } from "../curves.js";
import { nextFrame, onFrame } from "../frames.js";
import { createFigure } from "./figure.js";

/** @typedef {import("../store.js").Store} Store */
/** @typedef {import("../state.js").View} View */
/** @typedef {import("../state.js").Telemetry} Telemetry */
/** @typedef {import("./stick.js").Poses} Poses */
/** @typedef {import("./kinematics.js").Pose} Pose */

/** What a show does while its figure is that of the telemetry. */
const RUNNING = new Set(["starting", "ready", "playing", "paused", "stopping"]);

/** Whether what the author asks for is not what is planned. @param {View} view */
function hasGhost(view) {
  return view.stretched.length > 0 || view.given_up.length > 0;
}

/**
 * Return the poses of a show at an instant of its view, and as the robot was read last.
 * @param {View} view @param {number} at_s @returns {Poses}
 */
export function posesAt(view, at_s) {
  /** @type {Pose} */
  const solid = Object.create(null);
  /** @type {Pose} */
  const authored = Object.create(null);
  for (const { name } of view.joints) {
    const curves = view.curves[name];
    if (curves === undefined) continue;
    solid[name] = angleAt(curves.plan, at_s);
    authored[name] = angleAt(curves.authored ?? curves.plan, at_s);
  }
  return { solid, isRead: false, authored: hasGhost(view) ? authored : null, line: null };
}

/**
 * Return the pose of the robot: where it is predicted, and as far from that as the servos reported;
 * null while none has.
 * @param {string[]} joints @param {Telemetry} telemetry @param {import("../readings.js").Deviations} deviations @returns {Pose | null}
 */
function readPose(joints, telemetry, deviations) {
  /** @type {Pose} */
  const read = Object.create(null);
  let isRead = false;
  joints.forEach((name, index) => {
    const away_deg = deviations.of(index);
    // A joint that was not read yet stands where it is predicted.
    read[name] = (telemetry.predicted_deg[index] ?? NaN) + (Number.isFinite(away_deg) ? away_deg : 0);
    isRead ||= Number.isFinite(away_deg);
  });
  return isRead ? read : null;
}

/**
 * Return where the robot stands, as it was read last: connected, while anything is played (also what
 * another view than this shows) and after that; null while that is not known.
 * @param {Store} store @returns {Pose | null}
 */
export function robotPose(store) {
  const { robot_state, started } = store.state.peek();
  const telemetry = store.telemetry.peek();
  if (telemetry !== null) return started === null ? null : readPose(started.joints, telemetry, store.deviations);
  if (robot_state?.state !== "live") return null;
  const joints = Object.entries(robot_state.joints);
  return joints.every(([, joint]) => joint.deg === null) ? null : Object.fromEntries(joints.map(([name, joint]) => [name, joint.deg]));
}

/**
 * Return what is drawn. The robot stands where it was read last, whatever the cursor shows; only who
 * looks for an instant (`isSought`) while no show runs sees the plan of the cursor, the robot thin.
 * @param {View} view @param {Pose | null} read @param {{ at_s: number, isRunning: boolean, isSought: boolean }} when
 * @returns {Poses}
 */
export function posesOf(view, read, { at_s, isRunning, isSought }) {
  const planned = posesAt(view, at_s);
  if (read === null) return planned;
  if (isSought && !isRunning) return { ...planned, line: read };
  return { ...planned, solid: read, isRead: true, line: isRunning ? planned.solid : null };
}

/** Instants of a view whose poses are kept in the picture. */
const FRAMED_INSTANTS = 120;

/** Return poses all over a view. @param {View} view */
export function posesAllOver(view) {
  return Array.from({ length: FRAMED_INSTANTS }, (_, i) => {
    const { solid, authored } = posesAt(view, (i * view.view_s) / (FRAMED_INSTANTS - 1));
    return [solid, authored ?? {}];
  }).flat();
}

/** Why there is nothing to draw. @param {{ robot: import("../pages/robot_view.js").RobotJson }} props */
export function NoFigure({ robot }) {
  return robot.figure_problem === null
    ? html`<p class="quiet">The robot file has no figure: see the guide, “What it looks like”.</p>`
    : html`<p class="quiet figure-problem"><b>⚠ There is no figure.</b> ${robot.figure_problem}</p>`;
}

/** @param {{ store: Store, isSought?: boolean }} props */
export function FigurePanel({ store, isSought = false }) {
  const place = useRef(/** @type {HTMLDivElement | null} */ (null));
  const [drawn_as, setDrawnAs] = useState("plan");
  const robot = /** @type {import("../pages/robot_view.js").RobotJson | null} */ (
    store.state.value.robot
  );
  const figure = robot?.figure ?? null;
  useEffect(() => {
    if (place.current === null || figure === null) return undefined;
    const label = "figure: the robot as it was read, else the plan; the authored pose as a ghost";
    const shown = createFigure(place.current, figure, { schedule: nextFrame, label });
    /** @type {unknown[]} */
    let drawn = [];
    const end = onFrame(() => {
      const { view, player, cursor_s, theme, robot_state, posed } = store.state.peek();
      const newest = store.telemetry.peek();
      const telemetry = newest?.plan === view?.plan ? newest : null;
      const isRunning = RUNNING.has(player.state) && telemetry !== null;
      const now = [view, newest, isRunning, cursor_s, theme, robot_state, posed];
      if (view === null || now.every((one, index) => one === drawn[index])) return;
      if (theme !== drawn[4]) shown.setTheme();
      if (view !== drawn[0]) shown.frame(posesAllOver(view));
      drawn = now;
      const at_s = isRunning && telemetry !== null ? withinView(view, Math.max(0, telemetry.show_s)) : cursor_s;
      const poses = posesOf(view, robotPose(store), { at_s, isRunning, isSought });
      if (isSought && posed !== null) Object.assign(poses.solid, posed);
      setDrawnAs([poses.isRead ? "read" : "plan", ...(poses.line === null ? [] : [poses.isRead ? "plan" : "read"])].join(" "));
      shown.show(poses);
    });
    return () => {
      end();
      shown.dispose();
    };
  }, [figure]);
  if (robot === null) return null;
  if (figure === null) return html`<${NoFigure} robot=${robot} />`;
  const view = store.state.value.view;
  return html`<div ref=${place} class="figure-panel"></div>
    ${view === null ? null : html`<ul class="figure-legend" aria-label="legend of the figure">
      ${drawn_as.split(" ").map((name, index) => html`<li key=${name} class=${`is-${name} ${index === 0 ? "is-solid" : ""}`}>${name}</li>`)}
      ${hasGhost(view) ? html`<li class="is-authored">authored</li>` : null}
    </ul>`}`;
}
