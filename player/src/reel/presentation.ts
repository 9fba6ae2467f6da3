/** What a manifest says for people beside the points: words, pictures, sound, and how far views hold (docs/format.md). All optional. */
import { ReelError } from "../base/errors";
import type { Vec3 } from "../base/matrix";
import { list, number, numbers, plainPath, positive, record, within, type Json } from "./json";

/** What any asset may have at most, in bytes. */
const MAX_ASSET = 64 << 20;

/** A file without points. uri: relative to the manifest. */
export interface Asset {
  uri: string;
  bytes: number;
  sha256: string | null;
}

/** A picture of the start camera at the first frame. */
export interface Poster extends Asset {
  width: number;
  height: number;
}

/** Pictures of width x height pixels; the k-th of `count` shows k * seconds. Sheets of columns x rows of them, row by row. */
export interface Thumbnails {
  width: number;
  height: number;
  columns: number;
  rows: number;
  seconds: number;
  count: number;
  sheets: Asset[];
}

/** From `start`, seconds of the reel, on. */
export interface SoundSegment extends Asset {
  start: number;
  seconds: number;
}

/** `init`, and any run of consecutive segments after it, is a stream of `type`. position: null: from everywhere. */
export interface Sound {
  type: string;
  rate: number;
  channels: number;
  init: Asset;
  segments: SoundSegment[];
  position: Vec3 | null;
}

/** Where views hold; null: no limit. angle: degrees, seen from the focus, to the nearest camera. floor: height along `up`. */
export interface Limits {
  focus: Vec3;
  angle: number | null;
  distance: [number, number] | null;
  floor: number | null;
}

export interface Presentation {
  title: string;
  author: string;
  description: string;
  licence: string;
  poster: Poster | null;
  thumbnails: Thumbnails | null;
  sound: Sound | null;
  limits: Limits | null;
}

export function parsePresentation(json: Json): Presentation {
  const part = <T>(name: string, parse: (value: Json) => T): T | null => (json[name] == null ? null : parse(record(json[name], name)));
  return {
    title: text(json, "title"),
    author: text(json, "author"),
    description: text(json, "description"),
    licence: text(json, "licence"),
    poster: part("poster", parsePoster),
    thumbnails: part("thumbnails", parseThumbnails),
    sound: part("sound", parseSound),
    limits: part("limits", parseLimits),
  };
}

function text(json: Json, name: string): string {
  const value = json[name] ?? "";
  if (typeof value !== "string") throw new ReelError(`The manifest is damaged: its ${name} is no text.`);
  return value.slice(0, 2000);
}

export function parseAsset(value: unknown, most = MAX_ASSET): Asset {
  const json = record(value, "a file");
  return { uri: plainPath(json.uri), bytes: within(json.bytes, 1, most, "bytes"), sha256: typeof json.sha256 === "string" ? json.sha256 : null };
}

function parsePoster(json: Json): Poster {
  return { ...parseAsset(json), width: positive(json.width, "poster width"), height: positive(json.height, "poster height") };
}

function parseThumbnails(json: Json): Thumbnails {
  const of = (name: string): number => positive(json[name], `thumbnails ${name}`);
  const [columns, rows, count] = [of("columns"), of("rows"), of("count")];
  const sheets = list(json.sheets, "thumbnails sheets").map((sheet) => parseAsset(sheet));
  if (Math.ceil(count / (columns * rows)) !== sheets.length) throw new ReelError(`The manifest is damaged: ${sheets.length} sheets do not hold ${count} thumbnails.`);
  return { width: of("width"), height: of("height"), seconds: of("seconds"), columns, rows, count, sheets };
}

function parseSound(json: Json): Sound {
  if (typeof json.type !== "string" || !/^audio\/[a-z0-9]+; codecs="[A-Za-z0-9.]+"$/.test(json.type)) {
    throw new ReelError(`The manifest is damaged: its sound is of the type ${JSON.stringify(json.type)}.`);
  }
  const segments = list(json.segments, "sound segments").map(parseSegment);
  if (segments.some((later, i) => i > 0 && later.start < segments[i - 1]!.start + segments[i - 1]!.seconds - 1e-3)) {
    throw new ReelError("The manifest is damaged: its sound segments overlap.");
  }
  return {
    type: json.type,
    rate: within(json.rate, 1000, 768_000, "sound rate"),
    channels: within(json.channels, 1, 8, "sound channels"),
    init: parseAsset(json.init),
    segments,
    position: json.position === undefined ? null : (numbers(json.position, 3, "sound position") as Vec3),
  };
}

function parseSegment(value: unknown): SoundSegment {
  const json = record(value, "a sound segment");
  return { ...parseAsset(json), start: within(json.start, 0, 1e7, "sound start"), seconds: within(json.seconds, 1e-3, 3600, "sound seconds") };
}

function parseLimits(json: Json): Limits {
  const distance = json.distance === undefined ? null : (numbers(json.distance, 2, "limits distance") as [number, number]);
  if (distance && !(distance[0] >= 0 && distance[0] < distance[1])) throw new ReelError(`The manifest is damaged: its limits of distance are ${distance.join(" to ")}.`);
  return {
    focus: numbers(json.focus, 3, "limits focus") as Vec3,
    angle: json.angle === undefined ? null : number(json.angle, "limits angle"),
    distance,
    floor: json.floor === undefined ? null : number(json.floor, "limits floor"),
  };
}
