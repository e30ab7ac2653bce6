// @ts-check
/** The poses of the robot page: go to one, save where the robot is over one, or as a new one. */

import { html, useState } from "../vendor/preact.js";

/** As the server wants it. */
export const POSE_NAME = /^[A-Za-z][A-Za-z0-9_-]{0,63}$/;

/**
 * Return why a name cannot be that of a new pose; an empty text if it can.
 * @param {string} name @param {string[]} known
 */
export function nameProblem(name, known) {
  if (name === "") return "";
  if (known.includes(name)) return `${name} is there already: save over it instead`;
  if (!POSE_NAME.test(name)) return "begin with a letter; then letters, digits, - and _";
  return "";
}

/** @param {Record<string, number>} pose */
export function poseText(pose) {
  return Object.entries(pose)
    .map(([joint, deg]) => `${joint} ${Number(deg.toFixed(1))}°`)
    .join(", ");
}

/**
 * @param {object} props
 * @param {Record<string, Record<string, number>>} props.poses
 * @param {boolean} props.mayMove
 * @param {string} props.why
 * @param {(op: string, fields: object) => Promise<void>} props.act
 * @param {(question: import("./robot_view.js").Question) => void} props.ask
 */
export function PoseList({ poses, mayMove, why, act, ask }) {
  const names = Object.keys(poses);
  const [name, setName] = useState("");
  const problem = nameProblem(name, names);
  const title = mayMove ? undefined : why;
  /** @param {string} pose */
  const saveOver = (pose) => {
    const text = `Now it is: ${poseText(poses[pose])}. The angles that the robot has now replace these in the robot file.`;
    ask({ title: `Save over ${pose}?`, text, yes: "Save over", run: () => act("pose.save", { pose, is_new: false }) });
  };
  /** @param {Event} event */
  const add = async (event) => {
    event.preventDefault();
    if (name === "" || problem !== "") return;
    await act("pose.save", { pose: name, is_new: true });
    setName("");
  };
  return html`<section class="robot-poses" aria-labelledby="robot-poses-title">
    <h2 id="robot-poses-title">Poses</h2>
    ${names.length === 0 ? html`<p class="robot-quiet">The robot file has none yet.</p>` : null}
    <ul>
      ${names.map(
        (pose) =>
          html`<li key=${pose}>
            <span class="robot-pose-name" title=${poseText(poses[pose])}>${pose}</span>
            <button type="button" disabled=${!mayMove} title=${title} aria-label=${`Go to ${pose}`} onClick=${() => act("pose.go", { pose })}>
              Go to
            </button>
            <button type="button" disabled=${!mayMove} title=${title} aria-label=${`Save over ${pose} …`} onClick=${() => saveOver(pose)}>
              Save over …
            </button>
          </li>`,
      )}
    </ul>
    <form onSubmit=${add}>
      <label>
        New pose
        <input
          type="text"
          value=${name}
          placeholder="name"
          maxlength="64"
          autocomplete="off"
          spellcheck=${false}
          aria-invalid=${problem !== ""}
          aria-describedby="robot-pose-problem"
          onInput=${(/** @type {any} */ event) => setName(event.target.value)}
        />
      </label>
      <button type="submit" disabled=${!mayMove || name === "" || problem !== ""} title=${title}>Save as new</button>
      <span id="robot-pose-problem" class="robot-trouble" role="status">${problem}</span>
    </form>
  </section>`;
}
