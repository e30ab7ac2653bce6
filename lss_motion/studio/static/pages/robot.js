// @ts-check
/** The robot page: takes what `RobotView` shows from the store. */

import { html, useEffect, useState } from "../vendor/preact.js";
import { robotPose } from "../figure/panel.js";
import { nextFrame } from "../frames.js";
import { RobotView } from "./robot_view.js";

/** @typedef {import("../store.js").Store} Store */
/** @typedef {import("../link.js").ServerLink} ServerLink */
/** @typedef {import("./robot_view.js").RobotJson} RobotJson */
/** @typedef {import("./robot_view.js").LiveRobot} LiveRobot */

/** How often the angles of a playing robot are shown as numbers. */
const READING_MS = 250;

/** @type {LiveRobot} */
const OFF = { state: "off", port: "", is_simulated: false, joints: {}, text: "" };

/** @param {{ store: Store, link: ServerLink, actions: import("../actions.js").Actions }} props */
export function RobotPage({ store, link, actions }) {
  const state = store.state.value;
  const robot = /** @type {RobotJson | null} */ (state.robot);
  const live = /** @type {LiveRobot} */ (state.robot_state ?? OFF);
  const played = usePlayedAngles(store, live.state === "playing");
  if (robot === null) {
    return html`<main class="page"><p>The robot file could not be read yet; its errors stand above.</p></main>`;
  }
  return html`<${RobotView}
    robot=${robot}
    live=${live.state === "playing" ? { ...live, joints: played } : live}
    stood=${robotPose(store)}
    health=${live.state === "off" ? {} : (state.health?.joints ?? {})}
    isMine=${state.lease.is_mine}
    isLatched=${state.player.latch !== null}
    isLost=${state.link.status !== "open"}
    scanned=${state.scanned}
    maintenance=${state.maintenance ?? null}
    send=${(/** @type {string} */ op, /** @type {Record<string, unknown>} */ fields) => link.send(op, fields)}
    ask=${(/** @type {import("./robot_view.js").Question} */ question) => actions.set({ dialog: { kind: "confirm", ...question } })}
    schedule=${nextFrame}
    theme=${state.theme}
    puppeteer=${() => actions.set({ dialog: { kind: "puppet" } })}
  />`;
}

/**
 * Return the angles that were read last while a show plays, a few times a second.
 * @param {Store} store @param {boolean} isPlaying
 */
function usePlayedAngles(store, isPlaying) {
  const [angles, setAngles] = useState(/** @type {LiveRobot["joints"]} */ ({}));
  useEffect(() => {
    if (!isPlaying) return undefined;
    const read = () => {
      const telemetry = store.telemetry.peek();
      const names = store.state.peek().started?.joints ?? [];
      if (telemetry === null) return;
      setAngles(
        Object.fromEntries(
          names.map((name, index) => {
            const deg = telemetry.read_deg[index] ?? NaN;
            return [name, { deg: Number.isFinite(deg) ? deg : null, is_limp: false }];
          }),
        ),
      );
    };
    read();
    const timer = window.setInterval(read, READING_MS);
    return () => window.clearInterval(timer);
  }, [store, isPlaying]);
  return angles;
}
