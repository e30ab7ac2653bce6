// @ts-check
/** Numbers as people read them. Pure. */

/** A number with so many digits; what rounds to nothing has no sign.
 * @param {number | null | undefined} value @param {number} digits */
export function number(value, digits) {
  if (value == null || !Number.isFinite(value)) return "–";
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? `−${text}` : text;
}
