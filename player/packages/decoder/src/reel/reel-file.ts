/** Entry of a layer or group in the manifest or a page. */
import { ReelError } from "../base/errors";
import { MAX_FRAMES, maxPoints } from "./budget";
import { list, number, plainPath, record, whole, type Json } from "./json";
import type { Asset } from "./presentation";

/** Maximum bytes of a file. */
const MAX_BYTES = 2 ** 30;

/** A layer or group file. */
export interface ReelFile extends Asset {
  firstFrame: number;
  /** Number of frames; 0 for a layer. */
  frames: number;
  points: number;
  /** The group at which a layer was born; for a group, its own number. */
  group: number;
  /** The group at which a layer is retired; Infinity if it never is. */
  until: number;
  /** For a group: layers in order of birth, among them all that live at the group. */
  layers: ReelFile[];
  /** For a group: its files in the other renditions, by name. */
  renditions: Map<string, ReelFile>;
  /** For a group: frames over which it cross-fades with the one before, if not those of the reel. */
  overlap?: number;
}

/** Return the file of a group in a rendition; the first rendition for an unknown name. */
export function fileOf(group: ReelFile, rendition: string): ReelFile {
  return group.renditions.get(rendition) ?? group;
}

/** Return the layers that live at a group, in the order in which its `alive` flags list their points. */
export function layersAt({ group: at, layers }: ReelFile): ReelFile[] {
  return layers.filter(({ group, until }) => group <= at && at < until);
}

/** Parse the layers of version 1, in order of birth. None is retired. */
export function parseLayers(value: unknown): ReelFile[] {
  const layers = list(value, "layers").map(parseFile);
  const sum = (field: "points" | "bytes"): number => layers.reduce((total, layer) => total + layer[field], 0);
  checkPoints("layers", sum("points"), sum("bytes"));
  return layers;
}

/** Parse the layers of version 2, in order of birth, and for one group the longest-lived first. Retired layers live at a group from `first` to before `end`. */
export function parseRetiringLayers(value: unknown, first: number, end: number): ReelFile[] {
  const layers = parseLayers(value).map((layer, index) => {
    const { until } = (value as Json[])[index];
    return until === undefined ? layer : { ...layer, until: whole(until, Math.max(layer.group, first) + 1, 2 ** 40, `until of ${layer.uri}`) };
  });
  for (const [index, { uri, group, until }] of layers.entries()) {
    const before = layers[index - 1];
    const ordered = !before || before.group < group || (before.group === group && before.until >= until);
    if (!ordered || group >= end) throw new ReelError(`The manifest is damaged: ${uri} is not in its place in the order of birth.`);
  }
  return layers;
}

/** Parse a group with its renditions. `value` is the first rendition. layers: must contain those that live at the group. */
export function parseGroup(value: unknown, index: number, names: string[], layers: ReelFile[]): ReelFile {
  const group: ReelFile = { ...parseFile(value, index), group: index, layers };
  const { overlap } = value as Json;
  if (overlap !== undefined) group.overlap = whole(overlap, 0, 2 ** 40, `overlap of ${group.uri}`);
  const others = record((value as Json).renditions ?? {}, "a group's renditions");
  for (const name of names.slice(1)) {
    const { firstFrame, frames } = group;
    const file = parseFile(record(others[name], `rendition ${name} of group ${index}`), index);
    group.renditions.set(name, { ...file, firstFrame, frames, group: index });
  }
  return group;
}

function parseFile(value: unknown, index: number): ReelFile {
  const json = record(value, "a file");
  const uri = plainPath(json.uri);
  const bytes = whole(json.bytes, 1, MAX_BYTES, `bytes of ${uri}`);
  const points = number(json.points, `points of ${uri}`);
  const frames = number(json.frames ?? 0, "frames");
  checkPoints("files", points, bytes);
  if (frames > MAX_FRAMES) throw new ReelError(`The manifest is damaged: a group of ${frames} frames.`);
  return {
    uri,
    bytes,
    sha256: typeof json.sha256 === "string" ? json.sha256 : null,
    firstFrame: number(json.first_frame ?? 0, "first_frame"),
    frames,
    points,
    group: number(json.group ?? index, "group"),
    until: Infinity,
    layers: [],
    renditions: new Map(),
  };
}

/** Limit the number of points, since repeated points compress to almost nothing. */
function checkPoints(what: string, points: number, bytes: number): void {
  if (!(points >= 0 && points <= maxPoints(bytes))) throw new ReelError(`The manifest is damaged: ${what} of ${bytes} bytes are to hold ${points} points.`);
}
