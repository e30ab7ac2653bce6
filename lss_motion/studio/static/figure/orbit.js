// @ts-check
/** Turns and enlarges a figure by pointer, wheel and two fingers: the same in 2D and 3D. */

import { VIEWS, dragged, zoomed } from "./camera.js";

/** Pixels of a wheel that two fingers do by the same change of their distance. */
const WHEEL_PX_PER_PINCH_PX = 3;

/** From where a figure is seen now. */
export class Orbit {
  direction = VIEWS.Perspective;
  zoom = 1;
  #listening = new AbortController();
  /** @type {Map<number, {x: number, y: number}>} */
  #pointers = new Map();

  /** @param {HTMLElement} element @param {() => void} changed */
  constructor(element, changed) {
    const { signal } = this.#listening;
    element.addEventListener("pointerdown", (event) => this.#down(element, event), { signal });
    element.addEventListener(
      "pointermove",
      (event) => {
        if (this.#move(event)) changed();
      },
      { signal },
    );
    for (const end of /** @type {const} */ (["pointerup", "pointercancel", "lostpointercapture"])) {
      element.addEventListener(end, (event) => this.#pointers.delete(event.pointerId), { signal });
    }
    element.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoom = zoomed(this.zoom, event.deltaY);
        changed();
      },
      { signal, passive: false },
    );
  }

  /** @param {string} name one of `VIEWS` */
  setView(name) {
    this.direction = VIEWS[name];
    this.zoom = 1;
  }

  dispose() {
    this.#listening.abort();
  }

  /** @param {HTMLElement} element @param {PointerEvent} event */
  #down(element, event) {
    element.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const from = this.#pointers.get(event.pointerId);
    if (from === undefined) return false;
    const other = [...this.#pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other === undefined) {
      this.direction = dragged(this.direction, event.clientX - from.x, event.clientY - from.y);
    } else {
      const before_px = Math.hypot(from.x - other.x, from.y - other.y);
      const now_px = Math.hypot(event.clientX - other.x, event.clientY - other.y);
      this.zoom = zoomed(this.zoom, WHEEL_PX_PER_PINCH_PX * (before_px - now_px));
    }
    this.#pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    return true;
  }
}
