// @ts-check
/**
 * Jogging with a dead-man: a joint turns only while a button or a key is held.
 *
 * The request is repeated while it is held, and the player stops a joint for which none comes. Every
 * way in which a hold can end without a release (the pointer leaves the page, the page loses focus or
 * is hidden, the button vanishes) ends it here at once, too.
 */

/** How often a request is repeated: well within the patience of the player (its dead-man). */
export const REPEAT_MS = 100;

/** Keys that hold a jog button which has the focus. */
const HOLD_KEYS = new Set([" ", "Enter"]);

/** @typedef {(joint: string, speed_ratio: number) => void} Request */

/** The one joint that turns now, and the repetition of its request. */
export class JogHold {
  /** @type {{joint: string, speed_ratio: number} | null} */
  #held = null;
  /** @type {number | undefined} */
  #timer = undefined;

  /** @param {Request} request @param {(joint: string | null) => void} changed called when another joint, or none, is held */
  constructor(request, changed) {
    this.request = request;
    this.changed = changed;
  }

  /** -1, 0 or 1: which way the held joint turns. */
  get sign() {
    return Math.sign(this.#held?.speed_ratio ?? 0);
  }

  /** The joint that is held; null: none. */
  get joint() {
    return this.#held?.joint ?? null;
  }

  /** @param {string} joint @param {number} speed_ratio -1 to 1 */
  start(joint, speed_ratio) {
    this.stop();
    this.#held = { joint, speed_ratio };
    this.request(joint, speed_ratio);
    this.#timer = window.setInterval(() => {
      if (this.#held !== null) this.request(this.#held.joint, this.#held.speed_ratio);
    }, REPEAT_MS);
    this.changed(joint);
  }

  /** End the hold; the joint brakes. */
  stop() {
    if (this.#held === null) return;
    window.clearInterval(this.#timer);
    const { joint } = this.#held;
    this.#held = null;
    this.request(joint, 0);
    this.changed(null);
  }

  /** End every hold when the page loses focus or is hidden; returns what takes that back. */
  watch() {
    const stop = () => this.stop();
    const hidden = () => {
      if (document.hidden) this.stop();
    };
    window.addEventListener("blur", stop);
    window.addEventListener("pagehide", stop);
    document.addEventListener("visibilitychange", hidden);
    return () => {
      this.stop();
      window.removeEventListener("blur", stop);
      window.removeEventListener("pagehide", stop);
      document.removeEventListener("visibilitychange", hidden);
    };
  }
}

/**
 * Return the handlers of a button that jogs while it is held, by pointer or by key.
 * @param {JogHold} hold @param {string} joint @param {() => number} speedRatio
 */
export function holdHandlers(hold, joint, speedRatio) {
  const end = () => {
    if (hold.joint === joint) hold.stop();
  };
  return {
    /** @param {PointerEvent} event */
    onPointerDown: (event) => {
      if (event.button !== 0) return;
      const button = /** @type {HTMLElement} */ (event.currentTarget);
      button.focus();
      button.setPointerCapture(event.pointerId);
      hold.start(joint, speedRatio());
    },
    onPointerUp: end,
    onPointerCancel: end,
    onLostPointerCapture: end,
    /** @param {KeyboardEvent} event */
    onKeyDown: (event) => {
      if (!HOLD_KEYS.has(event.key) || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      event.stopPropagation(); // Space plays a show elsewhere.
      if (!event.repeat) hold.start(joint, speedRatio());
    },
    /** @param {KeyboardEvent} event */
    onKeyUp: (event) => {
      if (!HOLD_KEYS.has(event.key)) return;
      event.preventDefault();
      event.stopPropagation();
      end();
    },
    onBlur: end,
    /** @param {Event} event */
    onContextMenu: (event) => event.preventDefault(), // A long touch is a hold here.
  };
}
