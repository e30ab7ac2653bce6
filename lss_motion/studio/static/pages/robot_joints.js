// @ts-check
/** The joints of the robot page: limits with the angle now, jog buttons, health, limp and hold. */

import { html, useMemo } from "../vendor/preact.js";
import { number } from "../numbers.js";
import { dragHandlers, holdHandlers } from "./robot_jog.js";

/** @typedef {import("./robot_view.js").JointView} JointView */
/** @typedef {import("./robot_view.js").JointHealth} JointHealth */
/** @typedef {import("./robot_jog.js").JogHold} JogHold */

/** A joint nearer to the end of its range than this share of it is marked. */
const NEAR_END_RATIO = 0.03;
/** A horn at the end of its range is read some tenths of a degree beyond: steps of 0.1° and noise. */
const NOISE_DEG = 0.5;

/**
 * Return where an angle is on the strip of a joint, 0 to 1, and whether it is near or beyond an end.
 * @param {number[]} range_deg @param {number} deg
 */
export function placeOnStrip(range_deg, deg) {
  const [low, high] = range_deg;
  const share = (deg - low) / (high - low);
  const beyond_deg = Math.max(low - deg, deg - high);
  return {
    share: Math.min(Math.max(share, 0), 1),
    isNear: beyond_deg <= NOISE_DEG && Math.min(share, 1 - share) < NEAR_END_RATIO,
    isOutside: beyond_deg > NOISE_DEG,
  };
}

/** @param {ReturnType<typeof placeOnStrip> | null} place */
function wordOf(place) {
  return place?.isOutside ? "beyond its limit" : place?.isNear ? "near its limit" : "";
}

/** @param {number | null | undefined} value @param {number} places @param {string} unit */
export function shown(value, places, unit) {
  const text = number(value, places);
  return text === "–" ? text : `${text}${unit === "°" ? "" : "\u00a0"}${unit}`;
}

/**
 * Return what is wrong with a servo, in words; an empty text if nothing is.
 * @param {JointView} joint @param {JointHealth | undefined} health
 */
export function troubleOf(joint, health) {
  if (health === undefined) return "";
  const { temperature_c, voltage_v, status } = health;
  const troubles = [];
  const hot_c = joint.temperature_max_c ?? Infinity;
  if (temperature_c !== null && temperature_c > hot_c) troubles.push(`hot (above ${hot_c} °C)`);
  const low_v = joint.voltage_min_v ?? 0;
  if (voltage_v !== null && voltage_v < low_v) troubles.push(`low voltage (below ${low_v} V)`);
  if (status !== null && /stuck|blocked|safe|error/i.test(status)) troubles.push(status);
  return troubles.join(", ");
}

/**
 * @param {object} props
 * @param {JointView[]} props.joints
 * @param {Record<string, {deg: number | null, is_limp: boolean}>} props.live
 * @param {Record<string, JointHealth>} props.health
 * @param {boolean} props.mayMove
 * @param {string} props.why why nothing may be moved
 * @param {string | null} props.held the joint that is jogged
 * @param {JogHold} props.hold
 * @param {number} props.speed_ratio
 * @param {(op: string, fields: object) => void} props.act
 */
export function JointTable(props) {
  return html`<table class="robot-joints">
    <caption class="hidden">
      Joints: limits, angle, jog, health
    </caption>
    <thead>
      <tr>
        <th scope="col">Joint</th>
        <th scope="col">${props.mayMove ? "Drag to turn" : "Within its limits"}</th>
        <th scope="col" class="robot-number">Angle</th>
        <th scope="col">Jog (hold)</th>
        <th scope="col">Servo, as read</th>
        <th scope="col">Power</th>
      </tr>
    </thead>
    <tbody>
      ${props.joints.map((joint) => html`<${JointRow} key=${joint.name} joint=${joint} ...${props} />`)}
    </tbody>
  </table>`;
}

/** @param {any} props those of the table, and `joint` */
function JointRow({ joint, live, health, mayMove, why, held, hold, speed_ratio, act }) {
  const now = live[joint.name];
  const isLimp = now?.is_limp ?? false;
  const deg = now?.deg ?? null;
  const trouble = troubleOf(joint, health[joint.name]);
  const power = isLimp ? "Hold" : "Limp";
  return html`<tr class=${held === joint.name ? "is-held" : ""} data-joint=${joint.name}>
    <th scope="row">
      ${joint.name}<small>${joint.model} · id ${joint.id}${joint.bus === "main" ? "" : ` · ${joint.bus}`}</small>
    </th>
    <td><${LimitStrip} ...${{ joint, deg, hold, speed_ratio, mayMove, held }} /></td>
    <td class="robot-number"><span class="robot-angle">${shown(deg, 1, "°")}</span><small>${deg === null ? "" : wordOf(placeOnStrip(joint.range_deg, deg))}</small></td>
    <td class="robot-jog">
      <${JogButton} joint=${joint.name} sign=${-1} ...${{ hold, speed_ratio, mayMove, why, held }} />
      <${JogButton} joint=${joint.name} sign=${1} ...${{ hold, speed_ratio, mayMove, why, held }} />
    </td>
    <td><${ServoHealth} health=${health[joint.name]} trouble=${trouble} /></td>
    <td>
      <button
        type="button"
        class="robot-power"
        disabled=${!mayMove}
        title=${mayMove ? "" : why}
        aria-label=${`${power} ${joint.name}`}
        onClick=${() => act(isLimp ? "hold" : "limp", { joints: [joint.name] })}
      >
        ${power}
      </button>
    </td>
  </tr>`;
}

/** Where a joint is within its limits; where it may be moved, a slider that turns it while it is held.
 * @param {any} props */
function LimitStrip({ joint, deg, hold, speed_ratio, mayMove, held }) {
  const [low, high] = joint.range_deg;
  const place = deg === null ? null : placeOnStrip(joint.range_deg, deg);
  const word = wordOf(place);
  const at = deg === null ? "angle unknown" : `${number(deg, 1)}° ${word}`;
  const zero = low < 0 && high > 0 ? placeOnStrip(joint.range_deg, 0).share : null;
  const speed = useMemo(() => ({ ratio: 0 }), []);
  speed.ratio = speed_ratio;
  const handlers = useMemo(() => dragHandlers(hold, joint.name, joint.range_deg, () => speed.ratio), [hold, joint]);
  return html`<div class="robot-strip ${place?.isOutside ? "is-outside" : place?.isNear ? "is-near" : ""} ${mayMove ? "is-slider" : ""}">
    <span class="robot-strip-end">${number(low, 0)}</span>
    <span
      class="robot-strip-reach"
      role=${mayMove ? "slider" : "meter"}
      tabindex=${mayMove ? 0 : undefined}
      aria-label=${mayMove ? `${joint.name}: turns there while it is held` : `${joint.name} within its limits`}
      aria-valuemin=${low}
      aria-valuemax=${high}
      aria-valuenow=${deg === null ? low : Math.min(Math.max(deg, low), high)}
      aria-valuetext=${at.trim()}
      ...${mayMove ? handlers : {}}
    ><span class="robot-strip-bar">
      ${zero === null ? null : html`<i class="robot-strip-zero" style=${{ left: `${100 * zero}%` }}></i>`}
      ${place === null ? null : html`<i class="robot-strip-mark ${held === joint.name ? "is-held" : ""}" style=${{ left: `${100 * place.share}%` }}></i>`}
    </span></span>
    <span class="robot-strip-end">${number(high, 0)}</span>
  </div>`;
}

/** @param {any} props */
function JogButton({ joint, sign, hold, speed_ratio, mayMove, why, held }) {
  const speed = useMemo(() => ({ ratio: 0 }), []);
  speed.ratio = sign * speed_ratio;
  const handlers = useMemo(() => holdHandlers(hold, joint, () => speed.ratio), [hold, joint]);
  return html`<button
    type="button"
    disabled=${!mayMove}
    title=${mayMove ? "hold to turn; it stops when you let go" : why}
    aria-label=${`Jog ${joint} ${sign < 0 ? "down" : "up"} while held`}
    aria-pressed=${held === joint && hold.sign === sign}
    ...${handlers}
  >
    ${sign < 0 ? "−" : "+"}
  </button>`;
}

/** @param {{health: JointHealth | undefined, trouble: string}} props */
function ServoHealth({ health, trouble }) {
  const isRead = health !== undefined && [health.temperature_c, health.voltage_v, health.current_a, health.status].some((one) => one !== null);
  if (!isRead) return html`<span class="robot-quiet">not read</span>`;
  return html`<span class="robot-health">
    <span>${shown(health.temperature_c, 0, "°C")}</span>
    <span>${shown(health.voltage_v, 1, "V")}</span>
    <span>${shown(health.current_a, 2, "A")}</span>
    ${health.error_deg == null ? null : html`<span>${shown(health.error_deg, 1, "°")} off</span>`}
    <span class=${trouble ? "robot-trouble" : "robot-quiet"}>${trouble ? `⚠ ${trouble}` : (health.status ?? "").replaceAll("_", " ")}</span>
  </span>`;
}
