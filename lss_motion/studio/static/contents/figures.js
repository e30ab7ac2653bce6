// @ts-check
/** New files as a person would write them: a figure of joints, a show that stands still. Pure. */

/** @typedef {{ name: string, id: number, model: string, range_deg: [number, number], speed_deg_s: number, accel_deg_s2: number }} NewJoint */

export const MODELS = /** @type {const} */ (["LSS-ST1", "LSS-HS1", "LSS-HT1", "LSS-P-S1", "LSS-P-M1", "LSS-P-L1", "LSS-2IO"]);

/** @param {string} name @param {[number, number]} range_deg @param {number} [speed_deg_s] @param {number} [accel_deg_s2] */
const joint = (name, range_deg, speed_deg_s = 180, accel_deg_s2 = 600) => ({ name, range_deg, speed_deg_s, accel_deg_s2 });

/** Kinds of figures with their joints, and lines of their shapes: `{0}` is the name of the first joint.
 * @type {Record<string, { words: string, joints: ReturnType<typeof joint>[], shapes: string[] }>} */
export const FIGURES = {
  head: {
    words: "a talking head",
    joints: [joint("jaw", [0, 20], 360, 1000), joint("nod", [-20, 20]), joint("turn", [-60, 60])],
    shapes: [
      "  base:   {along: z, length_mm: 40, width_mm: 90, shade: dark}",
      "  neck:   {parent: base, joint: {2}, axis: z, along: z, length_mm: 60, width_mm: 36}",
      "  skull:  {parent: neck, joint: {1}, axis: y, along: z, offset_mm: [8, 0, -10], length_mm: 130, shape: ellipsoid, size_mm: [150, 120, 150]}",
      "  left:   {parent: skull, along: x, offset_mm: [52, 26, -55], length_mm: 18, shape: ellipsoid, size_mm: [26, 26, 18], shade: dark}",
      "  right:  {parent: skull, along: x, offset_mm: [52, -26, -55], length_mm: 18, shape: ellipsoid, size_mm: [26, 26, 18], shade: dark}",
      "  jaw:    {parent: skull, joint: {0}, axis: y, along: [1, 0, -0.5], offset_mm: [4, 0, -108], length_mm: 70, width_mm: 60, shade: light}",
    ],
  },
  arm: {
    words: "an arm",
    joints: [joint("base", [-90, 90]), joint("shoulder", [-80, 80]), joint("elbow", [-90, 90]), joint("wrist", [-90, 90])],
    shapes: [
      "  foot:     {along: z, length_mm: 40, width_mm: 90, shade: dark}",
      "  column:   {parent: foot, joint: {0}, axis: z, along: z, length_mm: 60, width_mm: 50}",
      "  upper:    {parent: column, joint: {1}, axis: y, along: z, length_mm: 140, width_mm: 32}",
      "  forearm:  {parent: upper, joint: {2}, axis: y, along: z, length_mm: 120, width_mm: 26}",
      "  hand:     {parent: forearm, joint: {3}, axis: y, along: z, length_mm: 60, width_mm: 20, shade: light}",
    ],
  },
  plain: { words: "only joints", joints: [joint("one", [-90, 90])], shapes: [] },
};

/** Return the joints of a kind of figure, numbered from 1. @param {string} kind @returns {NewJoint[]} */
export function jointsOfKind(kind) {
  return (FIGURES[kind]?.joints ?? []).map((own, index) => ({ ...own, range_deg: [...own.range_deg], id: index + 1, model: MODELS[0] }));
}

/** What is wrong with the joints of a new figure; "" if nothing is. @param {NewJoint[]} joints */
export function jointsProblem(joints) {
  const names = joints.map((own) => own.name);
  if (joints.length === 0) return "a figure has at least one joint";
  if (names.some((name) => !/^[\p{L}_][\p{L}\p{N}_-]*$/u.test(name))) return "a joint has a name of letters, digits, _ and -";
  if (new Set(names).size < names.length) return "two joints have the same name";
  if (new Set(joints.map((own) => own.id)).size < joints.length) return "two joints have the same servo id";
  if (joints.some((own) => !(own.range_deg[0] < own.range_deg[1]))) return "a range ends above its beginning";
  return "";
}

/** Return the text of a robot file. It names no port: the simulated one, or that of `--port`.
 * @param {string} name @param {string} kind @param {NewJoint[]} joints */
export function robotText(name, kind, joints) {
  const width = Math.max(...joints.map((own) => own.name.length)) + 1;
  const rows = joints.map((own) => `  ${`${own.name}:`.padEnd(width)} {id: ${own.id}, model: ${own.model}, range_deg: [${own.range_deg.join(", ")}], `
    + `speed_max_deg_s: ${own.speed_deg_s}, accel_max_deg_s2: ${own.accel_deg_s2}}`);
  const shapes = (FIGURES[kind]?.shapes ?? []).map((line) => line.replace(/\{(\d)\}/g, (all, index) => joints[Number(index)]?.name ?? all));
  const isWhole = joints.length >= (FIGURES[kind]?.joints.length ?? 0);
  return [
    "# Without a port it is simulated; lss-motion studio FILE --port /dev/ttyUSB0 moves servos.",
    `robot: ${worded(name)}`, "joints:", ...rows, ...(shapes.length > 0 && isWhole ? ["figure:", ...shapes] : []), "",
  ].join("\n");
}

/** How long a new show is, until keys say more. */
export const NEW_SHOW_S = 10;

/** Return the text of a show that stands still.
 * @param {string} name @param {string} robot its file @param {Record<string, [number, number] | null>} joints */
export function showText(name, robot, joints) {
  const deg = Object.entries(joints).map(([own, range]) => `${own}: ${range === null ? 0 : Math.min(Math.max(0, range[0]), range[1])}`).join(", ");
  return [`sequence: ${worded(name)}`, `robot: ${robot}`, "keyframes:", `  - {at_s: 0, deg: {${deg}}}`, `  - {at_s: ${NEW_SHOW_S}, deg: {${deg}}}`, ""].join("\n");
}

/** A text as YAML takes it for one. @param {string} text */
function worded(text) {
  return /^\p{L}[\p{L}\p{N}_-]*$/u.test(text) && !/^(y|n|yes|no|on|off|true|false|null)$/i.test(text) ? text : JSON.stringify(text);
}

/** Return the name of the file of something that is new. @param {string} name */
export function fileName(name) {
  return `${name.trim().replace(/\.ya?ml$/i, "").replace(/[^\p{L}\p{N}_-]+/gu, "_").replace(/^_+|_+$/g, "") || "new"}.yaml`;
}
