/** The optional parts of a manifest: texts, images, sound, and limits of the view (docs/format.md). */
import { ReelError } from "../base/errors";
import type { Vec3 } from "../base/matrix";
import { list, number, numbers, plainPath, positive, record, within, type Json } from "./json";

/** Maximum bytes of an asset. */
const MAX_ASSET = 64 << 20;

/** A file of the reel. uri: relative to the manifest. */
export interface Asset {
  uri: string;
  bytes: number;
  sha256: string | null;
}

/** Image of the first frame, seen by the start camera. */
export interface Poster extends Asset {
  width: number;
  height: number;
}

/** Thumbnails of width x height pixels in sheets of columns x rows, row by row. Number k of `count` shows the time k * seconds. */
export interface Thumbnails {
  width: number;
  height: number;
  columns: number;
  rows: number;
  seconds: number;
  count: number;
  sheets: Asset[];
}

/** A piece of sound that begins at `start`, in seconds of the reel. */
export interface SoundSegment extends Asset {
  start: number;
  seconds: number;
}

/** Sound track: `init` followed by any run of consecutive segments is a stream of `type`. position: source, or null for sound from everywhere. */
export interface Sound {
  type: string;
  rate: number;
  channels: number;
  init: Asset;
  segments: SoundSegment[];
  position: Vec3 | null;
}

/** Limits of the view, each null for none. angle: degrees between view and nearest camera, seen from the focus. floor: height along `up`. */
export interface Limits {
  focus: Vec3;
  angle: number | null;
  distance: [number, number] | null;
  floor: number | null;
}

/** Texts, images, sound and limits of a reel. */
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

/** Parse the optional parts of a manifest. */
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
  if (typeof value !== "string") throw new ReelError(`The manifest is damaged: its ${name} is not a text.`);
  return value.slice(0, 2000);
}

/** Parse a file entry of at most `most` bytes. */
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
