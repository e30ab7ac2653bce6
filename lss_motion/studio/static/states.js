// @ts-check
/**
 * The states that the pages show, each with one word, one colour and one sign: the same on every
 * page. `stateOf` says which it is, and `detail` what a person needs to know besides. Pure.
 */

import { withinView } from "./curves.js";

/** @typedef {import("./state.js").State} State */
/** @typedef {"good" | "warn" | "bad" | "busy" | "quiet"} Tone a colour of the theme, `--tone-…` */
/** @typedef {keyof typeof STATES} StateName */
/** @typedef {{ name: StateName, word: string, tone: Tone, sign: string, detail: string }} Shown */

export const STATES = /** @satisfies {Record<string, { word: string, tone: Tone, sign: string }>} */ ({
  no_link: { word: "no link", tone: "bad", sign: "✕" },
  player_gone: { word: "player gone", tone: "bad", sign: "✕" },
  planner_gone: { word: "planner gone", tone: "bad", sign: "✕" },
  emergency: { word: "emergency stop", tone: "bad", sign: "■" },
  fault: { word: "ended by a fault", tone: "bad", sign: "■" },
  stopping: { word: "stops", tone: "warn", sign: "■" },
  stopped: { word: "stopped", tone: "warn", sign: "■" },
  waits: { word: "waits", tone: "warn", sign: "◇" },
  recovering: { word: "recovers", tone: "warn", sign: "◇" },
  paused: { word: "paused", tone: "warn", sign: "‖" },
  playing: { word: "playing", tone: "good", sign: "▶" },
  preparing: { word: "prepares", tone: "busy", sign: "◆" },
  connected: { word: "connected", tone: "busy", sign: "◆" },
  rests: { word: "rests", tone: "quiet", sign: "○" },
  ended: { word: "ended", tone: "quiet", sign: "○" },
  at_rest: { word: "at rest", tone: "quiet", sign: "○" },
});

/** States in which a show moves on: what comes next can be said, and when. @type {ReadonlySet<string>} */
export const MOVING = new Set(["playing"]);

/** Whether what plays has a time to show and to seek in: a stage that rests, or waits for its cable, plays
 * nothing. @param {State} state */
export function hasTime({ stage }) {
  return stage === null || stage.show !== null && !["rests", "waits_for_port", "connecting", "given_up"].includes(stage.state);
}

/** Whether something plays that can be paused and sent to another instant. @param {State} state */
export function isUnderWay(state) {
  return (state.player.state === "playing" || state.player.state === "paused") && hasTime(state);
}

/**
 * Return the instant that is shown: show time and that of the view, of what is played, or was last; else
 * the cursor's. @param {State} state @param {import("./state.js").Telemetry | null} telemetry
 */
export function instantOf({ view, cursor_s, player }, telemetry) {
  const isOver = player.state === "idle" || telemetry === null;
  const end_s = view?.duration_s ?? Infinity;
  const show_s = isOver ? cursor_s : Math.min(Math.max(telemetry.show_s, 0), end_s);
  return { show_s, at_s: view === null ? 0 : withinView(view, show_s) };
}

/** What the player does before and between playing, by its phase. @type {Record<string, string>} */
const STEPS = {
  connecting: "checks the servos", preparing: "sets the servos up", approaching: "moves to the start",
  seeking: "moves to another place", restoring: "gives the settings back",
};

/** @param {State} state @returns {Shown} */
export function stateOf(state) {
  const [name, detail] = nameOf(state);
  return { name, ...STATES[name], detail };
}

/** @param {State} state @returns {[StateName, string]} */
function nameOf(state) {
  const { link, player, stage, document: own, robot_state } = state;
  if (link.status === "lost") return ["no_link", `${link.text}. What you see is old; the show goes on as it was started. STOP is still sent, by a way of its own`];
  if (player.state === "gone") return ["player_gone", player.text];
  if (player.latch !== null) return ofStop(player);
  if (stage !== null) return ofStage(state, stage);
  if (["starting", "ready", "playing", "paused", "stopping"].includes(player.state)) return ofShow(state);
  if (robot_state?.state === "connecting") return ["preparing", "asks the servos"];
  if (robot_state?.state === "live") return ["connected", robot_state.text || "no show plays"];
  if (own !== null && !own.has_planner) return ["planner_gone", "save the file to try again"];
  if (player.state === "ended") return ofEnd(state);
  return ["at_rest", ""];
}

/** @param {import("./state.js").Player} player @returns {[StateName, string]} */
function ofStop(player) {
  if (player.state === "stopping" && player.latch === "stop") return ["stopping", "brakes"];
  const why = ["", "stopped"].includes(player.text) ? "" : `${player.text}; `;
  return [player.latch === "estop" ? "emergency" : "stopped", `${why}nothing moves before it is armed again`];
}

/** @param {State} state @param {import("./state.js").Stage} stage @returns {[StateName, string]} */
function ofStage(state, stage) {
  switch (stage.state) {
    case "waits_for_port": return ["waits", "for the cable of the robot"];
    case "connecting": return ["preparing", "checks the servos"];
    case "rests": return ["rests", stage.reasons.join("; ")];
    case "given_up": return ["fault", stage.reasons.join("; ") || lastFault(state)];
    default: return ofShow(state);
  }
}

/** @param {State} state @returns {[StateName, string]} */
function ofShow({ player, phase, waiting, rate, stage }) {
  if (player.state === "ready") return ["waits", "for GO"];
  if (player.state === "paused") return ["paused", ""];
  if (phase === "recovering") return ["recovering", "waits for what is missing"];
  if (player.state === "stopping" && stage === null) return ["stopping", STEPS[phase] ?? "brakes"];
  if (waiting !== null) return ["waits", `for ${waiting}`];
  if (player.state === "starting") return ["preparing", STEPS[phase] ?? "starts"];
  const step = STEPS[phase];
  if (step !== undefined) return ["preparing", step];
  return ["playing", rate.ratio < 1 ? `at ${Math.round(100 * rate.ratio)} %` : ""];
}

/** @param {State} state @returns {[StateName, string]} */
function ofEnd(state) {
  const { ended, player } = state;
  const outcome = ended?.outcome ?? player.text;
  if (outcome === "finished") return ["ended", "to its end"];
  if (outcome === "stopped") return ["stopped", "at the operator's wish"];
  return ["fault", ended?.error || lastFault(state) || player.text];
}

/** Which joint, which words, and what was done. @param {State} state */
function lastFault(state) {
  const found = state.trouble.find((one) => one.kind === "fault");
  return found === undefined ? "" : `${found.text.replace(/\.$/, "")}: ${found.done}`;
}
