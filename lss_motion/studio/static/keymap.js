// @ts-check
/**
 * The keys of the studio as data: the handler, the help and a test read the same table. Escape is not
 * here: stop.js has it, and what it closes is in `Actions.closeOpen`.
 */

/** @typedef {{ keys: string[], action: string, text: string, pages?: string[] }} Binding */

/** @type {Binding[]} */
export const KEYMAP = [
  { keys: ["Space"], action: "toggle", text: "play from the cursor, pause, resume (never GO)" },
  { keys: ["Enter"], action: "go", text: "GO, where the show waits for it", pages: ["show"] },
  { keys: ["Enter"], action: "type_value", text: "type the value of the chosen key", pages: ["timeline"] },
  { keys: ["ArrowLeft"], action: "step_back", text: "chosen keys 10 ms back; else the cursor", pages: ["timeline"] },
  { keys: ["ArrowRight"], action: "step", text: "chosen keys 10 ms forward; else the cursor", pages: ["timeline"] },
  { keys: ["Shift+ArrowLeft"], action: "stride_back", text: "100 ms back", pages: ["timeline"] },
  { keys: ["Shift+ArrowRight"], action: "stride", text: "100 ms forward", pages: ["timeline"] },
  { keys: ["ArrowUp"], action: "up", text: "chosen keys of a joint 0.5° up; else the row above", pages: ["timeline"] },
  { keys: ["ArrowDown"], action: "down", text: "chosen keys of a joint 0.5° down; else the row below", pages: ["timeline"] },
  { keys: ["Shift+ArrowUp"], action: "far_up", text: "5° up", pages: ["timeline"] },
  { keys: ["Shift+ArrowDown"], action: "far_down", text: "5° down", pages: ["timeline"] },
  { keys: ["["], action: "previous_key", text: "previous key", pages: ["timeline"] },
  { keys: ["]"], action: "next_key", text: "next key", pages: ["timeline"] },
  { keys: ["i", "k"], action: "add", text: "key at the cursor, in the row of the focus (also double-click, Ctrl and click)", pages: ["timeline"] },
  { keys: ["g"], action: "grab", text: "move the chosen keys with the pointer or the arrow keys, until a click or Enter (also by dragging)", pages: ["timeline"] },
  { keys: ["s"], action: "scale", text: "scale the chosen keys about the cursor in the same way: their times, with Y their angles", pages: ["timeline"] },
  { keys: ["D"], action: "duplicate", text: "duplicate the chosen keys, and move the copies", pages: ["timeline"] },
  { keys: ["Control+m"], action: "mirror", text: "exchange left and right, by mirror of the robot file", pages: ["timeline"] },
  { keys: ["b"], action: "choose_box", text: "choose by a box that may begin on a key", pages: ["timeline"] },
  { keys: ["Delete", "Backspace"], action: "delete", text: "delete the chosen keys", pages: ["timeline"] },
  { keys: ["Control+c"], action: "copy", text: "copy", pages: ["timeline"] },
  { keys: ["Control+x"], action: "cut", text: "cut", pages: ["timeline"] },
  { keys: ["Control+v"], action: "paste", text: "paste at the cursor", pages: ["timeline"] },
  { keys: ["a"], action: "choose_all", text: "choose all keys of the row; again: of all rows", pages: ["timeline"] },
  { keys: ["Alt+a"], action: "choose_none", text: "choose none", pages: ["timeline"] },
  { keys: ["x"], action: "axis_time", text: "while dragging: in time only, or free again", pages: ["timeline"] },
  { keys: ["y"], action: "axis_angle", text: "while dragging: in angle only, or free again", pages: ["timeline"] },
  { keys: ["t"], action: "ease", text: "next ease of the chosen keys", pages: ["timeline"] },
  { keys: ["v"], action: "slope", text: "slope of the chosen key of a joint: flat, free (drag its handles), of the curve", pages: ["timeline"] },
  { keys: ["h"], action: "hold", text: "how long a key is held", pages: ["timeline"] },
  { keys: ["l"], action: "label", text: "label of a key", pages: ["timeline"] },
  { keys: ["n"], action: "anchor", text: "anchor, or no more", pages: ["timeline"] },
  { keys: ["R"], action: "ripple", text: "ripple: later keys move, too", pages: ["timeline"] },
  { keys: ["Control+z"], action: "undo", text: "undo" },
  { keys: ["Control+Z", "Control+y"], action: "redo", text: "redo" },
  { keys: ["Control+s"], action: "save", text: "save" },
  { keys: ["Control+Home"], action: "to_start", text: "to the start", pages: ["timeline"] },
  { keys: ["Control+End", "End"], action: "to_end", text: "to the end", pages: ["timeline"] },
  { keys: ["Home"], action: "fit", text: "show all", pages: ["timeline"] },
  { keys: ["f"], action: "fit_chosen", text: "show what is chosen, else all", pages: ["timeline"] },
  { keys: ["+", "="], action: "zoom_in", text: "zoom in", pages: ["timeline"] },
  { keys: ["-"], action: "zoom_out", text: "zoom out", pages: ["timeline"] },
  { keys: ["p"], action: "follow", text: "keep the playhead in sight", pages: ["timeline"] },
  { keys: ["1"], action: "order_0", text: "curves of angle", pages: ["timeline"] },
  { keys: ["2"], action: "order_1", text: "curves of speed", pages: ["timeline"] },
  { keys: ["3"], action: "order_2", text: "curves of acceleration", pages: ["timeline"] },
  { keys: ["v"], action: "theatre", text: "figure and clock only, and back", pages: ["show", "robot"] },
  { keys: ["t"], action: "theme", text: "dark or light", pages: ["show", "robot"] },
  { keys: ["Alt+1"], action: "page_show", text: "Show page (on the Robot page 1 does, too)" },
  { keys: ["Alt+2"], action: "page_timeline", text: "Timeline page (on the others 2 does, too)" },
  { keys: ["Alt+3"], action: "page_robot", text: "Robot page (on the Show page 3 does, too)" },
  { keys: ["1"], action: "page_show", text: "", pages: ["show", "robot"] },
  { keys: ["2"], action: "page_timeline", text: "", pages: ["show", "robot"] },
  { keys: ["3"], action: "page_robot", text: "", pages: ["show", "robot"] },
  { keys: ["?"], action: "help", text: "this list" },
];

/** Keys of stop.js, for the help. @type {Binding[]} */
export const STOP_KEYS = [
  { keys: ["Escape"], action: "stop", text: "closes what is open (this list, a question, a message, a selection); else STOP: brakes within the limits" },
  { keys: ["Shift+Escape"], action: "estop", text: "E-STOP, always: the safe bytes at once" },
];

/** Return the name of a pressed key as the table has it.
 * @param {{ key: string, code: string, shiftKey: boolean, ctrlKey: boolean, metaKey: boolean, altKey: boolean }} event */
export function keyName(event) {
  // With Alt some keyboards give another sign.
  if (event.altKey) return `Alt+${/^Digit\d$/.test(event.code) ? event.code.slice(5) : event.key}`;
  if (event.ctrlKey || event.metaKey) return `Control+${event.key}`;
  if (event.code === "Space") return "Space";
  const isNamed = event.key.length > 1;
  return event.shiftKey && isNamed ? `Shift+${event.key}` : event.key;
}

/**
 * Return what a key does on a page, or null. @param {string} name @param {string} page
 */
export function actionOf(name, page) {
  const found = KEYMAP.find(
    (one) => one.keys.includes(name) && (one.pages === undefined || one.pages.includes(page)),
  );
  return found?.action ?? null;
}

/**
 * Return whether an element needs the key for itself. @param {Element | null} element
 * @param {string} name
 */
export function keepsKey(element, name) {
  if (element === null || element.matches(":disabled")) return false;
  if (element.closest("dialog") !== null) return true;
  if (name === "Control+s") return false;
  if (element.matches("textarea, input:not([type=range])")) return true;
  if (element.matches("input[type=range]")) return name.includes("Arrow") || name === "Home" || name === "End";
  // Space never means GO, also where the GO button has the focus.
  if (name === "Space" && element.matches("[data-go]")) return false;
  return (name === "Space" || name === "Enter") && element.matches("button, a, summary, [role=tab]");
}

/**
 * Give the keys back to the page after a click by a pointer: Enter is GO then, and does not press the
 * clicked button once more. Who presses a button by a key keeps the focus there.
 * @param {MouseEvent} event
 */
export function releaseFocus(event) {
  const element = document.activeElement;
  if (event.detail === 0 || !(element instanceof HTMLElement) || element.closest("dialog") !== null) return;
  if (element.matches("button, summary, input[type=checkbox], input[type=radio]")) element.blur();
}
