// @ts-check
/**
 * The link to the server: session, websocket, heartbeat, resync. Every event goes to the store; what
 * was sent is answered by `accepted` or `refused`.
 */

import { requestFrame } from "./frames.js";
import { telemetryFrom, triedFrom, viewFrom } from "./messages.js";
import { confirmStop, setStopOrigin, setStopSender } from "./stop.js";

/** @typedef {import("./store.js").Store} Store */

/** Without a heartbeat for so long, the server is lost. It sends one a second. */
const SILENT_MS = 3000;
const BEAT_MS = 1000;
const RETRY_MS = 500;
const RETRY_MAX_MS = 5000;
const ANSWER_MS = 8000;
/** Codes of a closed websocket (`studio/app.py`). */
const CLOSE_DENIED = 4001;
const CLOSE_OVERRUN = 4002;

/** @typedef {{ resolve: () => void, reject: (error: Error) => void, timer: number }} Waiting */

/** The one websocket of a page. */
export class ServerLink {
  #store;
  /** @type {WebSocket | null} */
  #socket = null;
  /** @type {Map<number, Waiting>} */
  #waiting = new Map();
  #next_id = 1;
  #heard_ms = 0;
  #retry_ms = RETRY_MS;
  /** The plan whose view is here, and the revision of the text it is of. @type {string | null} */
  #plan = null;
  #revision = -1;
  #robot = -1;
  /** When the planner was asked for what it has not answered yet. */
  #asked_ms = 0;

  /** @param {Store} store */
  constructor(store) {
    this.#store = store;
    setStopSender((kind) => this.#post({ op: kind }));
    setInterval(() => this.#watch(), BEAT_MS);
  }

  /** Give the token or a pairing code, and connect. @param {{token?: string, code?: string}} key */
  async enter(key) {
    const response = await fetch("/session", {
      method: "POST",
      headers: { "content-type": "application/json" },
      body: JSON.stringify(key),
    });
    if (!response.ok) throw new Error((await response.json()).error);
    this.connect();
  }

  /** Open the websocket. */
  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    this.#heard_ms = performance.now();
    socket.onmessage = (message) => this.#take(socket, message.data);
    socket.onclose = (event) => this.#closed(socket, event.code, event.reason);
  }

  /**
   * Send an operation; resolves when it is accepted, and throws what the server refuses with.
   * @param {string} op @param {Record<string, unknown>} [fields] @returns {Promise<void>}
   */
  send(op, fields = {}) {
    const id = this.#next_id;
    this.#next_id += 1;
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => {
        this.#waiting.delete(id);
        reject(new Error(`${op}: the server does not answer`));
      }, ANSWER_MS);
      this.#waiting.set(id, { resolve, reject, timer });
      if (!this.#post({ op, id, ...fields })) {
        this.#answer(id, new Error(`${op}: there is no link to the server`));
      }
    });
  }

  /** Send an operation whose refusal is shown to the person; resolves when it is answered.
   * @param {string} op @param {Record<string, unknown>} [fields] @returns {Promise<void>} */
  ask(op, fields = {}) {
    const dispatch = this.#store.dispatch;
    return this.send(op, fields).then(() => {
      if (this.#store.state.value.refusal !== null) dispatch({ type: "set", fields: { refusal: null } });
    }, (error) => dispatch({ type: "refused", text: error.message }));
  }

  /** @param {Record<string, unknown>} content @returns {boolean} whether it was sent */
  #post(content) {
    if (this.#socket?.readyState !== WebSocket.OPEN) return false;
    this.#socket.send(JSON.stringify(content));
    return true;
  }

  /** @param {WebSocket} socket @param {string | ArrayBuffer} data */
  #take(socket, data) {
    if (socket !== this.#socket) return;
    this.#heard_ms = performance.now();
    if (this.#store.state.value.link.status === "lost") {
      this.#store.dispatch({ type: "set", fields: { link: { status: "open", text: "" } } });
    }
    if (typeof data !== "string") {
      this.#takeTelemetry(data);
      return;
    }
    const event = JSON.parse(data);
    if (event.event === "heartbeat") return;
    if (event.event === "accepted") this.#answer(event.id, null);
    else if (event.event === "refused") this.#answer(event.id, new Error(event.text));
    else this.#takeEvent(event);
  }

  /** @param {ArrayBuffer} data */
  #takeTelemetry(data) {
    const frame = telemetryFrom(data);
    if (frame === null) return;
    this.#store.telemetry.value = frame;
    this.#store.deviations.take(frame);
    if (frame.show_s >= 0) this.#store.readings.push(frame.plan, frame.show_s, frame.read_deg, frame.predicted_deg);
    requestFrame();
  }

  /** @param {any} event */
  #takeEvent(event) {
    if (event.event === "tried") {
      this.#store.tried.value = triedFrom(event);
      return;
    }
    if (event.event === "welcome") {
      this.#retry_ms = RETRY_MS;
      setStopOrigin(event.stop_origin);
    }
    if (event.event === "document") this.#asked_ms = performance.now() - 1000 * event.planning_s;
    if (event.event === "player") confirmStop(event.latch !== null);
    if (event.event === "started") {
      this.#store.readings.reset(event.joints.length);
      this.#store.telemetry.value = null;
    }
    // A robot that is moved without a show is no longer where that left it.
    if (event.event === "robot" && ["connecting", "live"].includes(event.state)) this.#store.telemetry.value = null;
    this.#store.dispatch({ type: "event", event });
    if (event.event === "document") this.#fetchDocument(event);
  }

  /** Fetch what a document names and is not here yet. @param {any} event */
  #fetchDocument(event) {
    if (event.robot !== this.#robot) {
      this.#robot = event.robot;
      fetch("/robot.json").then(async (response) => {
        if (!response.ok) return;
        this.#store.dispatch({ type: "set", fields: { robot: await response.json() } });
      }).catch(() => void (this.#robot = -1));
    }
    // Another text may have the same plan, with other keys: of now, or of before.
    const isSame = event.plan === this.#plan;
    if (event.plan === null || isSame && (!event.is_current || event.revision === this.#revision)) return;
    this.#plan = event.plan;
    const revision = this.#revision = event.is_current ? event.revision : -1;
    fetch(`/view/${event.plan}.json`, { cache: "reload" }).then(async (response) => {
      const json = await response.json();
      if (!response.ok) throw new Error(json.error);
      if (this.#plan === json.plan && this.#revision === revision) {
        this.#store.dispatch({ type: "view", view: { ...viewFrom(json), revision } });
      }
    }).catch((error) => {
      this.#plan = null;
      this.#store.dispatch({ type: "refused", text: `the plan cannot be shown: ${error.message}` });
    });
  }

  /** @param {number} id @param {Error | null} error */
  #answer(id, error) {
    const waiting = this.#waiting.get(id);
    if (waiting === undefined) return;
    this.#waiting.delete(id);
    clearTimeout(waiting.timer);
    if (error === null) waiting.resolve();
    else waiting.reject(error);
  }

  /** Once a second: say that this page is alive, and look whether server and planner are. */
  #watch() {
    if (this.#socket === null) return;
    this.#post({ op: "beat" });
    const { link: { status }, document: own } = this.#store.state.value;
    if (own?.is_planning && status === "open") {
      this.#store.dispatch({ type: "waited_on_planner", planning_s: (performance.now() - this.#asked_ms) / 1000 });
    }
    if (status === "open" && performance.now() - this.#heard_ms > SILENT_MS) this.#lose("the server does not answer");
  }

  /** @param {string} text */
  #lose(text) {
    this.#store.dispatch({ type: "set", fields: { link: { status: "lost", text } } });
  }

  /** @param {WebSocket} socket @param {number} code @param {string} reason */
  #closed(socket, code, reason) {
    if (socket !== this.#socket) return;
    this.#socket = null;
    for (const id of [...this.#waiting.keys()]) this.#answer(id, new Error("the link to the server is lost"));
    const isNew = this.#store.state.value.welcome === null;
    // A refused handshake has the code 1006, as has a server that is gone: ask which it is.
    if (code === CLOSE_DENIED || isNew) {
      this.#askWhy(reason);
      return;
    }
    if (code !== CLOSE_OVERRUN) this.#lose("the link to the server is lost");
    this.#retry();
  }

  /** @param {string} reason */
  #askWhy(reason) {
    fetch("/robot.json").then((response) => {
      if (response.status !== 401) throw new Error("no question of the key");
      this.#store.dispatch({ type: "set", fields: { link: { status: "denied", text: reason } } });
    }).catch(() => {
      this.#lose("the server cannot be reached");
      this.#retry();
    });
  }

  #retry() {
    const wait_ms = this.#retry_ms;
    this.#retry_ms = Math.min(2 * this.#retry_ms, RETRY_MAX_MS);
    this.#plan = null;
    this.#revision = -1;
    this.#robot = -1;
    setTimeout(() => {
      if (this.#socket === null) this.connect();
    }, wait_ms);
  }
}
