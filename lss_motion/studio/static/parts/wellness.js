// @ts-check
/** How the joints do, by exception: one line while all is well, a row for each joint that is not. */

import { html } from "../vendor/preact.js";
import { number } from "../numbers.js";

/** @typedef {import("../state.js").State} State */
/** @typedef {import("../state.js").JointView} JointView */
/** @typedef {import("../state.js").JointHealth} JointHealth */

/** Share of what is allowed from which a value is a warning. */
const NEAR_RATIO = 0.8;
/** This far below the limit of temperature, or above that of voltage, is a warning. */
const NEAR_C = 8;
const NEAR_V = 0.3;

/**
 * Return what is wrong with a joint, or nearly, in words. `isBad`: more than nearly.
 * @param {JointView} joint @param {JointHealth} own @returns {{ text: string, isBad: boolean }[]}
 */
export function exceptionsOf(joint, own) {
  const found = [];
  const ratio = own.error_deg === null ? 0 : Math.abs(own.error_deg) / own.allowed_deg;
  if (ratio > NEAR_RATIO) found.push({ text: `${number(Math.abs(own.error_deg ?? 0), 1)}° off its plan, allowed ${number(own.allowed_deg, 1)}°`, isBad: ratio > 1 });
  const hot_c = joint.temperature_max_c;
  if (own.temperature_c !== null && own.temperature_c > hot_c - NEAR_C) {
    found.push({ text: `${number(own.temperature_c, 0)} °C, at most ${hot_c} °C`, isBad: own.temperature_c > hot_c });
  }
  const low_v = joint.voltage_min_v;
  if (own.voltage_v !== null && own.voltage_v < low_v + NEAR_V) {
    found.push({ text: `${number(own.voltage_v, 1)} V, at least ${low_v} V`, isBad: own.voltage_v < low_v });
  }
  if (own.status !== null && /stuck|blocked|safe|error/i.test(own.status)) found.push({ text: own.status.replaceAll("_", " "), isBad: true });
  return found;
}

/** @param {{ state: State }} props */
export function Wellness({ state }) {
  const { view, health } = state;
  if (view === null) return null;
  const rows = view.joints.flatMap((joint) => {
    const own = health?.joints[joint.name];
    const found = own === undefined ? [] : exceptionsOf(joint, own);
    return found.length === 0 ? [] : [{ joint, found }];
  });
  return html`<h2>Joints</h2><div class="joints"><p class="well">${summary(state, rows.length)}</p>
    ${rows.length === 0 ? null : html`<ul class="exceptions">${rows.map(({ joint, found }) => html`<li key=${joint.name}>
      <span class="exception-joint"><strong>${joint.name}</strong><small>${joint.servo} · id ${joint.id}</small></span>
      ${found.map((one) => html`<span class=${one.isBad ? "bad" : "warn"}>${one.isBad ? "■" : "▲"} ${one.text}</span>`)}</li>`)}</ul>`}</div>`;
}

/** @param {State} state @param {number} exceptions */
function summary({ view, health, trouble }, exceptions) {
  const count = view?.joints.length ?? 0;
  const joints = count === 1 ? "1 joint" : `${count} joints`;
  if (health === null) {
    const planned = Object.entries(view?.line ?? {}).map(([bus, use]) => `line ${bus} ${Math.round(100 * use.mean_ratio)} %`);
    return `${joints}, nothing is read yet${planned.length > 0 ? `; planned use of the ${planned.join(", ")}` : ""}`;
  }
  const own = Object.values(health.joints);
  const hottest_c = Math.max(...own.map((one) => one.temperature_c ?? -Infinity));
  const lowest_v = Math.min(...own.map((one) => one.voltage_v ?? Infinity));
  const parts = [
    exceptions === 0 && trouble.some((one) => one.kind === "fault") ? joints : exceptions === 0 ? `${joints}, all well` : exceptions === count ? "every joint needs a look" : `${exceptions} of ${joints} need a look`,
    Number.isFinite(hottest_c) ? `hottest ${number(hottest_c, 0)} °C` : "",
    Number.isFinite(lowest_v) ? `lowest ${number(lowest_v, 1)} V` : "",
    ...Object.entries(health.buses).map(([bus, use]) => `line ${bus} ${Math.round(100 * use.use_ratio)} %`),
    health.missed > 0 ? `${health.missed === 1 ? "1 move" : `${health.missed} moves`} late, by up to ${number(health.late_us / 1000, 1)} ms` : "",
  ];
  return parts.filter((part) => part !== "").join(" · ");
}
