/** WebVTT: cues with times, settings and markup. Regions, styles and times within a cue are ignored, as small players do. */

/** A piece of a cue: a text, or an element with pieces. */
export type Piece = string | { tag: string; classes: string[]; note: string; pieces: Piece[] };

/** A cue. Times are in seconds; lines and positions are in percent, and lines may also be counted. */
export interface Cue {
  id: string;
  start: number;
  end: number;
  /** Settings such as `align:start`, by name. */
  settings: Map<string, string>;
  text: string;
}

/** Cues in order of their start, and the number of those that were left out since their times cannot be read. */
export interface Cues {
  cues: Cue[];
  unreadable: number;
}

const TIME = String.raw`(?:(\d{2,}):)?([0-5]\d):([0-5]\d)\.(\d{3})`;
const TIMING = new RegExp(String.raw`^\s*${TIME}\s*-->\s*${TIME}(?:\s+(.*))?$`);
const ENTITIES: Record<string, string> = {
  amp: "&",
  lt: "<",
  gt: ">",
  nbsp: "\u00a0",
  lrm: "\u200e",
  rlm: "\u200f",
  quot: '"',
  apos: "'",
};
/** Tags that cues may have. Others are dropped, and their text stays. */
const TAGS = new Set(["b", "i", "u", "c", "v", "lang", "ruby", "rt"]);

/** Parse a WebVTT file. Throws an `Error` if the text is of another format. */
export function parseCues(text: string): Cues {
  const lines = text
    .replace(/^\ufeff/, "")
    .replace(/\0/g, "\ufffd")
    .split(/\r\n|\n|\r/);
  if (!/^WEBVTT(?:[ \t]|$)/.test(lines[0]))
    throw new Error(`it is not WebVTT: its first line is ${JSON.stringify(lines[0].slice(0, 40))} instead of "WEBVTT"`);
  const cues: Cue[] = [];
  let unreadable = 0;
  for (const block of blocksOf(lines.slice(1))) {
    const at = block.findIndex((line) => line.includes("-->"));
    if (at < 0) continue; // a header, a note, a style or a region
    const timing = at <= 1 ? TIMING.exec(block[at]) : null;
    const [start, end] = timing ? [secondsOf(timing, 1), secondsOf(timing, 5)] : [0, 0];
    if (!timing || end <= start) {
      unreadable++;
      continue;
    }
    const settings = new Map(
      (timing[9] ?? "")
        .split(/\s+/)
        .filter((part) => part.includes(":"))
        .map((part) => part.split(/:(.*)/).slice(0, 2) as [string, string]),
    );
    cues.push({ id: at === 1 ? block[0] : "", start, end, settings, text: block.slice(at + 1).join("\n") });
  }
  return { cues: cues.sort((a, b) => a.start - b.start || b.end - a.end), unreadable };
}

/** Return runs of lines between empty lines. */
function blocksOf(lines: string[]): string[][] {
  const blocks: string[][] = [[]];
  for (const line of lines) {
    if (line === "") blocks.push([]);
    else blocks.at(-1)!.push(line);
  }
  return blocks.filter((block) => block.length > 0);
}

function secondsOf(match: RegExpExecArray, at: number): number {
  const [hours, minutes, seconds, milliseconds] = match.slice(at, at + 4).map((part) => Number(part ?? 0));
  return 3600 * hours + 60 * minutes + seconds + milliseconds / 1000;
}

/** Parse the markup of a cue. Tags that are not closed end with the cue. */
export function parseMarkup(text: string): Piece[] {
  const root: Piece[] = [];
  const open: { tag: string; pieces: Piece[] }[] = [{ tag: "", pieces: root }];
  for (const [, close, tag, rest, words] of text.matchAll(/<(\/?)([a-z]*)([^>]*)>|([^<]+)/g)) {
    if (words !== undefined) open.at(-1)!.pieces.push(unescaped(words));
    else if (!TAGS.has(tag)) continue;
    else if (!close) {
      const [classes, ...note] = rest.split(/\s+/);
      const piece = {
        tag,
        classes: classes.split(".").filter((name) => name !== ""),
        note: unescaped(note.join(" ")),
        pieces: [],
      };
      open.at(-1)!.pieces.push(piece);
      open.push(piece);
    } else if (open.some((piece) => piece.tag === tag)) while (open.pop()!.tag !== tag);
  }
  return root;
}

/** Return the text of a cue without markup, on one line. */
export function plainText(text: string): string {
  const flat = (pieces: Piece[]): string =>
    pieces.map((piece) => (typeof piece === "string" ? piece : flat(piece.pieces))).join("");
  return flat(parseMarkup(text)).replace(/\s+/g, " ").trim();
}

function unescaped(text: string): string {
  return text.replace(/&(?:#(\d+)|#x([\da-f]+)|(\w+));/gi, (whole, decimal, hex, name) => {
    const code = decimal ? Number(decimal) : hex ? Number.parseInt(hex, 16) : NaN;
    return Number.isNaN(code)
      ? (ENTITIES[name] ?? whole)
      : code > 0 && code <= 0x10ffff
        ? String.fromCodePoint(code)
        : "\ufffd";
  });
}
