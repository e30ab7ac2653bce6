// @ts-check
/** The state of the pages as a pure function: `reduce(state, action)`. */

import { placesOf, refound } from "./timeline/keys.js";

/** @typedef {import("./state.js").State} State */
/** @typedef {import("./state.js").Action} Action */
/** @typedef {import("./state.js").Trouble} Trouble */

const TROUBLE_MAX = 100;
const NOTES_MAX = 50;

/** What the player does about a fault, in words. @type {Record<string, string>} */
export const STEP_WORDS = {
  warn: "the show goes on",
  slow: "the show is slowed until it has caught up",
  resume: "the robot stands until it answers again, then goes on",
  hold: "the show is ended, the servos hold",
  limp: "this joint is limp, the show is ended",
};

/** @returns {State} */
export function firstState() {
  return {
    link: { status: "connecting", text: "" },
    welcome: null,
    clients: 0,
    lease: { holder: null, holder_name: null, is_mine: false },
    document: null,
    player: { state: "idle", latch: null, plan: null, show_s: null, text: "" },
    robot_state: null,
    robot: null,
    view: null,
    phase: "",
    started: null,
    ended: null,
    rate: { ratio: 1, is_paused: false },
    health: null,
    trouble: [],
    stage: null,
    notes: [],
    last_mark: null,
    waiting: null,
    scanned: null,
    maintenance: null,
    pairing: null,
    model: null,
    folder: null,
    touring: false,
    proposed: null,
    side: "chosen",
    page: "show",
    theatre: false,
    theme: "dark",
    cursor_s: 0,
    order: 0,
    follow: true,
    selection: null,
    wanted: null,
    drafts: 0,
    is_dragging: false,
    ripple: false,
    ghosts: { authored: true, plan: true, predicted: false, reading: true },
    live: false,
    posed: null,
    menu: null,
    row: 0,
    dialog: null,
    refusal: null,
  };
}

/** Return the state after an action. @param {State} state @param {Action} action @returns {State} */
export function reduce(state, action) {
  if (action.type === "event") return afterEvent(state, /** @type {any} */ (action)["event"]);
  if (action.type === "set") {
    const fields = /** @type {Partial<State>} */ (action["fields"]);
    // What is chosen on the timeline is what a person wants to see beside it.
    const side = fields.selection == null ? {} : { side: /** @type {const} */ ("chosen") };
    return { ...state, ...(fields.selection === undefined ? {} : { wanted: null }), ...side, ...fields };
  }
  if (action.type === "drafted") {
    return { ...state, drafts: state.drafts + 1, wanted: /** @type {State["wanted"]} */ (action["wanted"]) };
  }
  if (action.type === "refused") {
    const number = (state.refusal?.number ?? 0) + 1;
    return { ...state, refusal: { number, text: String(action["text"]), is_hint: action["is_hint"] === true } };
  }
  if (action.type === "cursor") {
    const end_s = state.view?.view_s ?? 0;
    const at_s = Number(action["at_s"]);
    return { ...state, cursor_s: Math.min(Math.max(at_s, 0), end_s) };
  }
  if (action.type === "waited_on_planner") return afterSilence(state, Number(action["planning_s"]));
  if (action.type === "view") return afterView(state, /** @type {any} */ (action)["view"]);
  throw new Error(`no action ${action.type}`);
}

/** The planner has not answered for so long. @param {State} state @param {number} planning_s @returns {State} */
function afterSilence(state, planning_s) {
  const own = state.document;
  return own === null || !own.is_planning ? state : { ...state, document: { ...own, planning_s } };
}

/** @param {State} state @param {import("./state.js").View} view @returns {State} */
function afterView(state, view) {
  const isOther = state.view === null || state.view.name !== view.name;
  const cursor_s = isOther ? 0 : Math.min(state.cursor_s, view.view_s);
  const { selection, wanted } = state;
  const places = wanted ?? (selection?.kind === "keys" && state.view !== null ? placesOf(state.view, selection.keys) : []);
  const keys = isOther ? [] : refound(view, places);
  return {
    ...state, view, cursor_s, menu: null, selection: keys.length === 0 ? null : { kind: "keys", keys },
    row: isOther ? 0 : state.row,
  };
}

/**
 * Return the state after an event of the server. @param {State} state @param {any} event
 * @returns {State}
 */
function afterEvent(state, event) {
  switch (event.event) {
    case "welcome":
      return { ...state, welcome: event, link: { status: "open", text: "" } };
    case "lease":
      return afterLease(state, event);
    case "document":
      return { ...state, document: event, page: isNewRobot(state, event) ? "robot" : state.page };
    case "robot":
      return { ...state, robot_state: event };
    case "player":
      return {
        ...state, player: event, stage: isOver(event.state) ? null : state.stage, phase: event.state === "idle" ? "" : state.phase,
      };
    case "links":
      return { ...state, clients: event.clients };
    case "scan":
    case "scanned":
      return { ...state, scanned: event };
    case "maintenance":
      return { ...state, maintenance: event };
    case "pairing":
      return { ...state, pairing: event, dialog: { kind: "pairing" } };
    case "started":
      return {
        ...state, started: event, ended: null, trouble: [], health: null, last_mark: null,
        waiting: null, phase: "", rate: { ratio: 1, is_paused: false },
      };
    case "stage":
      return { ...state, stage: event };
    case "stage_note":
      return { ...state, notes: withNote(state, event) };
    case "phase":
      return { ...state, phase: event.phase };
    case "rate":
      return { ...state, rate: { ratio: event.ratio, is_paused: event.is_paused } };
    case "mark":
      return { ...state, last_mark: { label: event.label, at_s: event.at_s } };
    case "waited":
      return { ...state, waiting: event.state === "begun" ? event.text : null };
    case "health":
      // "live": of a robot that plays no show.
      return { ...state, health: event, phase: event.phase === "live" ? state.phase : event.phase };
    case "ended":
      return { ...state, ended: { outcome: event.outcome, error: event.error }, phase: "", waiting: null };
    default:
      return { ...state, trouble: withTrouble(state, event) };
  }
}

/** Whether the process that plays has ended. @param {string} word */
function isOver(word) {
  return ["idle", "ended", "gone"].includes(word);
}

/** @param {State} state @param {any} event */
function withNote(state, event) {
  const number = (state.notes[0]?.number ?? 0) + 1;
  return [{ number, kind: event.kind, text: event.text }, ...state.notes].slice(0, NOTES_MAX);
}

/** Whether the file is a robot's, which has no show: its page is the one to open.
 * @param {State} state @param {any} event */
function isNewRobot(state, event) {
  return event.kind === "robot" && state.document?.kind !== "robot";
}

/** Who loses the lease to another is told; what was refused for want of it is over with it.
 * @param {State} state @param {any} event @returns {State} */
function afterLease(state, event) {
  const isTaken = state.lease.is_mine && !event.is_mine && event.holder !== null;
  const next = { ...state, lease: event, refusal: event.is_mine ? null : state.refusal };
  return isTaken ? reduce(next, { type: "refused", text: `${event.holder_name} has taken over` }) : next;
}

/** Return the list of troubles with that of an event. @param {State} state @param {any} event */
function withTrouble(state, event) {
  // On the way to the start it is at no time of the show.
  const show_s = state.health?.show_s ?? -1;
  const at_s = show_s < 0 ? null : show_s;
  const number = (state.trouble[0]?.number ?? 0) + 1;
  /** @type {Trouble[]} */
  let added = [];
  if (event.event === "fault") {
    const who = event.joint === "" ? "" : `${event.joint} `;
    added = [{ number, kind: "fault", joint: event.joint, at_s, text: `${who}${event.cause}`, done: STEP_WORDS[event.step] ?? event.step }];
  } else if (event.event === "warned") {
    added = [{ number, kind: "warning", at_s, text: event.text, done: "" }];
  } else if (event.event === "checked") {
    added = event.notes.map((/** @type {string} */ text, /** @type {number} */ index) => (
      { number: number + index, kind: "note", at_s: null, text, done: "" }));
    added.reverse();
  } else if (event.event === "lost") {
    added = [{ number, kind: "warning", at_s, text: `${event.count} messages found no room`, done: "" }];
  }
  return added.length === 0 ? state.trouble : [...added, ...state.trouble].slice(0, TROUBLE_MAX);
}
