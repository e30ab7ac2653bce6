// @ts-check
/**
 * Puppeteering: joints follow the pointer on a pad, a gamepad or MIDI, through the limiter of the player.
 *
 * Targets are sent while a source is held: the pointer is pressed, or a button of the gamepad. Nothing
 * else has to end a motion: without targets for 200 ms the player brakes and holds.
 */

import { html, useEffect, useRef, useState } from "../vendor/preact.js";
import { Pick } from "../parts/pick.js";

/** How often targets are sent while a source is held. */
export const SEND_MS = 33;
/** MIDI has no button that is held: after its last message it counts as held for so long. */
const MIDI_MS = 1000;
const NONE = "–";

/** @typedef {{ name: string, range_deg: [number, number] }} Joint */
/** @typedef {{ x: number, y: number }} Place from 0 to 1, y upwards */

/**
 * The angles for places of axes from 0 to 1; an axis without a joint leads none.
 * @param {Joint[]} joints @param {string[]} names of the joint of each axis @param {(number | undefined)[]} places
 */
export function targetsOf(joints, names, places) {
  return Object.fromEntries(names.flatMap((name, axis) => {
    const place = places[axis];
    const own = joints.find((one) => one.name === name);
    if (own === undefined || place === undefined) return [];
    const [least, most] = own.range_deg;
    return [[name, Number((least + Math.min(Math.max(place, 0), 1) * (most - least)).toFixed(2))]];
  }));
}

/** The axes of the first gamepad on which a button is held, as places; null: none is. @param {readonly (Gamepad | null)[]} pads */
export function heldAxes(pads) {
  const pad = pads.find((one) => one?.buttons.some((button) => button.pressed));
  return pad == null ? null : pad.axes.map((value, axis) => (axis % 2 === 1 ? 0.5 - value / 2 : 0.5 + value / 2));
}

/** Whether the robot is connected, and each joint was read. @param {import("../state.js").State} state */
function isRead({ robot_state }) {
  const all = Object.values(robot_state?.joints ?? {});
  return robot_state?.state === "live" && all.length > 0 && all.every((one) => one.deg !== null);
}

/** @param {{ state: import("../state.js").State, actions: import("../actions.js").Actions }} props */
export function Puppet({ state, actions }) {
  const robot = /** @type {any} */ (state.robot);
  const joints = /** @type {Joint[]} */ (robot?.joints ?? []);
  const [names, setNames] = useState(() => [0, 1, 2, 3].map((axis) => joints[axis]?.name ?? NONE));
  const [place, setPlace] = useState(/** @type {Place} */ ({ x: 0.5, y: 0.5 }));
  const isLed = state.started?.name === "live" && ["starting", "ready", "playing"].includes(state.player.state);
  const sources = useRef({ pointer: /** @type {Place | null} */ (null), midi: /** @type {number[]} */ ([]), midi_ms: -Infinity });
  const latest = useRef({ names, joints });
  latest.current = { names, joints };
  useEffect(() => {
    if (!isLed) return undefined;
    const send = () => {
      if (document.hidden || !document.hasFocus() && sources.current.pointer === null) return;
      const { pointer, midi, midi_ms } = sources.current;
      const axes = pointer !== null ? [pointer.x, pointer.y] : heldAxes(navigator.getGamepads?.() ?? [])
        ?? (performance.now() - midi_ms < MIDI_MS ? midi : null);
      if (axes === null) return;
      const deg = targetsOf(latest.current.joints, latest.current.names, axes);
      if (Object.keys(deg).length > 0) actions.link.ask("target", { deg });
    };
    const timer = window.setInterval(send, SEND_MS);
    return () => window.clearInterval(timer);
  }, [isLed]);
  useEffect(() => {
    const drop = () => { sources.current.pointer = null; };
    window.addEventListener("blur", drop);
    return () => window.removeEventListener("blur", drop);
  }, []);
  const listen = async () => {
    try {
      const access = await navigator.requestMIDIAccess();
      for (const input of access.inputs.values()) {
        input.onmidimessage = (event) => {
          const [kind = 0, control = 0, value = 0] = event.data ?? [];
          if ((kind & 0xf0) !== 0xb0) return;
          sources.current.midi[control % 4] = value / 127;
          sources.current.midi_ms = performance.now();
        };
      }
      actions.hint(access.inputs.size === 0 ? "No MIDI device is there." : "Controllers 0 to 3 (and each fourth) lead the four joints.");
    } catch {
      actions.hint("This browser gives no MIDI.");
    }
  };
  const latency_s = robot?.puppet?.latency_s ?? null;
  if (latency_s === null) return html`<p class="bad-text">${robot?.puppet?.problem ?? "The robot is not known yet."}</p>`;
  /** @param {PointerEvent} event */
  const follow = (event) => {
    const box = /** @type {HTMLElement} */ (event.currentTarget).getBoundingClientRect();
    const own = { x: Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1), y: Math.min(Math.max((box.bottom - event.clientY) / box.height, 0), 1) };
    sources.current.pointer = own;
    setPlace(own);
  };
  const drop = () => { sources.current.pointer = null; };
  return html`<p>Joints follow within their limits, ${Math.round(1000 * (latency_s + SEND_MS / 1000))} ms later at most (this page, player, line, servo; without faults, and besides the network). Let go: they brake, and hold.</p>
    <div class="adds">${["right", "up", "axis 3", "axis 4"].map((words, axis) => html`<span key=${words}><span class="muted">${words}</span>
      <${Pick} label=${`joint of ${words}`} options=${[NONE, ...joints.map((one) => one.name)]} chosen=${names[axis] ?? NONE}
        choose=${(/** @type {string} */ name) => setNames(names.map((one, at) => (at === axis ? name : one === name ? NONE : one)))} /></span>`)}</div>
    <div class=${`pad ${isLed ? "" : "pad-off"}`} role="application" aria-label="pad: press and drag" onPointerDown=${(/** @type {PointerEvent} */ event) => {
      if (!isLed || event.button !== 0) return;
      /** @type {HTMLElement} */ (event.currentTarget).setPointerCapture(event.pointerId);
      follow(event);
    }} onPointerMove=${(/** @type {PointerEvent} */ event) => sources.current.pointer !== null && follow(event)}
      onPointerUp=${drop} onPointerCancel=${drop} onLostPointerCapture=${drop} onContextMenu=${(/** @type {Event} */ event) => event.preventDefault()}>
      <i style=${`left: ${100 * place.x}%; bottom: ${100 * place.y}%`}></i></div>
    <div class="choices">${isLed ? html`<button type="button" onClick=${() => actions.link.ask("disconnect")}>End it</button>`
      : html`<button type="button" class="primary" disabled=${!isRead(state)} onClick=${() => actions.withLease(() => actions.link.ask("puppeteer", { joints: names.filter((name) => joints.some((one) => one.name === name)) }))}>Begin</button>`}
      <button type="button" onClick=${listen}>Use MIDI</button></div>
    <p class="muted">A gamepad leads while one of its buttons is held: its first two axes as the pad, the next two as axis 3 and 4. MIDI leads for a second after each message.</p>`;
}
