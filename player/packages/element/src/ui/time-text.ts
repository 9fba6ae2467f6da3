/** Formatting of times. */

/** Format seconds as m:ss, optionally with tenths. */
export function timeText(seconds: number, tenths = false): string {
  const whole = Math.floor(seconds + 1e-6);
  const rest = tenths ? `.${Math.floor((seconds - whole + 1e-6) * 10)}` : "";
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}${rest}`;
}
