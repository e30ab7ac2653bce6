// @ts-check
/**
 * STOP and E-STOP. This module loads first and imports nothing, so that both work whatever else
 * fails. A stop goes out on pointer-down, with no question: as a POST to the server and, at the same
 * time, to the process that only stops, and by the websocket. It is repeated until the server says
 * that it is kept.
 */

const REPEAT_MS = 400;
const REPEATS_MAX = 15;
/** The answer to a device without a key, or with one of a server that has ended. */
const DENIED = 401;

/** @typedef {"stop" | "estop"} StopKind */

/** @type {{ origins: string[], send: ((kind: StopKind) => void) | null }} */
const ways = { origins: [""], send: null };

/** Closes what is open on the page; returns whether something was. @type {() => boolean} */
let closeOpen = () => false;

/** What is being sent and not yet confirmed. @type {{ kind: StopKind, left: number } | null} */
let pending = null;
let timer = 0;
/** What the banner says of a stop, so that no other trouble is taken from it. */
let told = "";
/** Whether the server refuses a stop of this device: it has no key. */
let isDenied = false;

/** Add the origin of the process that only stops. @param {string} origin */
export function setStopOrigin(origin) {
  ways.origins = ["", origin];
}

/** Set how a stop goes by the websocket. @param {(kind: StopKind) => void} send */
export function setStopSender(send) {
  ways.send = send;
}

/** Set what Escape closes before it stops. @param {() => boolean} close */
export function setCloser(close) {
  closeOpen = close;
}

/** The server keeps the stop: it need not be repeated. @param {boolean} isLatched */
export function confirmStop(isLatched) {
  document.body.dataset["latched"] = String(isLatched);
  if (isDenied || isLatched) tellOfStop("");
  isDenied = false;
  if (isLatched) finish();
}

/** Send a stop by every way at once. @param {StopKind} kind */
export function sendStop(kind) {
  // An emergency stop is never taken back to a stop.
  if (pending === null || pending.kind === "stop") pending = { kind, left: REPEATS_MAX };
  document.body.dataset["stopping"] = pending.kind;
  tellOfStop("");
  once(pending.kind);
  clearInterval(timer);
  timer = setInterval(() => {
    if (pending === null || pending.left <= 0) {
      if (pending !== null && !isDenied) tellOfStop("The stop was sent, and is not confirmed. If the robot still moves, cut its power.");
      finish();
      return;
    }
    pending.left -= 1;
    once(pending.kind);
  }, REPEAT_MS);
}

/** @param {StopKind} kind */
function once(kind) {
  for (const origin of ways.origins) {
    fetch(`${origin}/${kind}`, {
      method: "POST",
      mode: origin === "" ? "same-origin" : "no-cors",
      credentials: "include",
      keepalive: true,
    }).then((response) => {
      if (response.status === DENIED && pending !== null) deny();
    }).catch(() => {}); // The other ways may have arrived; the repetition goes on until one has.
  }
  try {
    ways.send?.(kind);
  } catch {
    // The websocket is closed.
  }
}

/** Say at once that a device without a key stops nothing; the repetition goes on all the same. */
function deny() {
  isDenied = true;
  tellOfStop("This device is not paired: it cannot stop the robot. Stop it at the computer, or cut its power.");
}

/** @param {string} text */
function tellOfStop(text) {
  if (text === "" && document.getElementById("trouble")?.textContent !== told) return;
  told = text;
  showTrouble(text);
}

function finish() {
  clearInterval(timer);
  pending = null;
  delete document.body.dataset["stopping"];
}

/** Show what went wrong in a banner. @param {string} text */
export function showTrouble(text) {
  const banner = document.getElementById("trouble");
  if (banner === null) return;
  banner.textContent = text;
  banner.hidden = text === "";
}

for (const kind of /** @type {const} */ (["stop", "estop"])) {
  const button = document.getElementById(kind);
  button?.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    sendStop(kind);
  });
  // Enter and space on the focused button, and assistive technology, have no pointer.
  button?.addEventListener("click", (event) => {
    if (event.detail === 0) sendStop(kind);
  });
}

window.addEventListener(
  "keydown",
  (event) => {
    if (event.key !== "Escape" || event.repeat) return;
    event.stopImmediatePropagation();
    if (event.shiftKey) sendStop("estop");
    else if (!hasClosed()) sendStop("stop");
  },
  { capture: true },
);

/** Whether something was open; it is closed now. */
function hasClosed() {
  try {
    return closeOpen();
  } catch {
    return false;
  }
}

/** Keep the buttons where the screen shows them: in a part that is zoomed in, above a keyboard. */
function keepInSight() {
  const stops = document.getElementById("stops");
  const seen = window.visualViewport;
  if (stops === null || seen === null) return;
  const { clientWidth, clientHeight } = document.documentElement;
  const right_px = seen.offsetLeft + seen.width - clientWidth;
  const down_px = seen.offsetTop + seen.height - clientHeight;
  stops.style.transform = `translate(${right_px}px, ${down_px}px) scale(${1 / seen.scale})`;
}

for (const change of ["resize", "scroll"]) window.visualViewport?.addEventListener(change, keepInSight);

window.addEventListener("error", (event) => {
  showTrouble(`The page has an error, but STOP works: ${event.message}. Load the page again.`);
});
window.addEventListener("unhandledrejection", (event) => {
  showTrouble(`The page has an error, but STOP works: ${String(event.reason)}. Load the page again.`);
});
