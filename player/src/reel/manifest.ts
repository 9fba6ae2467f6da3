/** manifest.json of a reel (docs/format.md): reading and checking. */
import { PLAIN, ReelError } from "../base/errors";
import type { Vec3 } from "../base/matrix";
import { downloadText } from "../files/download";
import type { LocalFiles } from "../files/local-files";
import type { Source, Watcher } from "../files/source";
import { list, number, numbers, positive, record, whole, type Json } from "./json";
import { LAST, numbered, parsePages, type Listing } from "./pages";
import { parsePresentation, type Asset, type Presentation } from "./presentation";
import { parseGroup, parseLayers, parsePassingLayers } from "./reel-file";

/** A pinhole camera, OpenCV: K [9] in pixels and viewmat [16] world to camera, both row by row. */
export interface Camera {
  name: string;
  width: number;
  height: number;
  K: number[];
  viewmat: number[];
}

/** The room that a viewer has before static points: around a new place there may be some that only looked well from far away. */
export interface Clearance {
  focus: Vec3;
  share: number;
}

export interface Manifest extends Listing {
  /** Absolute; the files' uris are relative to it. */
  url: string;
  /** Groups are still being added; there may be none yet. */
  live: boolean;
  fps: number;
  frames: number;
  shDegree: number;
  bounds: [Vec3, Vec3];
  up: Vec3;
  /** Least depth to draw, world units. */
  near: number;
  /** What rests and is nearer to a viewer than `share` of the depth of `focus` is not drawn. */
  clearance: Clearance;
  /** Red, green and blue, 0 to 1, where nothing is; the light falls on it as well. */
  background: Vec3;
  /** Splats thinner than a pixel are drawn fainter. */
  antialias: boolean;
  camera: Camera;
  cameras: Camera[];
  /** What there is for people beside the points. */
  presentation: Presentation;
  /** Where the files are, of a reel on this machine; null: on the network. */
  files: LocalFiles | null;
}

/** Download and check a manifest. Throws `ReelError` with the url in its message. */
export async function loadManifest(url: string, watcher: Watcher, signal: AbortSignal, early?: Promise<string | null>): Promise<Manifest> {
  const text = (await early) ?? (await downloadText(url, watcher, signal));
  return parseText(text, new URL(url, location.href).href);
}

/** The manifest of a reel on this machine. Throws `ReelError`. */
export async function readManifest(files: LocalFiles): Promise<Manifest> {
  // Nothing is added to it any more.
  return { ...parseText(await files.manifest(), files.url), files, live: false };
}

function parseText(text: string, url: string): Manifest {
  let value: unknown;
  try {
    value = JSON.parse(text);
  } catch {
    throw new ReelError(`${url} is not a reel's manifest: it is not JSON.`, { plain: PLAIN.other });
  }
  return parseManifest(value, url);
}

/** Check a manifest's fields; unknown ones are ignored, an unknown version is an error. */
export function parseManifest(value: unknown, url: string): Manifest {
  const json = record(value, "the manifest");
  if (json.format !== "splatreel") throw new ReelError(`${url} is not a reel: its format is ${JSON.stringify(json.format)}.`, { plain: PLAIN.other });
  if (json.version !== 1 && json.version !== 2) {
    throw new ReelError(`${url} is a reel of version ${JSON.stringify(json.version)}; this player knows versions 1 and 2.`, { plain: PLAIN.newer });
  }
  const bounds = list(json.bounds, "bounds").map((corner) => numbers(corner, 3, "bounds") as Vec3);
  if (bounds.length !== 2) throw new ReelError(`${url}: bounds needs two corners.`);
  const renditions = parseNames(json.renditions);
  const second = json.version === 2;
  const first = second ? whole(json.first_group ?? 0, 0, LAST, "first_group") : 0;
  const pages = parsePages(second ? (json.pages ?? []) : [], first);
  const begin = pages.reduce((number, { count }) => number + count, first);
  const own = list(json.groups, "groups");
  const layers = second ? parsePassingLayers(json.layers, begin, begin + own.length) : parseLayers(json.layers);
  const groups = own.map((item, i) => parseGroup(item, begin + i, renditions, layers));
  const live = json.live === true;
  if (groups.length === 0 && (!live || pages.length > 0)) throw new ReelError(`${url} holds no group yet.`, { plain: "Nothing of this reel is here yet." });
  const end = groups.reduce((last, group) => Math.max(last, group.firstFrame + group.frames), 0);
  if (json.frames !== end) throw new ReelError(`The manifest is damaged: it has ${JSON.stringify(json.frames)} frames, and its groups ${end}.`);
  if (pages.length > 0 && pages.at(-1)!.firstFrame >= groups[0].firstFrame) throw new ReelError("The manifest is damaged: its pages end after its groups begin.");
  return {
    url,
    live,
    fps: positive(json.fps, "fps"),
    frames: end,
    overlap: number(json.overlap, "overlap"),
    shDegree: number(json.sh_degree, "sh_degree"),
    near: json.near === undefined ? 0.01 : positive(json.near, "near"),
    clearance: json.clearance === undefined ? { focus: [0, 0, 0], share: 0 } : parseClearance(record(json.clearance, "clearance")),
    background: json.background === undefined ? [0, 0, 0] : parseColor(json.background),
    antialias: json.antialias === true,
    bounds: bounds as [Vec3, Vec3],
    up: numbers(json.up, 3, "up") as Vec3,
    camera: parseCamera(json.camera),
    cameras: list(json.cameras ?? [], "cameras").map(parseCamera),
    layers,
    first,
    groups: numbered(groups),
    pages,
    renditions,
    presentation: parsePresentation(json),
    files: null,
  };
}

/** Whether two manifests are of one reel: that of a live one grows. */
export function isSameReel(a: Manifest, b: Manifest | null): boolean {
  return a.url === b?.url && a.files === b.files;
}

/** Whether two manifests name the same files, with the same contents. */
export function hasSameFiles(a: Manifest, b: Manifest): boolean {
  const [one, other] = [a, b].map(({ layers, groups, pages, first }) => JSON.stringify([layers, groups, pages, first]));
  return one === other;
}

/** Where to get a file of a reel: `download` takes it. */
export function sourceOf({ url, files }: Manifest, { uri, bytes, sha256 }: Asset): Source {
  return { url: new URL(uri, url).href, bytes, sha256, part: files?.part(uri) };
}

/** An address of a picture of a reel, for an image of the page. */
export async function addressOf({ url, files }: Manifest, { uri }: Asset): Promise<string> {
  return files ? files.address(uri) : new URL(uri, url).href;
}

function parseColor(value: unknown): Vec3 {
  const color = numbers(value, 3, "background");
  if (!color.every((part) => part >= 0 && part <= 1)) throw new ReelError(`The manifest is damaged: its background is ${JSON.stringify(color)}.`);
  return color as Vec3;
}

function parseClearance(json: Json): Clearance {
  const share = number(json.share, "clearance share");
  if (share < 0 || share > 1) throw new ReelError(`The manifest is damaged: the share of its clearance is ${share}.`);
  return { focus: numbers(json.focus, 3, "clearance focus") as Vec3, share };
}

/** Of the renditions. One alone is none to choose from. */
function parseNames(value: unknown): string[] {
  const names = list(value ?? [], "renditions").map((item) => record(item, "a rendition").name);
  const valid = names.filter((name): name is string => typeof name === "string" && /^[a-z0-9][a-z0-9_-]{0,31}$/.test(name));
  if (new Set(valid).size < names.length || names.length > 16) throw new ReelError("The manifest is damaged: its renditions have no names of their own.");
  return valid.length > 1 ? valid : [];
}

function parseCamera(value: unknown): Camera {
  const json = record(value, "a camera");
  const K = numbers(json.K, 9, "camera K");
  if (!(K[0] > 0 && K[4] > 0)) throw new ReelError(`The manifest is damaged: a camera has the focal lengths ${K[0]} and ${K[4]}.`);
  return {
    name: String(json.name ?? ""),
    width: positive(json.width, "camera width"),
    height: positive(json.height, "camera height"),
    K,
    viewmat: numbers(json.viewmat, 16, "camera viewmat"),
  };
}
