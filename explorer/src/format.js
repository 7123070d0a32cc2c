/** Numbers and units as a reader has them. */

const READABLE = { m: ["mm", 1e3], rad: ["°", 180 / Math.PI], "m/s": ["mm/s", 1e3], "rad/s": ["°/s", 180 / Math.PI] };

export const readable = (unit) => READABLE[unit] ?? [unit === "1" ? "" : unit, 1];

/** A number with so many digits that count. */
export function short(value, digits = 4) {
  if (value === null || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "-∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size >= 1e5 || size < 1e-3 ? value.toExponential(Math.max(0, digits - 2)) : String(Number(value.toPrecision(digits)));
  return text.replace("e+", "e");
}

/** A number of an axis, as exact as it is. */
export function axisNumber(value) {
  const exact = Number(value.toPrecision(6));
  const size = Math.abs(exact);
  return size > 0 && (size < 1e-3 || size >= 1e5) ? exact.toExponential().replace("e+", "e") : String(exact);
}

export const withUnit = (value, unit, digits = 4) => {
  const [name, scale] = readable(unit);
  return Number.isNaN(value) || value === null ? "–" : `${short(value * scale, digits)}${name === "°" ? "" : " "}${name}`.trim();
};

/** A number without the noise of its last digits, for values that sliders set. */
export const rounded = (value, digits = 10) => Number(value.toPrecision(digits));
