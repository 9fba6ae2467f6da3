/** The optional parts of a manifest: texts, images, sound, and limits of the view (docs/format.md). */
import { ReelError } from "../base/errors";
import type { Vec3 } from "../base/matrix";
import { digest, list, numbers, plainPath, record, shortText, whole, within, type Json } from "./json";

/** Maximum bytes of an asset. */
const MAX_ASSET = 64 << 20;
/** Maximum characters of a description, and of the other texts. */
const MAX_DESCRIPTION = 2000;
const MAX_TEXT = 200;
/** Maximum seconds of a reel. */
const MAX_SECONDS = 1e7;

/** A file of the reel. uri: relative to the manifest. */
export interface Asset {
  uri: string;
  bytes: number;
  sha256: string;
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
  const part = <T>(name: string, parse: (value: Json) => T): T | null =>
    json[name] == null ? null : parse(record(json[name], name));
  return {
    title: shortText(json, "title", MAX_TEXT),
    author: shortText(json, "author", MAX_TEXT),
    description: shortText(json, "description", MAX_DESCRIPTION),
    licence: shortText(json, "licence", MAX_TEXT),
    poster: part("poster", parsePoster),
    thumbnails: part("thumbnails", parseThumbnails),
    sound: part("sound", parseSound),
    limits: part("limits", parseLimits),
  };
}

/** Parse a file entry of at most `most` bytes. */
export function parseAsset(value: unknown, most = MAX_ASSET): Asset {
  const json = record(value, "a file");
  return { uri: plainPath(json.uri), bytes: whole(json.bytes, 1, most, "bytes"), sha256: digest(json.sha256) };
}

function parsePoster(json: Json): Poster {
  return {
    ...parseAsset(json),
    width: whole(json.width, 1, 2 ** 14, "poster width"),
    height: whole(json.height, 1, 2 ** 14, "poster height"),
  };
}

function parseThumbnails(json: Json): Thumbnails {
  const of = (name: string, most: number): number => whole(json[name], 1, most, `thumbnails ${name}`);
  const [columns, rows, count] = [of("columns", 1000), of("rows", 1000), of("count", 2 ** 30)];
  const sheets = list(json.sheets, "thumbnails sheets").map((sheet) => parseAsset(sheet));
  if (Math.ceil(count / (columns * rows)) !== sheets.length)
    throw new ReelError(`The manifest is damaged: ${sheets.length} sheets do not hold ${count} thumbnails.`);
  return {
    width: of("width", 4096),
    height: of("height", 4096),
    seconds: within(json.seconds, 1e-3, MAX_SECONDS, "thumbnails seconds"),
    columns,
    rows,
    count,
    sheets,
  };
}

function parseSound(json: Json): Sound {
  if (
    typeof json.type !== "string" ||
    json.type.length > 100 ||
    !/^audio\/[a-z0-9]+; codecs="[A-Za-z0-9.]+"$/.test(json.type)
  ) {
    throw new ReelError(`The manifest is damaged: its sound is of the type ${JSON.stringify(json.type)}.`);
  }
  const segments = list(json.segments, "sound segments").map(parseSegment);
  if (segments.length === 0) throw new ReelError("The manifest is damaged: its sound has no segments.");
  if (segments.some((later, i) => i > 0 && later.start < segments[i - 1]!.start + segments[i - 1]!.seconds - 1e-3)) {
    throw new ReelError("The manifest is damaged: its sound segments overlap.");
  }
  return {
    type: json.type,
    rate: whole(json.rate, 1000, 768_000, "sound rate"),
    channels: whole(json.channels, 1, 8, "sound channels"),
    init: parseAsset(json.init),
    segments,
    position: json.position === undefined ? null : (numbers(json.position, 3, "sound position") as Vec3),
  };
}

function parseSegment(value: unknown): SoundSegment {
  const json = record(value, "a sound segment");
  return {
    ...parseAsset(json),
    start: within(json.start, 0, MAX_SECONDS, "sound start"),
    seconds: within(json.seconds, 1e-3, 3600, "sound seconds"),
  };
}

function parseLimits(json: Json): Limits {
  const distance =
    json.distance === undefined ? null : (numbers(json.distance, 2, "limits distance") as [number, number]);
  if (distance && !(distance[0] >= 0 && distance[0] < distance[1]))
    throw new ReelError(`The manifest is damaged: its limits of distance are ${distance.join(" to ")}.`);
  return {
    focus: numbers(json.focus, 3, "limits focus") as Vec3,
    angle: json.angle === undefined ? null : within(json.angle, 0, 180, "limits angle"),
    distance,
    floor: json.floor === undefined ? null : within(json.floor, -3e38, 3e38, "limits floor"),
  };
}
