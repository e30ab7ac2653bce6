// @ts-check
/**
 * The one store: the state as a signal that only `dispatch` writes, and beside it what comes many
 * times a second (`telemetry`, `readings`), which is drawn and never rendered.
 */

import { computed, signal } from "./vendor/preact.js";
import { requestFrame } from "./frames.js";
import { Deviations, ReadingTrace } from "./readings.js";
import { firstState, reduce } from "./reduce.js";

/** @typedef {import("./state.js").State} State */
/** @typedef {import("./state.js").Action} Action */

/** @returns the store of a page */
export function createStore() {
  const state = signal(firstState());
  const telemetry = signal(/** @type {import("./state.js").Telemetry | null} */ (null));
  /** What the edit that was tried last would do. */
  const tried = signal(/** @type {import("./state.js").Tried | null} */ (null));
  /** @param {Action} action */
  const dispatch = (action) => {
    const next = reduce(state.value, action);
    if (next === state.value) return;
    state.value = next;
    requestFrame();
  };
  /**
   * Return a signal of a part of the state; it changes only when that part does.
   * @template T @param {(state: State) => T} part
   */
  const select = (part) => computed(() => part(state.value));
  return { state, telemetry, tried, readings: new ReadingTrace(), deviations: new Deviations(), dispatch, select };
}

/** @typedef {ReturnType<typeof createStore>} Store */
