/** Media fragments in an address: `#t=1.5`, `#t=0:01.5,3`, `#t=npt:10,20`. */

/** Start and end in seconds; null if not given. */
export interface TimeFragment {
  start: number | null;
  end: number | null;
}

/** Parse the fragment of an address. Invalid parts are null. */
export function timesOf(address: string): TimeFragment {
  const given = new URLSearchParams(address.split("#")[1] ?? "").get("t") ?? "";
  const [start, end] = given.replace(/^npt:/, "").split(",").map(secondsOf);
  return { start: start ?? null, end: end !== undefined && end !== null && end > (start ?? 0) ? end : null };
}

function secondsOf(text: string): number | null {
  if (!/^(\d+:){0,2}\d+(\.\d*)?s?$/.test(text)) return null;
  return text.split(":").reduce((sum, part) => 60 * sum + Number.parseFloat(part), 0);
}
