// @ts-check
/** What comes over the wire as values: telemetry frames and views. Pure. */

import { bytes8, curveFrom, floats32 } from "./curves.js";

const TELEMETRY_VERSION = 1;
const HEADER_BYTES = 24;
const JOINT_BYTES = 12;

/**
 * Return a telemetry frame, or null for another version. Layout: `lss-motion schema remote`.
 * @param {ArrayBuffer} buffer @returns {import("./state.js").Telemetry | null}
 */
export function telemetryFrom(buffer) {
  const bytes = new DataView(buffer);
  if (buffer.byteLength < HEADER_BYTES || bytes.getUint8(0) !== TELEMETRY_VERSION) return null;
  const count = bytes.getUint16(2, true);
  if (buffer.byteLength < HEADER_BYTES + count * JOINT_BYTES) return null;
  let plan = "";
  for (let at = 4; at < 12; at += 1) plan += bytes.getUint8(at).toString(16).padStart(2, "0");
  const [planned_deg, predicted_deg, read_deg] = [0, 4, 8].map((offset) => {
    const deg = new Float32Array(count);
    for (let joint = 0; joint < count; joint += 1) {
      deg[joint] = bytes.getFloat32(HEADER_BYTES + joint * JOINT_BYTES + offset, true);
    }
    return deg;
  });
  return {
    plan,
    show_s: bytes.getFloat64(12, true),
    rate: bytes.getFloat32(20, true),
    planned_deg: /** @type {Float32Array} */ (planned_deg),
    predicted_deg: /** @type {Float32Array} */ (predicted_deg),
    read_deg: /** @type {Float32Array} */ (read_deg),
  };
}

/** Return what an edit would do, with its arrays unpacked. @param {any} json @returns {import("./state.js").Tried} */
export function triedFrom(json) {
  if (json.window === null) return json;
  const deg = Object.fromEntries(Object.entries(json.window.deg).map(([joint, own]) => [joint, floats32(/** @type {string} */ (own))]));
  return { ...json, window: { ...json.window, deg } };
}

/** Return a view with its arrays unpacked, and the keys of each joint.
 * @param {any} json @returns {import("./state.js").View} */
export function viewFrom(json) {
  const curves = Object.fromEntries(
    Object.entries(json.curves).map(([name, own]) => {
      const { plan, predicted, authored } = /** @type {any} */ (own);
      return [name, {
        plan: curveFrom(plan),
        predicted: curveFrom(predicted),
        authored: authored === null ? null : curveFrom(authored),
      }];
    }),
  );
  const lanes = json.lanes.map((/** @type {any} */ lane) => ({
    ...lane,
    times_s: Float64Array.from(lane.keys, (/** @type {any} */ key) => key.at_s),
  }));
  const line = Object.fromEntries(
    Object.entries(json.line).map(([bus, own]) => {
      const use = /** @type {any} */ (own);
      return [bus, { ...use, use_ratio: floats32(use.use_ratio) }];
    }),
  );
  const asked = json.asked.map((/** @type {any} */ span) => ({ ...span, deg: floats32(span.deg) }));
  const waveforms = json.waveforms.map((/** @type {any} */ form) => (
    form.peaks === undefined ? form : { ...form, peaks: bytes8(form.peaks) }));
  return { ...json, curves, lanes, line, asked, waveforms, keys: keysByJoint(lanes) };
}

/** @param {import("./state.js").Lane[]} lanes */
function keysByJoint(lanes) {
  /** @type {Record<string, import("./state.js").JointKey[]>} */
  const found = Object.create(null);  // A joint may be named "constructor".
  lanes.forEach((lane, lane_index) => {
    lane.keys.forEach((key, key_index) => {
      for (const [joint, deg] of Object.entries(key.deg)) {
        (found[joint] ??= []).push({
          at_s: key.at_s, deg, hold_s: key.hold_s, is_anchor: key.is_anchor,
          lane: lane_index, key: key_index, is_added: lane.is_added,
        });
      }
    });
  });
  for (const keys of Object.values(found)) keys.sort((one, other) => one.at_s - other.at_s);
  return found;
}
