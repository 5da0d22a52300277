// Times of the charts as text, with milliseconds. A page imports this file by its address.
const pad = (number, digits = 2) => String(number).padStart(digits, "0");

// Local time, 24 hours whatever the language; or, of a recording, hours since its beginning.
export function clock(seconds, elapsed) {
  if (!elapsed) {
    const date = new Date(1000 * seconds);
    return `${[date.getHours(), date.getMinutes(), date.getSeconds()].map((part) => pad(part)).join(":")}.${pad(date.getMilliseconds(), 3)}`;
  }
  if (seconds < 0) return ""; // before the beginning
  const ms = Math.round(1000 * seconds);
  const parts = [Math.floor(ms / 3_600_000), Math.floor(ms / 60_000) % 60, Math.floor(ms / 1000) % 60];
  return `${parts.map((part) => pad(part)).join(":")}.${pad(ms % 1000, 3)}`;
}
