// @ts-check
/** The horn's readings of the running show: over show time, and how far from their prediction. Pure. */

const ROOM = 4096;
const SEGMENTS_MAX = 64;
/** Readings closer together than this are not kept: there are fewer of each joint in reality. */
const STEP_MIN_S = 0.02;

/** @typedef {{ times_s: Float64Array, deg: Float32Array[], count: number }} Segment */

/** A joint whose reading is the same for longer has rested, or was not read. */
const REST_S = 0.6;
/** A joint that is predicted to turn by less rests: readings come in steps of 0.1°, with noise. */
const REST_DEG = 0.5;

/**
 * Readings in order of arrival, in segments of growing time. A frame repeats the last reading of each
 * joint; only one that differs is new, and is kept. The others are NaN.
 */
export class ReadingTrace {
  /** @type {Segment[]} */
  #segments = [];
  /** Last reading of each joint, and when it was new. */
  #last_deg = new Float64Array(0);
  #last_s = new Float64Array(0);
  /** Where each joint was predicted when it was read last, and in the frame before. */
  #planned_deg = new Float64Array(0);
  #before_deg = new Float64Array(0);
  /** When the frame before came. */
  #before_s = -Infinity;
  #joints = 0;
  /** Of which plan they are. */
  plan = "";

  /** Forget everything. @param {number} joints */
  reset(joints) {
    this.plan = "";
    this.#segments = [];
    this.#joints = joints;
    this.#last_deg = new Float64Array(joints).fill(NaN);
    this.#last_s = new Float64Array(joints).fill(-Infinity);
    this.#planned_deg = new Float64Array(joints).fill(NaN);
    this.#before_deg = new Float64Array(joints).fill(NaN);
    this.#before_s = -Infinity;
  }

  get segments() {
    return this.#segments;
  }

  /** Add a frame: the last reading of each joint, NaN for one that was not read yet.
   * Those of another plan are forgotten. @param {string} plan @param {number} at_s
   * @param {ArrayLike<number>} deg in the order of the joints
   * @param {ArrayLike<number>} predicted_deg where they are predicted */
  push(plan, at_s, deg, predicted_deg) {
    if (deg.length !== this.#joints || plan !== this.plan) this.reset(deg.length);
    this.plan = plan;
    if (at_s >= this.#before_s && at_s - this.#before_s < STEP_MIN_S) return;
    if (at_s < this.#before_s) this.#last_s.fill(-Infinity);
    /** @type {number[]} */
    const fresh = [];
    for (let joint = 0; joint < this.#joints; joint += 1) {
      const own = /** @type {number} */ (deg[joint]);
      if (!Number.isNaN(own) && own !== this.#last_deg[joint]) fresh.push(joint);
    }
    // Where a joint rested until the frame before, its line goes on from there. One that had to move on
    // meanwhile was not read: it is not known where it was.
    const rested = fresh.filter((joint) => this.#before_s - /** @type {number} */ (this.#last_s[joint]) > REST_S
      && Math.abs(/** @type {number} */ (this.#before_deg[joint]) - /** @type {number} */ (this.#planned_deg[joint])) < REST_DEG);
    if (rested.length > 0 && Number.isFinite(this.#before_s) && at_s >= this.#before_s) {
      this.#add(this.#before_s, rested, this.#last_deg);
    }
    if (fresh.length > 0) this.#add(at_s, fresh, deg);
    for (const joint of fresh) {
      this.#last_deg[joint] = /** @type {number} */ (deg[joint]);
      this.#last_s[joint] = at_s;
      this.#planned_deg[joint] = /** @type {number} */ (predicted_deg[joint]);
    }
    this.#before_deg.set(predicted_deg);
    this.#before_s = at_s;
  }

  /** @param {number} at_s @param {number[]} joints @param {ArrayLike<number>} deg */
  #add(at_s, joints, deg) {
    let own = this.#segments.at(-1);
    const last_s = own === undefined || own.count === 0 ? -Infinity : /** @type {number} */ (own.times_s[own.count - 1]);
    if (own === undefined || at_s < last_s || own.count === ROOM) {
      own = {
        times_s: new Float64Array(ROOM),
        deg: Array.from({ length: this.#joints }, () => new Float32Array(ROOM).fill(NaN)),
        count: 0,
      };
      this.#segments.push(own);
      if (this.#segments.length > SEGMENTS_MAX) this.#segments.shift();
    }
    own.times_s[own.count] = at_s;
    for (const joint of joints) /** @type {Float32Array} */ (own.deg[joint])[own.count] = /** @type {number} */ (deg[joint]);
    own.count += 1;
  }
}

/**
 * How far each joint was from its prediction when it was read last. A frame repeats readings, which
 * are old while the joint moves on: drawn as they are, they would look like a lag that is not there.
 */
export class Deviations {
  /** @type {number[]} */
  #read_deg = [];
  /** @type {number[]} */
  #away_deg = [];

  #plan = "";

  /** Take a frame; only a reading that differs is new. Those of another plan are forgotten.
   * @param {import("./state.js").Telemetry} telemetry */
  take(telemetry) {
    if (telemetry.plan !== this.#plan) {
      this.#plan = telemetry.plan;
      this.#read_deg = [];
      this.#away_deg = [];
    }
    telemetry.read_deg.forEach((read_deg, joint) => {
      if (!Number.isFinite(read_deg) || read_deg === this.#read_deg[joint]) return;
      this.#read_deg[joint] = read_deg;
      this.#away_deg[joint] = read_deg - (telemetry.predicted_deg[joint] ?? NaN);
    });
  }

  /** Return the deviation of a joint; NaN: it was not read yet. @param {number} joint */
  of(joint) {
    return this.#away_deg[joint] ?? NaN;
  }
}
