/** Times in an address, as of media fragments: `#t=1.5`, `#t=0:01.5,3`, `#t=npt:10,20`. */

/** Seconds; null: not said. */
export interface TimeFragment {
  start: number | null;
  end: number | null;
}

/** What cannot be read counts as not said. */
export function timesOf(address: string): TimeFragment {
  const given = new URLSearchParams(address.split("#")[1] ?? "").get("t") ?? "";
  const [start, end] = given.replace(/^npt:/, "").split(",").map(secondsOf);
  return { start: start ?? null, end: end !== undefined && end !== null && end > (start ?? 0) ? end : null };
}

function secondsOf(text: string): number | null {
  if (!/^(\d+:){0,2}\d+(\.\d*)?s?$/.test(text)) return null;
  return text.split(":").reduce((sum, part) => 60 * sum + Number.parseFloat(part), 0);
}
