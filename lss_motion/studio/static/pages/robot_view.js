// @ts-check
/** The robot page, as a function of plain values; `robot.js` takes them from the store. */

import { html, useEffect, useMemo, useRef, useState } from "../vendor/preact.js";
import { createFigure } from "../figure/figure.js";
import { NoFigure } from "../figure/panel.js";
import { Choice } from "../parts/choice.js";
import { JogHold } from "./robot_jog.js";
import { JointTable, shown } from "./robot_joints.js";
import { Maintenance } from "./robot_maintenance.js";
import { PoseList } from "./robot_poses.js";

/**
 * @typedef {object} JointView
 * @property {string} name
 * @property {number} id
 * @property {string} bus
 * @property {string} model
 * @property {number[]} range_deg
 * @property {number | null} speed_max_deg_s
 * @property {number | null} accel_max_deg_s2
 * @property {number} [temperature_max_c]
 * @property {number} [voltage_min_v]
 */
/** @typedef {{status: string | null, temperature_c: number | null, voltage_v: number | null, current_a: number | null, error_deg?: number | null}} JointHealth */
/**
 * @typedef {object} RobotJson
 * @property {string} name
 * @property {string | null} file
 * @property {JointView[]} joints
 * @property {Record<string, Record<string, number>>} poses
 * @property {import("../figure/kinematics.js").Figure | null} figure
 * @property {string | null} figure_problem why there is none
 */
/**
 * @typedef {object} LiveRobot
 * @property {"off" | "connecting" | "live" | "playing"} state
 * @property {string} port
 * @property {boolean} is_simulated
 * @property {Record<string, {deg: number | null, is_limp: boolean}>} joints
 * @property {string} text
 */
/**
 * @typedef {object} FoundServo
 * @property {string} bus
 * @property {number} id
 * @property {string} model
 * @property {string | null} joint
 * @property {number | null} firmware
 * @property {number | null} voltage_v
 * @property {number | null} temperature_c
 * @property {string | null} status
 * @property {boolean} is_shared
 */
/** @typedef {{servos: FoundServo[], problems: string[]}} Scanned */
/** @typedef {{title: string, text: string, yes: string, run: () => void}} Question */

/** Share of the jogging speed by word. */
const SPEEDS = { slow: 0.2, medium: 0.5, fast: 1 };

/** Of no more joints the figure takes the height of a large window. */
const FEW_JOINTS = 6;

const STATES = {
  off: "not connected",
  connecting: "connecting …",
  live: "connected",
  playing: "in the hands of the show",
};

/**
 * Return why nothing can be moved now; an empty text if it can.
 * @param {LiveRobot} live @param {boolean} isMine @param {boolean} isLatched @param {boolean} isLost
 */
export function whyStill(live, isMine, isLatched, isLost) {
  if (isLost) return "the connection to the studio is lost";
  if (!isMine) return "this page does not operate; press Operate above";
  if (live.state === "playing") return "the show or stage has the robot; stop it first";
  if (isLatched) return "it was stopped: arm it again first";
  if (live.state === "connecting") return "the servos are being asked; wait a moment";
  if (live.state !== "live") return "connect to the robot first";
  return "";
}

/**
 * @param {object} props
 * @param {RobotJson} props.robot
 * @param {LiveRobot} props.live
 * @param {import("../figure/kinematics.js").Pose | null} props.stood where it was read last; null: not yet
 * @param {Record<string, JointHealth>} props.health
 * @param {boolean} props.isMine
 * @param {boolean} props.isLatched
 * @param {boolean} props.isLost
 * @param {Scanned | null} props.scanned
 * @param {any} props.maintenance
 * @param {(op: string, fields: object) => Promise<unknown>} props.send
 * @param {(question: Question) => void} props.ask
 * @param {(draw: () => void) => void} props.schedule
 * @param {unknown} props.theme
 * @param {() => void} [props.puppeteer] opens what leads the joints
 */
export function RobotView({ robot, live, stood, health, isMine, isLatched, isLost, scanned, maintenance, send, ask, schedule, theme, puppeteer }) {
  const [problem, setProblem] = useState("");
  const [held, setHeld] = useState(/** @type {string | null} */ (null));
  const [speed, setSpeed] = useState(/** @type {keyof typeof SPEEDS} */ ("medium"));
  const why = whyStill(live, isMine, isLatched, isLost);
  const mayMove = why === "";
  /** @param {string} op @param {object} fields */
  const act = async (op, fields) => {
    setProblem("");
    try {
      await send(op, fields);
    } catch (error) {
      setProblem(error instanceof Error ? error.message : String(error));
    }
  };
  const hold = useMemo(
    () =>
      new JogHold((joint, wish) => {
        send("jog", { joint, ...wish }).catch((error) => {
          hold.stop();
          setProblem(error.message);
        });
      }, setHeld),
    [],
  );
  useEffect(() => hold.watch(), [hold]);
  useEffect(() => {
    if (!mayMove) hold.stop();
  }, [hold, mayMove]);
  const isOn = live.state === "live";
  const mayConnect = isMine && !isLost && (live.state === "off" || live.state === "live");
  return html`<main class=${`page robot-page ${robot.joints.length <= FEW_JOINTS ? "robot-short" : ""}`}>
    <header class="robot-head">
      <h1>${robot.name}</h1>
      <p role="status">
        <b>${STATES[live.state]}</b>${live.is_simulated ? " · simulated" : ""} · ${live.port}${live.text ? ` · ${live.text}` : ""}
      </p>
      <div class="robot-row">
        <button type="button" disabled=${!mayConnect} onClick=${() => act(isOn ? "disconnect" : "connect", {})}>
          ${isOn ? "Disconnect" : "Connect"}
        </button>
        <button type="button" disabled=${!mayMove} title=${why} onClick=${() => act("hold", { joints: [] })}>Hold all</button>
        <button type="button" class="robot-power" disabled=${!mayMove} title=${why} onClick=${() => limpAll(ask, act)}>Limp all …</button>
        <button
          type="button"
          disabled=${!isMine || isLost || live.state !== "off"}
          title=${live.state === "off" ? "find the servos of every bus; nothing moves" : "disconnect first"}
          onClick=${() => act("scan", {})}
        >
          Scan
        </button>
        ${puppeteer === undefined ? null : html`<button type="button" onClick=${puppeteer}>Puppeteer …</button>`}
        <${Choice} label="jog speed" options=${Object.keys(SPEEDS).map((word) => [word, word])} chosen=${speed} choose=${setSpeed} />
      </div>
      <p class="robot-why" role="status">${problem ? html`<span class="robot-trouble">⚠ ${problem}</span>` : why ? `Nothing can be moved: ${why}.` : "Drag a slider, or hold + or −, to turn a joint; let go to stop it."}</p>
    </header>
    <div class="robot-side">
      <div class="robot-look"><${FigureBox} robot=${robot} stood=${stood} schedule=${schedule} theme=${theme} /></div>
      <${PoseList} poses=${robot.poses} mayMove=${mayMove} why=${why} act=${act} ask=${ask} />
    </div>
    <div class="robot-main">
      <${JointTable}
        joints=${robot.joints}
        live=${live.joints}
        health=${health}
        speed_ratio=${SPEEDS[speed]}
        ...${{ mayMove, why, held, hold, act }}
      />
      ${scanned === null ? null : html`<${ScanResult} scanned=${scanned} />`}
      <${Maintenance} joints=${robot.joints.map((joint) => joint.name)} file=${robot.file ?? "robot.yaml"} event=${maintenance}
        ...${{ mayMove, why, act }} />
    </div>
  </main>`;
}

/** @param {(question: Question) => void} ask @param {(op: string, fields: object) => Promise<void>} act */
function limpAll(ask, act) {
  const text = "All joints lose their power and the robot falls. Hold it.";
  ask({ title: "Limp all?", text, yes: "Limp all", run: () => act("limp", { joints: [] }) });
}

/** @param {{robot: RobotJson, stood: import("../figure/kinematics.js").Pose | null, schedule: (draw: () => void) => void, theme: unknown}} props */
function FigureBox({ robot, stood, schedule, theme }) {
  const place = useRef(/** @type {HTMLDivElement | null} */ (null));
  const shown = useRef(/** @type {ReturnType<typeof createFigure> | null} */ (null));
  useEffect(() => {
    if (place.current === null || robot.figure === null) return undefined;
    const label = `figure of ${robot.name}, as it stands`;
    const figure = createFigure(place.current, robot.figure, { schedule, label });
    figure.frame([{}]);
    shown.current = figure;
    return () => figure.dispose();
  }, [robot.figure]);
  useEffect(() => shown.current?.setPose({ solid: stood ?? {}, isRead: stood !== null }), [robot.figure, JSON.stringify(stood)]);
  useEffect(() => shown.current?.setTheme(), [theme]);
  if (robot.figure === null) return html`<${NoFigure} robot=${robot} />`;
  const notes = robot.figure.notes.map((note) => html`<li>${note}</li>`);
  return html`<div ref=${place} class="robot-figure"></div>
    <ul class="figure-legend" aria-label="legend of the figure"><li class=${`is-solid ${stood === null ? "" : "is-read"}`}>${stood === null ? "not read: every joint at 0°" : "read"}</li></ul>
    ${notes.length > 0 ? html`<ul class="robot-quiet">${notes}</ul>` : null}`;
}

/** @param {{scanned: Scanned}} props */
function ScanResult({ scanned }) {
  const { servos, problems } = scanned;
  return html`<section class="robot-scan" aria-labelledby="robot-scan-title">
    <h2 id="robot-scan-title">Scan</h2>
    <p role="status">${servos.length} ${servos.length === 1 ? "servo" : "servos"} found.</p>
    ${problems.length === 0
      ? null
      : html`<ul class="robot-problems">
          ${problems.map((text) => html`<li><span class="robot-trouble" aria-hidden="true">⚠</span> ${text}</li>`)}
        </ul>`}
    ${servos.length === 0
      ? null
      : html`<table>
          <thead>
            <tr>
              ${["Joint", "Bus", "Id", "Model", "Firmware", "Temperature", "Voltage", "Status"].map((title) => html`<th scope="col">${title}</th>`)}
            </tr>
          </thead>
          <tbody>
            ${servos.map(
              (servo) =>
                html`<tr>
                  <th scope="row">${servo.joint ?? "not in the robot file"}</th>
                  <td>${servo.bus}</td>
                  <td>${servo.id}${servo.is_shared ? html` <b class="robot-trouble">several servos</b>` : ""}</td>
                  <td>${servo.model}</td>
                  <td>${servo.firmware ?? "–"}</td>
                  <td>${shown(servo.temperature_c, 0, "°C")}</td>
                  <td>${shown(servo.voltage_v, 1, "V")}</td>
                  <td>${servo.status ?? "–"}</td>
                </tr>`,
            )}
          </tbody>
        </table>`}
  </section>`;
}
