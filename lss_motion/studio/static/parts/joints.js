// @ts-check
/**
 * The state of every joint: angle, error, temperature, voltage, load. What changes many times a second
 * is drawn into the rows by `drawAngles`; the rest is rendered when `health` comes.
 */

import { html } from "../vendor/preact.js";

/** @typedef {import("../state.js").State} State */
/** @typedef {import("../state.js").JointView} JointView */
/** @typedef {import("../state.js").JointHealth} JointHealth */

/** Share of what is allowed from which a value is a warning. */
const NEAR_RATIO = 0.8;
/** This far below the limit of temperature, or above that of voltage, is a warning. */
const NEAR_C = 8;
const NEAR_V = 0.3;
const OLD_S = 0.6;

/** @param {{ state: State }} props */
export function Joints({ state }) {
  const { view, health } = state;
  if (view === null) return html`<p class="muted">No plan yet.</p>`;
  const many = view.joints.length > 9;
  return html`<table class=${`joints ${many ? "joints-many" : ""}`}>
    <caption class="hidden">State of every joint</caption>
    <thead><tr><th scope="col">joint</th><th scope="col" class="wide">angle</th><th scope="col">deg</th>
      <th scope="col">error</th><th scope="col">load</th><th scope="col">°C</th><th scope="col">V</th><th scope="col">state</th></tr></thead>
    <tbody>${view.joints.map((joint) => html`<${Joint} key=${joint.name} joint=${joint} own=${health?.joints[joint.name] ?? null} />`)}</tbody>
  </table>`;
}

/** @param {{ joint: JointView, own: JointHealth | null }} props */
function Joint({ joint, own }) {
  const error = own?.error_deg ?? null;
  const ratio = own === null || error === null ? 0 : Math.abs(error) / own.allowed_deg;
  const isHot = own?.temperature_c != null && own.temperature_c > joint.temperature_max_c - NEAR_C;
  const isLow = own?.voltage_v != null && own.voltage_v < joint.voltage_min_v + NEAR_V;
  return html`<tr>
    <th scope="row" title=${`servo ${joint.id} on ${joint.bus}, ${joint.servo}`}>${joint.name}</th>
    <td class="wide"><${AngleBar} joint=${joint} /></td>
    <td class="number" data-angle=${joint.name}>–</td>
    <td class=${`number ${ratio > 1 ? "bad" : ratio > NEAR_RATIO ? "warn" : ""}`}>${ratio > NEAR_RATIO ? "▲ " : ""}${number(error, 1)}</td>
    <td class="number">${own?.current_a == null ? "–" : `${number(own.current_a, 2)} A`}</td>
    <td class=${`number ${isHot ? "warn" : ""}`}>${isHot ? "▲ " : ""}${number(own?.temperature_c, 0)}</td>
    <td class=${`number ${isLow ? "warn" : ""}`}>${isLow ? "▼ " : ""}${number(own?.voltage_v, 1)}</td>
    <td class="state">${statusText(own?.status ?? null)}</td></tr>`;
}

/** The range of a joint; marks for the plan (bar), the prediction and the reading (dot).
 * @param {{ joint: JointView }} props */
function AngleBar({ joint }) {
  return html`<div class="angle" data-bar=${joint.name} data-low=${joint.range_deg[0]} data-high=${joint.range_deg[1]}
    aria-hidden="true"><i class="angle-zero" style=${{ left: percent(0, joint.range_deg) }}></i>
    <i class="angle-plan"></i><i class="angle-read"></i></div>`;
}

/** @param {number} deg @param {[number, number]} range_deg */
function percent(deg, range_deg) {
  const share = (deg - range_deg[0]) / Math.max(range_deg[1] - range_deg[0], 1e-6);
  return `${(100 * Math.min(Math.max(share, 0), 1)).toFixed(2)}%`;
}

/** @param {number | null | undefined} value @param {number} digits */
function number(value, digits) {
  return value == null ? "–" : value.toFixed(digits).replace("-", "−");
}

/** @param {string | null} status */
function statusText(status) {
  return status === null ? "–" : status.replaceAll("_", " ");
}

/** @type {WeakMap<Element, { deg: number, at_s: number }>} */
const newest = new WeakMap();

/** Whether a reading has not changed for long: it may be an old one, and is drawn hollow.
 * @param {Element} dot @param {number} read_deg @param {number} show_s */
function isOld(dot, read_deg, show_s) {
  const before = newest.get(dot);
  if (before !== undefined && before.deg === read_deg && show_s >= before.at_s) return show_s - before.at_s > OLD_S;
  newest.set(dot, { deg: read_deg, at_s: show_s });
  return false;
}

/**
 * Draw the newest angles into the rows. @param {Element} page
 * @param {import("../state.js").Telemetry} frame @param {string[]} order the joints of the frame
 */
export function drawAngles(page, frame, order) {
  for (const bar of page.querySelectorAll("[data-bar]")) {
    const { bar: name, low, high } = /** @type {HTMLElement} */ (bar).dataset;
    const index = order.indexOf(name ?? "");
    if (index < 0) continue;
    const range_deg = /** @type {[number, number]} */ ([Number(low), Number(high)]);
    const planned_deg = /** @type {number} */ (frame.planned_deg[index]);
    const read_deg = /** @type {number} */ (frame.read_deg[index]);
    const [, plan, read] = /** @type {HTMLElement[]} */ ([...bar.children]);
    if (plan !== undefined) plan.style.left = percent(planned_deg, range_deg);
    if (read !== undefined) {
      read.style.left = percent(Number.isNaN(read_deg) ? planned_deg : read_deg, range_deg);
      read.style.visibility = Number.isNaN(read_deg) ? "hidden" : "visible";
      read.classList.toggle("old", isOld(read, read_deg, frame.show_s));
    }
  }
  for (const cell of page.querySelectorAll("[data-angle]")) {
    const index = order.indexOf(/** @type {HTMLElement} */ (cell).dataset["angle"] ?? "");
    const read_deg = frame.read_deg[index];
    const planned_deg = frame.planned_deg[index];
    if (read_deg === undefined || planned_deg === undefined) continue;
    const text = number(Number.isNaN(read_deg) ? planned_deg : read_deg, 1);
    if (cell.textContent !== text) cell.textContent = text;
  }
}
