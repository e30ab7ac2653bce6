// @ts-check
/**
 * What pointers do on the timeline, as a pure function: `afterInput(gesture, input)` returns the
 * gesture that goes on and what is to be done. A key that is pressed is dragged, what is empty is
 * a box by mouse and a pan by finger, two fingers zoom, a long touch is the menu. Keys that a key of
 * the keyboard has taken (`isLoose`) follow the pointer, or the arrow keys, until a click or Enter.
 */

/** @typedef {import("./hit.js").Hit} Hit */
/** @typedef {{ id: number, x_px: number, y_px: number }} Finger */
/** @typedef {{ kind: "event", event: number, at_s: number }} EventHit */
/** @typedef {{ kind: "key", lane: number, key: number, joint: string | null, at_s: number }} KeyHit */
/** @typedef {Extract<Hit, { kind: "handle" }>} HandleHit */
/**
 * @typedef {{ kind: "rest" }
 *   | { kind: "cursor", at: Finger }
 *   | { kind: "pan", at: Finger, from: Finger, isMoved: boolean, hit: Hit | null }
 *   | { kind: "pinch", at: Finger, other: Finger }
 *   | { kind: "press", at: Finger, from: Finger, hit: KeyHit, isAdded: boolean }
 *   | Dragged
 *   | { kind: "slope", at: Finger, from: Finger, hit: HandleHit, isFine: boolean }
 *   | { kind: "armed" }
 *   | { kind: "event", at: Finger, from: Finger, hit: EventHit, isMoved: boolean, isFine: boolean, snaps: boolean }
 *   | { kind: "box", at: Finger, from: Finger, isMoved: boolean, isAdded: boolean, hit: Hit | null }} Gesture
 */
/** @typedef {"free" | "time" | "angle"} Axis */
/** @typedef {"move" | "scale" | "copy"} Mode */
/** @typedef {{ by_s: number, by_deg: number }} Steps those of the arrow keys */
/**
 * @typedef {{ kind: "keys", at: Finger, from: Finger, hit: KeyHit, axis: Axis, isFine: boolean, snaps: boolean,
 *   mode: Mode, isLoose: boolean, steps: Steps }} Dragged
 */
/**
 * @typedef {{ kind: "down", finger: Finger, hit: Hit | null, isTouch: boolean, isMiddle: boolean, isAdded: boolean, isChosen: boolean }
 *   | { kind: "move", finger: Finger, isFine: boolean, snaps: boolean }
 *   | { kind: "up", finger: Finger }
 *   | { kind: "held" }
 *   | { kind: "axis", axis: "time" | "angle" }
 *   | { kind: "grab", mode: Mode, at: Finger, hit: KeyHit }
 *   | { kind: "steps", by: Steps }
 *   | { kind: "take" }
 *   | { kind: "arm" }
 *   | { kind: "drop" }} Input
 */
/**
 * @typedef {{ act: "cursor", x_px: number }
 *   | { act: "pan", by_px: number, down_px: number }
 *   | { act: "zoom", factor: number, x_px: number }
 *   | { act: "choose", hit: Hit | null, isAdded: boolean }
 *   | { act: "toggle", hit: KeyHit }
 *   | { act: "box", from: Finger, to: Finger, isAdded: boolean }
 *   | { act: "menu", at: Finger, hit: Hit | null }
 *   | { act: "draft" } | { act: "undraft" }
 *   | { act: "commit", gesture: Gesture }} Act
 */

export const DRAG_PX = 4;
/** A finger that stays there for so long asks for the menu. */
export const HELD_MS = 500;
/** Two fingers closer together than this zoom no faster. */
const APART_MIN_PX = 20;
/** A key that is dragged along one axis stays on it until it has left it by so much. */
export const STICKY_PX = 8;

/** @type {Steps} */
const NO_STEPS = { by_s: 0, by_deg: 0 };
/** @type {Gesture} */
export const REST = { kind: "rest" };

/** @param {Gesture} gesture @param {Input} input @returns {[Gesture, Act[]]} */
export function afterInput(gesture, input) {
  switch (input.kind) {
    case "down": return afterDown(gesture, input);
    case "move": return afterMove(gesture, input);
    case "up": return afterUp(gesture, input.finger);
    case "held": return afterHeld(gesture);
    case "axis":
      if (gesture.kind !== "keys") return [gesture, []];
      return [{ ...gesture, axis: gesture.axis === input.axis ? "free" : input.axis }, [{ act: "draft" }]];
    case "grab":
      if (gesture.kind !== "rest" && gesture.kind !== "armed") return [gesture, []];
      return [{ kind: "keys", at: input.at, from: input.at, hit: input.hit, axis: "free", isFine: false, snaps: false,
        mode: input.mode, isLoose: true, steps: NO_STEPS }, [{ act: "draft" }]];
    case "steps": {
      if (gesture.kind !== "keys") return [gesture, []];
      const { by_s, by_deg } = gesture.steps;
      return [{ ...gesture, steps: { by_s: by_s + input.by.by_s, by_deg: by_deg + input.by.by_deg } }, [{ act: "draft" }]];
    }
    case "take":
      return gesture.kind === "keys" && gesture.isLoose ? taken(gesture) : [gesture, []];
    case "arm":
      return [gesture.kind === "rest" ? { kind: "armed" } : gesture, []];
    default:
      return [REST, ["keys", "event", "slope", "box", "armed"].includes(gesture.kind) ? [{ act: "undraft" }] : []];
  }
}

/** @param {Dragged} gesture @returns {[Gesture, Act[]]} */
function taken(gesture) {
  return [REST, [{ act: "commit", gesture }, { act: "undraft" }]];
}

/** @param {Gesture} gesture @param {Extract<Input, { kind: "down" }>} input @returns {[Gesture, Act[]]} */
function afterDown(gesture, { finger, hit, isTouch, isMiddle, isAdded, isChosen }) {
  if (gesture.kind === "armed") return [{ kind: "box", at: finger, from: finger, isMoved: false, isAdded, hit }, []];
  if (gesture.kind === "keys" && gesture.isLoose) {
    // A finger has to come down before it can drag.
    return isTouch ? [{ ...gesture, at: finger, from: finger, isLoose: false }, []] : taken(gesture);
  }
  if (gesture.kind !== "rest") {
    if (!isTouch || gesture.at.id === finger.id) return [gesture, []];
    /** @type {Act[]} */
    const acts = gesture.kind === "keys" ? [{ act: "undraft" }] : [];
    return [{ kind: "pinch", at: gesture.at, other: finger }, acts];
  }
  if (isMiddle) return [{ kind: "pan", at: finger, from: finger, isMoved: false, hit: null }, []];
  if (hit?.kind === "ruler") return [{ kind: "cursor", at: finger }, [{ act: "cursor", x_px: finger.x_px }]];
  if (hit?.kind === "event") return [{ kind: "event", at: finger, from: finger, hit, isMoved: false, isFine: false, snaps: false }, []];
  if (hit?.kind === "handle") return [{ kind: "slope", at: finger, from: finger, hit, isFine: false }, []];
  if (hit?.kind === "key") {
    return [{ kind: "press", at: finger, from: finger, hit, isAdded },
      isChosen || isAdded ? [] : [{ act: "choose", hit, isAdded: false }]];
  }
  if (isTouch) return [{ kind: "pan", at: finger, from: finger, isMoved: false, hit }, []];
  return [{ kind: "box", at: finger, from: finger, isMoved: false, isAdded, hit }, []];
}

/** @param {Finger} one @param {Finger} other */
function away(one, other) {
  return Math.hypot(one.x_px - other.x_px, one.y_px - other.y_px);
}

/** @param {Gesture} gesture @param {Extract<Input, { kind: "move" }>} input @returns {[Gesture, Act[]]} */
function afterMove(gesture, { finger, isFine, snaps }) {
  if (gesture.kind === "rest" || gesture.kind === "armed") return [gesture, []];
  if (gesture.kind === "pinch") return afterPinch(gesture, finger);
  if (gesture.kind === "keys" && gesture.isLoose) return [{ ...gesture, at: finger, isFine, snaps }, [{ act: "draft" }]];
  if (gesture.at.id !== finger.id) return [gesture, []];
  switch (gesture.kind) {
    case "cursor":
      return [{ ...gesture, at: finger }, [{ act: "cursor", x_px: finger.x_px }]];
    case "pan": {
      if (!gesture.isMoved && away(gesture.from, finger) < DRAG_PX) return [gesture, []];
      const by_px = gesture.at.x_px - finger.x_px;
      return [{ ...gesture, at: finger, isMoved: true }, [{ act: "pan", by_px, down_px: gesture.at.y_px - finger.y_px }]];
    }
    case "press": {
      if (away(gesture.from, finger) < DRAG_PX) return [gesture, []];
      const { from, hit, isAdded } = gesture;
      return [{ kind: "keys", at: finger, from, hit, axis: "free", isFine, snaps, mode: "move", isLoose: false, steps: NO_STEPS },
        [...(isAdded ? [/** @type {Act} */ ({ act: "choose", hit, isAdded: true })] : []), { act: "draft" }]];
    }
    case "event":
      if (!gesture.isMoved && away(gesture.from, finger) < DRAG_PX) return [gesture, []];
      return [{ ...gesture, at: finger, isMoved: true, isFine, snaps }, [{ act: "draft" }]];
    case "keys":
      return [{ ...gesture, at: finger, isFine, snaps }, [{ act: "draft" }]];
    case "slope":
      return [{ ...gesture, at: finger, isFine }, [{ act: "draft" }]];
    default:
      if (!gesture.isMoved && away(gesture.from, finger) < DRAG_PX) return [gesture, []];
      return [{ ...gesture, at: finger, isMoved: true }, [{ act: "draft" }]];
  }
}

/** @param {Extract<Gesture, { kind: "pinch" }>} gesture @param {Finger} finger @returns {[Gesture, Act[]]} */
function afterPinch(gesture, finger) {
  const isFirst = gesture.at.id === finger.id;
  if (!isFirst && gesture.other.id !== finger.id) return [gesture, []];
  const [moved, still] = isFirst ? [gesture.at, gesture.other] : [gesture.other, gesture.at];
  const before_px = Math.max(Math.abs(moved.x_px - still.x_px), APART_MIN_PX);
  const after_px = Math.max(Math.abs(finger.x_px - still.x_px), APART_MIN_PX);
  const next = isFirst ? { ...gesture, at: finger } : { ...gesture, other: finger };
  return [next, [{ act: "zoom", factor: after_px / before_px, x_px: still.x_px }]];
}

/** @param {Gesture} gesture @param {Finger} finger @returns {[Gesture, Act[]]} */
function afterUp(gesture, finger) {
  if (gesture.kind === "rest" || gesture.kind === "armed" || gesture.kind === "keys" && gesture.isLoose) return [gesture, []];
  if (gesture.kind === "pinch") {
    const left = gesture.at.id === finger.id ? gesture.other : gesture.at;
    return [{ kind: "pan", at: left, from: left, isMoved: true, hit: null }, []];
  }
  if (gesture.at.id !== finger.id) return [gesture, []];
  switch (gesture.kind) {
    case "press":
      return [REST, [gesture.isAdded ? { act: "toggle", hit: gesture.hit } : { act: "choose", hit: gesture.hit, isAdded: false }]];
    case "event":
      if (!gesture.isMoved) return [REST, [{ act: "choose", hit: gesture.hit, isAdded: false }]];
      return [REST, [{ act: "commit", gesture }, { act: "undraft" }]];
    case "keys":
      return taken(gesture);
    case "slope":
      return [REST, away(gesture.from, finger) < DRAG_PX ? [{ act: "undraft" }] : [{ act: "commit", gesture }, { act: "undraft" }]];
    case "box": {
      const { from, at, isAdded, isMoved, hit } = gesture;
      if (isMoved) return [REST, [{ act: "box", from, to: at, isAdded }, { act: "undraft" }]];
      return [REST, [{ act: "choose", hit, isAdded }]];
    }
    case "pan":
      return [REST, gesture.isMoved || gesture.hit === null ? [] : [{ act: "choose", hit: gesture.hit, isAdded: false }]];
    default:
      return [REST, []];
  }
}

/** @param {Gesture} gesture @returns {[Gesture, Act[]]} */
function afterHeld(gesture) {
  if (gesture.kind === "event" && !gesture.isMoved) return [REST, [{ act: "menu", at: gesture.at, hit: gesture.hit }]];
  if (gesture.kind === "press") return [REST, [{ act: "menu", at: gesture.at, hit: gesture.hit }]];
  if (gesture.kind === "pan" && !gesture.isMoved) return [REST, [{ act: "menu", at: gesture.at, hit: gesture.hit }]];
  return [gesture, []];
}

/** Return by how many pixels dragged keys are away: along one axis as long as it is little off it.
 * @param {Dragged} gesture @returns {{ by_px: number, up_px: number }} */
export function draggedBy({ at, from, axis }) {
  const by_px = at.x_px - from.x_px;
  const up_px = from.y_px - at.y_px;
  if (axis === "time") return { by_px, up_px: 0 };
  if (axis === "angle") return { by_px: 0, up_px };
  return { by_px: unstuck(by_px, up_px), up_px: unstuck(up_px, by_px) };
}

/** @param {number} own_px @param {number} other_px */
function unstuck(own_px, other_px) {
  return Math.abs(own_px) < STICKY_PX && Math.abs(other_px) > Math.abs(own_px) ? 0 : own_px;
}
