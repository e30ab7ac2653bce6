// @ts-check
/** What a device sees that has no key: the field for a pairing code. */

import { html, useState } from "../vendor/preact.js";

/** @param {{ text: string, link: import("../link.js").ServerLink }} props */
export function Entry({ text, link }) {
  const [problem, setProblem] = useState("");
  /** @param {SubmitEvent} event */
  const submit = (event) => {
    event.preventDefault();
    const form = new FormData(/** @type {HTMLFormElement} */ (event.currentTarget));
    link.enter({ code: String(form.get("code")).replace(/\s/g, "") }).then(() => setProblem(""), (error) => setProblem(error.message));
  };
  return html`<main class="entry"><h1>Pair this device</h1>
    <p>${text || "This device has no key yet."} At the computer of the robot, “Pair a tablet” shows a code of six digits; the terminal there printed the first one.</p>
    <form onSubmit=${submit}>
      <label>Code <input name="code" inputmode="numeric" autocomplete="off" pattern="[0-9 ]{6,7}" required autofocus /></label>
      <button type="submit" class="primary">Pair</button>
    </form>
    <p class="bad-text" role="alert">${problem}</p></main>`;
}
