// @ts-check
/** Calibrate and identify on the robot page: what happens, its steps, its progress, its plots. */

import { html, useState } from "../vendor/preact.js";
import { Choice } from "../parts/choice.js";

/** @typedef {{title: string, x_name: string, y_name: string, series: {name: string, x: number[], y: number[]}[]}} Plot */
/**
 * @typedef {object} MaintenanceEvent
 * @property {"identify" | "calibrate"} what
 * @property {string} joint
 * @property {"asking" | "running" | "done" | "failed" | "stopped"} state
 * @property {string} step
 * @property {number | null} progress 0 to 1
 * @property {{text: string, answers: string[]} | null} question
 * @property {{lines: string[], plots: Plot[]} | null} result
 */

/** What a person has to know and do, by task. */
const TASKS = {
  calibrate: {
    title: "Calibrate",
    about: "Find zero and direction of a joint by hand.",
    steps: [
      "Hold the robot: the joint goes limp and falls.",
      "Bring the joint to its zero.",
      "Push it by 5° or more towards its larger angles.",
      "Look at the result; it is written to the robot file only if you agree.",
    ],
    /** @param {string} robot @param {string} joint */
    command: (robot, joint) => `lss-motion calibrate ${robot} --joints ${joint}`,
  },
  identify: {
    title: "Identify",
    about: "Measure how the servo of a joint responds: lag, ramps, droop, backlash.",
    steps: [
      "The joint must be free, and nothing may touch it.",
      "It moves for half a minute, at most 20° to either side of where it is, within its limits.",
      "STOP ends it at any time; then nothing is written.",
      "Look at the result; it is written to the robot file only if you agree.",
    ],
    /** @param {string} robot @param {string} joint */
    command: (robot, joint) => `lss-motion identify --robot ${robot} ${joint}`,
  },
};

const STATES = { asking: "your turn", running: "running", done: "done", failed: "failed", stopped: "stopped" };

/**
 * @param {object} props
 * @param {string[]} props.joints
 * @param {string} props.file
 * @param {MaintenanceEvent | null} props.event
 * @param {boolean} props.mayMove
 * @param {string} props.why
 * @param {(op: string, fields: object) => Promise<void>} props.act
 */
export function Maintenance({ joints, file, event, mayMove, why, act }) {
  const [what, setWhat] = useState(/** @type {"calibrate" | "identify"} */ ("calibrate"));
  const [joint, setJoint] = useState("");
  const chosen = joints.includes(joint) ? joint : (joints[0] ?? "");
  const task = TASKS[what];
  const isBusy = mayMove && event !== null && (event.state === "asking" || event.state === "running");
  return html`<section class="robot-maintenance" aria-labelledby="robot-maintenance-title">
    <h2 id="robot-maintenance-title">Calibrate and identify</h2>
    <div class="robot-row">
      <${Choice} label="what to do" options=${Object.entries(TASKS).map(([key, { title }]) => [key, title])} chosen=${what} choose=${setWhat} />
      <${Choice} label="joint" options=${joints.map((name) => [name, name])} chosen=${chosen} choose=${setJoint} />
    </div>
    <p>${task.about}</p>
    <ol>
      ${task.steps.map((step) => html`<li>${step}</li>`)}
    </ol>
    <div class="robot-row">
      <button type="button" disabled=${!mayMove || isBusy} title=${mayMove ? undefined : why} onClick=${() => act("maintenance", { what, joint: chosen })}>
        ${task.title} ${chosen}
      </button>
      <span class="robot-quiet">or in a terminal: <code>${task.command(file, chosen)}</code></span>
    </div>
    ${event === null ? null : html`<${Progress} event=${event} mayMove=${mayMove} act=${act} />`}
  </section>`;
}

/** @param {{event: MaintenanceEvent, mayMove: boolean, act: (op: string, fields: object) => Promise<void>}} props */
function Progress({ event, mayMove, act }) {
  const { question, result, progress } = event;
  return html`<div class="robot-progress" data-state=${event.state}>
    <p role="status"><b>${event.what} ${event.joint}: ${STATES[event.state]}.</b> ${event.step}</p>
    ${progress === null
      ? null
      : html`<progress max="1" value=${progress} aria-label=${`progress of ${event.what} ${event.joint}`}></progress>`}
    ${question === null
      ? null
      : html`<p>${question.text}</p>
          <div class="robot-row">
            ${question.answers.map(
              (answer) =>
                html`<button type="button" disabled=${!mayMove} onClick=${() => act("maintenance.answer", { answer })}>${answer}</button>`,
            )}
          </div>`}
    ${result === null
      ? null
      : html`<ul>
            ${result.lines.map((line) => html`<li>${line}</li>`)}
          </ul>
          ${result.plots.map((plot) => html`<${LinePlot} plot=${plot} />`)}`}
  </div>`;
}

const [PLOT_WIDTH, PLOT_HEIGHT, PLOT_MARGIN] = [480, 200, 40];

/**
 * Return the SVG path of a series within the bounds.
 * @param {number[]} x @param {number[]} y @param {{low: number, high: number}} across @param {{low: number, high: number}} up
 */
export function plotPath(x, y, across, up) {
  const width = PLOT_WIDTH - 2 * PLOT_MARGIN;
  const height = PLOT_HEIGHT - 2 * PLOT_MARGIN;
  return x
    .map((value, i) => {
      const x_px = PLOT_MARGIN + (width * (value - across.low)) / (across.high - across.low || 1);
      const y_px = PLOT_HEIGHT - PLOT_MARGIN - (height * (y[i] - up.low)) / (up.high - up.low || 1);
      return `${i === 0 ? "M" : "L"}${x_px.toFixed(1)} ${y_px.toFixed(1)}`;
    })
    .join("");
}

/** @param {number[][]} series */
function boundsOf(series) {
  let [low, high] = [Infinity, -Infinity];
  for (const values of series) {
    for (const value of values) {
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  }
  return low <= high ? { low, high } : { low: 0, high: 1 };
}

/** @param {{plot: Plot}} props */
function LinePlot({ plot }) {
  const across = boundsOf(plot.series.map((one) => one.x));
  const up = boundsOf(plot.series.map((one) => one.y));
  const bottom = PLOT_HEIGHT - PLOT_MARGIN;
  const names = plot.series.map((one) => one.name).join(", ");
  return html`<figure class="robot-plot">
    <figcaption>${plot.title}</figcaption>
    <svg viewBox=${`0 0 ${PLOT_WIDTH} ${PLOT_HEIGHT}`} role="img" aria-label=${`${plot.title}: ${names}`}>
      <path class="robot-plot-axes" d=${`M${PLOT_MARGIN} ${PLOT_MARGIN}V${bottom}H${PLOT_WIDTH - PLOT_MARGIN}`} />
      ${plot.series.map(
        (one, i) => html`<path class=${`robot-plot-line robot-plot-line-${i}`} d=${plotPath(one.x, one.y, across, up)} />`,
      )}
      <text x=${PLOT_MARGIN} y=${PLOT_MARGIN - 8}>${plot.y_name}</text>
      <text x=${PLOT_MARGIN - 6} y=${bottom} text-anchor="end">${up.low.toPrecision(3)}</text>
      <text x=${PLOT_MARGIN - 6} y=${PLOT_MARGIN + 4} text-anchor="end">${up.high.toPrecision(3)}</text>
      <text x=${PLOT_MARGIN} y=${bottom + 16}>${across.low.toPrecision(3)}</text>
      <text x=${PLOT_WIDTH - PLOT_MARGIN} y=${bottom + 16} text-anchor="end">${across.high.toPrecision(3)} ${plot.x_name}</text>
    </svg>
    <ul class="robot-legend">
      ${plot.series.map((one, i) => html`<li class=${`robot-plot-line-${i}`}>${one.name}</li>`)}
    </ul>
  </figure>`;
}
