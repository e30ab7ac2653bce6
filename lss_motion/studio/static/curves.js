// @ts-check
/**
 * Angles over time as they come in a view: knots of cubics. Pure.
 *
 * Between two knots the curve is the cubic with the angle and speed of both (Hermite), so that angle,
 * speed and acceleration are known at every instant and zoom. Two knots at one instant are a jump.
 */

/** @typedef {{ times_s: Float64Array, deg: Float32Array, deg_s: Float32Array }} Curve */
/** @typedef {0 | 1 | 2} Order angle, speed or acceleration */

/** Return the bytes of a base64 text. @param {string} text */
function bytesOf(text) {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i += 1) bytes[i] = raw.charCodeAt(i);
  return bytes.buffer;
}

/** @param {string} text */
export function floats32(text) {
  return new Float32Array(bytesOf(text));
}

/** @param {string} text */
export function bytes8(text) {
  return new Int8Array(bytesOf(text));
}

/** Return a curve of a view. @param {{times_s: string, deg: string, deg_s: string}} json */
export function curveFrom(json) {
  return {
    times_s: new Float64Array(bytesOf(json.times_s)),
    deg: floats32(json.deg),
    deg_s: floats32(json.deg_s),
  };
}

/**
 * Return the first index whose value is not less. @param {ArrayLike<number>} sorted
 * @param {number} value
 */
export function lowerBound(sorted, value) {
  let low = 0;
  let high = sorted.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (/** @type {number} */ (sorted[middle]) < value) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Return the piece in which an instant lies; of a jump, the later side.
 * @param {Curve} curve @param {number} at_s */
function pieceAt(curve, at_s) {
  const { times_s } = curve;
  let piece = lowerBound(times_s, at_s);
  while (piece < times_s.length && times_s[piece] === at_s) piece += 1;
  return Math.min(Math.max(piece - 1, 0), times_s.length - 2);
}

/**
 * Return the value at an instant of one piece. @param {Curve} curve @param {number} piece
 * @param {number} at_s @param {Order} order
 */
function inPiece(curve, piece, at_s, order) {
  const t0 = /** @type {number} */ (curve.times_s[piece]);
  const length = Math.max(/** @type {number} */ (curve.times_s[piece + 1]) - t0, 1e-12);
  const p0 = /** @type {number} */ (curve.deg[piece]);
  const v0 = /** @type {number} */ (curve.deg_s[piece]);
  const v1 = /** @type {number} */ (curve.deg_s[piece + 1]);
  const rise = (/** @type {number} */ (curve.deg[piece + 1]) - p0) / length;
  const bend = (3 * rise - 2 * v0 - v1) / length;
  const twist = (v0 + v1 - 2 * rise) / (length * length);
  const t = Math.min(Math.max(at_s - t0, 0), length);
  if (order === 0) return p0 + t * (v0 + t * (bend + t * twist));
  if (order === 1) return v0 + t * (2 * bend + 3 * t * twist);
  return 2 * bend + 6 * t * twist;
}

/**
 * Return angle, speed or acceleration at an instant. @param {Curve} curve @param {number} at_s
 * @param {Order} [order]
 */
export function valueAt(curve, at_s, order = 0) {
  return inPiece(curve, pieceAt(curve, at_s), at_s, order);
}

/** Return the angle at an instant. @param {Curve} curve @param {number} at_s */
export function angleAt(curve, at_s) {
  return valueAt(curve, at_s, 0);
}

/** Instants of a curve at which its least and largest angle are looked for. */
const SAMPLES = 400;

/** Return least and largest angle of a curve. @param {Curve | undefined} curve @param {number} length_s
 * @returns {[number, number]} */
export function usedOf(curve, length_s) {
  if (curve === undefined) return [0, 0];
  let low = Infinity;
  let high = -Infinity;
  for (const deg of curve.deg) {
    low = Math.min(low, deg);
    high = Math.max(high, deg);
  }
  for (let index = 0; index <= SAMPLES; index += 1) {
    const deg = angleAt(curve, (length_s * index) / SAMPLES);
    low = Math.min(low, deg);
    high = Math.max(high, deg);
  }
  return [low, high];
}

/**
 * Fill the least and largest value of each column of pixels: what a line through the curve covers.
 * @param {Curve} curve @param {Order} order @param {number} start_s left edge of column 0
 * @param {number} step_s width of a column @param {Float32Array} lows @param {Float32Array} highs
 * @param {Float32Array} [edges] the value at the right edge of each column
 */
export function fillColumns(curve, order, start_s, step_s, lows, highs, edges) {
  const { times_s } = curve;
  const last = times_s.length - 1;
  let knot = lowerBound(times_s, start_s);
  let piece = pieceAt(curve, start_s);
  let edge = inPiece(curve, piece, start_s, order);
  for (let column = 0; column < lows.length; column += 1) {
    const end_s = start_s + (column + 1) * step_s;
    let low = edge;
    let high = edge;
    /** Speed and acceleration may differ on both sides of a knot. @param {number} value */
    const take = (value) => {
      if (value < low) low = value;
      if (value > high) high = value;
    };
    while (knot <= last && /** @type {number} */ (times_s[knot]) <= end_s) {
      if (knot > 0) take(inPiece(curve, knot - 1, /** @type {number} */ (times_s[knot]), order));
      if (knot < last) {
        piece = knot;
        take(inPiece(curve, piece, /** @type {number} */ (times_s[knot]), order));
      }
      knot += 1;
    }
    edge = inPiece(curve, piece, end_s, order);
    if (edge < low) low = edge;
    if (edge > high) high = edge;
    lows[column] = low;
    highs[column] = high;
    if (edges !== undefined) edges[column] = edge;
  }
}

/**
 * Return the instant of the view that is played at a show time: a part that is played again and
 * again is in the view once.
 * @param {{ repeat: null | {from_s: number, to_s: number, times: number | null} }} view
 * @param {number} show_s
 */
export function withinView(view, show_s) {
  const { repeat } = view;
  if (repeat === null || show_s < repeat.to_s) return show_s;
  const period_s = repeat.to_s - repeat.from_s;
  if (repeat.times !== null) {
    const added_s = (repeat.times - 1) * period_s;
    if (show_s >= repeat.to_s + added_s) return show_s - added_s;
  }
  return repeat.from_s + ((show_s - repeat.from_s) % period_s);
}

/**
 * Return a show time that is an instant of the view: its first time.
 * @param {{ repeat: null | {from_s: number, to_s: number, times: number | null} }} view
 * @param {number} view_s
 */
export function showTimeOf(view, view_s) {
  const { repeat } = view;
  if (repeat === null || repeat.times === null || view_s <= repeat.to_s) return view_s;
  return view_s + (repeat.times - 1) * (repeat.to_s - repeat.from_s);
}
