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

/** Keys that turn a joint whose slider has the focus, while they are held. @type {Record<string, number>} */
const TURN_KEYS = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 };

/** @typedef {{ speed_ratio: number, to_deg?: number }} Wish where to: by the sign, or to an angle */
/** @typedef {(joint: string, wish: Wish) => void} Request */

/** The one joint that turns now, and the repetition of its request. */
export class JogHold {
  /** @type {(Wish & {joint: string}) | null} */
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

  /** @param {string} joint @param {number} speed_ratio -1 to 1 @param {number} [to_deg] not beyond this angle */
  start(joint, speed_ratio, to_deg) {
    this.stop();
    this.#held = to_deg === undefined ? { joint, speed_ratio } : { joint, speed_ratio, to_deg };
    this.#repeat();
    this.#timer = window.setInterval(() => this.#repeat(), REPEAT_MS);
    this.changed(joint);
  }

  /** Turn the held joint to another angle. @param {number} to_deg */
  aim(to_deg) {
    if (this.#held !== null) this.#held.to_deg = to_deg;
  }

  #repeat() {
    if (this.#held === null) return;
    const { joint, ...wish } = this.#held;
    this.request(joint, wish);
  }

  /** End the hold; the joint brakes. */
  stop() {
    if (this.#held === null) return;
    window.clearInterval(this.#timer);
    const { joint } = this.#held;
    this.#held = null;
    this.request(joint, { speed_ratio: 0 });
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

/**
 * Return the handlers of a slider: the joint follows the pointer while that is pressed, at the speed
 * that is chosen, and stops where it is when the pointer lets go.
 * @param {JogHold} hold @param {string} joint @param {number[]} range_deg @param {() => number} speedRatio above 0
 */
export function dragHandlers(hold, joint, range_deg, speedRatio) {
  const [low, high] = range_deg;
  /** @param {PointerEvent} event */
  const degAt = (event) => {
    const box = /** @type {HTMLElement} */ (event.currentTarget).getBoundingClientRect();
    const share = Math.min(Math.max((event.clientX - box.left) / Math.max(box.width, 1), 0), 1);
    return Math.round(10 * (low + share * (high - low))) / 10;
  };
  const end = () => {
    if (hold.joint === joint) hold.stop();
  };
  return {
    /** @param {PointerEvent} event */
    onPointerDown: (event) => {
      if (event.button !== 0) return;
      const slider = /** @type {HTMLElement} */ (event.currentTarget);
      slider.focus();
      slider.setPointerCapture(event.pointerId);
      hold.start(joint, speedRatio(), degAt(event));
    },
    /** @param {PointerEvent} event */
    onPointerMove: (event) => {
      if (hold.joint === joint && event.buttons !== 0) hold.aim(degAt(event));
    },
    onPointerUp: end,
    onPointerCancel: end,
    onLostPointerCapture: end,
    /** @param {KeyboardEvent} event */
    onKeyDown: (event) => {
      const sign = TURN_KEYS[event.key];
      if (sign === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      event.stopPropagation();
      if (!event.repeat) hold.start(joint, sign * speedRatio());
    },
    /** @param {KeyboardEvent} event */
    onKeyUp: (event) => {
      if (event.key in TURN_KEYS) end();
    },
    onBlur: end,
    /** @param {Event} event */
    onContextMenu: (event) => event.preventDefault(),
  };
}
