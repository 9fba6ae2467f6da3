/** The result of the self-test as text for an issue. */

/** One line of the result. */
export interface Finding {
  name: string;
  /** "fact" for a measurement, which neither passes nor fails. */
  state: "passed" | "failed" | "skipped" | "fact";
  text: string;
}

/** Return the value below which a part of the values lies, 0 to 1; NaN without values. */
export function quantile(values: readonly number[], part: number): number {
  const sorted = [...values].sort((a, b) => a - b);
  const at = part * (sorted.length - 1);
  const low = Math.floor(at);
  return sorted[low] + (at - low) * ((sorted[low + 1] ?? sorted[low]) - sorted[low]);
}

/** Return a text such as "median 16.7 ms, 95th percentile 33.2 ms"; "none" without values. */
export function spreadOf(milliseconds: readonly number[]): string {
  if (milliseconds.length === 0) return "none";
  return `median ${quantile(milliseconds, 0.5).toFixed(1)} ms, 95th percentile ${quantile(milliseconds, 0.95).toFixed(1)} ms`;
}

/** Return megabytes (10^6) of a number of bytes. */
export function megabytes(bytes: number): string {
  return `${(bytes / 1e6).toFixed(1)} MB`;
}

/** Return the findings as a table in Markdown. */
export function reportOf(version: string, findings: readonly Finding[]): string {
  const rows = findings.map(
    ({ name, state, text }) => `| ${name} | ${cell(state === "fact" ? text : text ? `${state}: ${text}` : state)} |`,
  );
  return [`### Self-test of Splatreel's player ${version}`, "", "| test | result |", "|---|---|", ...rows, ""].join(
    "\n",
  );
}

/** Escape a text so that it stays within its cell. Texts may come from the browser or a damaged reel. */
function cell(text: string): string {
  return text
    .replace(/\s+/g, " ")
    .replace(/[|\\`<]/g, (mark) => `\\${mark}`)
    .slice(0, 400);
}
