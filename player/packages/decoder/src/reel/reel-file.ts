/** Entry of a layer or group in the manifest or a page. */
import { ReelError } from "../base/errors";
import { MAX_FRAMES, maxPoints } from "./budget";
import { MAX_NUMBER, digest, list, plainPath, record, whole, type Json } from "./json";
import type { Asset } from "./presentation";

/** Maximum bytes of a file, number of layers or groups, and number of renditions. */
const MAX_BYTES = 2 ** 30;
const MAX_FILES = 2 ** 20;
const MAX_RENDITIONS = 16;

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

/** Parse the names of renditions. Returns none if there is only one. */
export function parseNames(value: unknown = []): string[] {
  const names = list(value, "renditions").map((item) => record(item, "a rendition").name);
  const valid = names.filter(
    (name): name is string => typeof name === "string" && /^[a-z0-9][a-z0-9_-]{0,31}$/.test(name),
  );
  if (new Set(valid).size < names.length || names.length > MAX_RENDITIONS)
    throw new ReelError("The manifest is damaged: its renditions lack distinct names.");
  return valid.length > 1 ? valid : [];
}

/** Return the bytes of groups in each rendition. */
export function bytesOf(names: string[], groups: ReelFile[]): number[] {
  return names.map((name) => groups.reduce((sum, group) => sum + fileOf(group, name).bytes, 0));
}

/** Compare the bytes that a manifest states of its renditions with those of its pages and groups. */
export function checkBytes(
  value: unknown,
  names: string[],
  pages: { renditionBytes: number[] }[],
  groups: ReelFile[],
): void {
  for (const [i, own] of bytesOf(names, groups).entries()) {
    const found = pages.reduce((sum, page) => sum + page.renditionBytes[i], own);
    const told = (value as Json[])[i].bytes;
    if (told !== found)
      throw new ReelError(
        `The manifest is damaged: rendition ${names[i]} is to have ${JSON.stringify(told)} bytes; its groups have ${found}.`,
      );
  }
}

/** Parse the layers of version 1, in order of birth, one at most for each group before `end`. None is retired. */
export function parseLayers(value: unknown, end: number): ReelFile[] {
  const layers = parseFiles(value);
  for (const [index, { uri, group }] of layers.entries()) {
    if (group <= (layers[index - 1]?.group ?? -1) || group >= end)
      throw new ReelError(`The manifest is damaged: ${uri} is not in its place in the order of birth.`);
  }
  return layers;
}

function parseFiles(value: unknown): ReelFile[] {
  const layers = list(value, "layers").map((item) => parseFile(item, 0));
  if (new Set(layers.map(({ uri }) => uri)).size < layers.length)
    throw new ReelError("The manifest is damaged: it lists a layer twice.");
  if (layers.length > MAX_FILES) throw new ReelError(`The manifest is damaged: it has ${layers.length} layers.`);
  const sum = (field: "points" | "bytes"): number => layers.reduce((total, layer) => total + layer[field], 0);
  checkPoints("layers", sum("points"), sum("bytes"));
  return layers;
}

/** Parse the layers of version 2, in order of birth, and for one group the longest-lived first. Retired layers live at a group from `first` to before `end`. */
export function parseRetiringLayers(value: unknown, first: number, end: number): ReelFile[] {
  const layers = parseFiles(value).map((layer, index) => {
    const { until } = (value as Json[])[index];
    return until === undefined
      ? layer
      : { ...layer, until: whole(until, Math.max(layer.group, first) + 1, MAX_NUMBER, `until of ${layer.uri}`) };
  });
  for (const [index, { uri, group, until }] of layers.entries()) {
    const before = layers[index - 1];
    const ordered = !before || before.group < group || (before.group === group && before.until >= until);
    if (!ordered || group >= end)
      throw new ReelError(`The manifest is damaged: ${uri} is not in its place in the order of birth.`);
  }
  return layers;
}

/** Parse a group with its renditions. `value` is the first rendition. layers: must contain those that live at the group. */
export function parseGroup(value: unknown, index: number, names: string[], layers: ReelFile[]): ReelFile {
  const { frames: length, first_frame: begin, renditions = {} } = record(value, "a group");
  const frames = whole(length, 1, MAX_FRAMES, "frames of a group");
  const group: ReelFile = { ...parseFile({ ...(value as Json), group: index }, frames), layers };
  const { overlap } = value as Json;
  if (overlap !== undefined) group.overlap = whole(overlap, 0, MAX_NUMBER, `overlap of ${group.uri}`);
  const others = record(renditions, "a group's renditions");
  for (const name of names.slice(1)) {
    const file = record(others[name], `rendition ${name} of group ${index}`);
    group.renditions.set(name, { ...parseFile({ ...file, first_frame: begin, group: index }, frames), layers });
  }
  return group;
}

function parseFile(value: unknown, frames: number): ReelFile {
  const json = record(value, "a file");
  const uri = plainPath(json.uri);
  const bytes = whole(json.bytes, 1, MAX_BYTES, `bytes of ${uri}`);
  const points = whole(json.points, 0, MAX_NUMBER, `points of ${uri}`);
  checkPoints("files", points, bytes);
  return {
    uri,
    bytes,
    sha256: digest(json.sha256),
    firstFrame: whole(json.first_frame, 0, MAX_NUMBER, `first_frame of ${uri}`),
    frames,
    points,
    group: whole(json.group, 0, MAX_NUMBER, `group of ${uri}`),
    until: Infinity,
    layers: [],
    renditions: new Map(),
  };
}

/** Limit the number of points, since repeated points compress to almost nothing. */
function checkPoints(what: string, points: number, bytes: number): void {
  if (points > maxPoints(bytes))
    throw new ReelError(`The manifest is damaged: ${what} of ${bytes} bytes are to hold ${points} points.`);
}
