/** A file of points, as the manifest or one of its pages tells of it: reading and checking. */
import { ReelError } from "../base/errors";
import { MOST_FRAMES, mostPoints } from "./budget";
import { list, number, plainPath, record, whole, type Json } from "./json";
import type { Asset } from "./presentation";

/** Bytes of the largest file that is read. */
const MOST_BYTES = 2 ** 30;

export interface ReelFile extends Asset {
  firstFrame: number;
  /** Frames the file holds; 0 for a layer. */
  frames: number;
  points: number;
  /** The group at which a layer was born; a group's own number for groups. */
  group: number;
  /** The group at which a layer is retired: it lives at those before; Infinity: at all. */
  until: number;
  /** Groups: layers in order of birth, among them all that live at it. */
  layers: ReelFile[];
  /** The same group in the other renditions, by name. */
  renditions: Map<string, ReelFile>;
}

/** A group's file in a rendition; its own is that of the first. */
export function fileOf(group: ReelFile, rendition: string): ReelFile {
  return group.renditions.get(rendition) ?? group;
}

/** The layers that live at a group, in the order in which its `alive` counts their points. */
export function layersAt({ group: at, layers }: ReelFile): ReelFile[] {
  return layers.filter(({ group, until }) => group <= at && at < until);
}

/** Layers of version 1, in order of birth: none is retired. */
export function parseLayers(value: unknown): ReelFile[] {
  const layers = list(value, "layers").map(parseFile);
  const sum = (field: "points" | "bytes"): number => layers.reduce((total, layer) => total + layer[field], 0);
  checkPoints("layers", sum("points"), sum("bytes"));
  return layers;
}

/** Layers of version 2, in order of birth, those of one group the longest-lived first; what is retired lives at a group from `first` on and before `end`. */
export function parsePassingLayers(value: unknown, first: number, end: number): ReelFile[] {
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

/** A group in all its renditions; `value` itself is the first. layers: among them those that live at it. */
export function parseGroup(value: unknown, index: number, names: string[], layers: ReelFile[]): ReelFile {
  const group = { ...parseFile(value, index), group: index, layers };
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
  const bytes = whole(json.bytes, 1, MOST_BYTES, `bytes of ${uri}`);
  const points = number(json.points, `points of ${uri}`);
  const frames = number(json.frames ?? 0, "frames");
  checkPoints("files", points, bytes);
  if (frames > MOST_FRAMES) throw new ReelError(`The manifest is damaged: a group of ${frames} frames.`);
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

/** Points take memory, and repeated ones no bytes. */
function checkPoints(what: string, points: number, bytes: number): void {
  if (!(points >= 0 && points <= mostPoints(bytes))) throw new ReelError(`The manifest is damaged: ${what} of ${bytes} bytes are to hold ${points} points.`);
}
