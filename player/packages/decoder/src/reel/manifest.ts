/** Reading and checking of a reel's manifest.json (docs/format.md). */
import { PLAIN, ReelError } from "../base/errors";
import type { Vec3 } from "../base/matrix";
import { download, downloadText } from "../files/download";
import type { LocalFiles } from "../files/local-files";
import type { Access, Source, Watcher } from "../files/source";
import {
  MAX_NUMBER,
  addressWithin,
  flag,
  list,
  numbers,
  parseJson,
  record,
  shortText,
  whole,
  within,
  type Json,
} from "./json";
import { LAST, checkOrder, numbered, parsePages, type Listing } from "./pages";
import { parsePresentation, type Asset, type Presentation } from "./presentation";
import { checkBytes, parseGroup, parseLayers, parseNames, parseRetiringLayers } from "./reel-file";

/** Maximum characters of a camera's name, and pixels of a side of its image. */
const MAX_NAME = 200;
const MAX_SIDE = 2 ** 20;

/** A pinhole camera (OpenCV): K [9] in pixels and viewmat [16], world to camera, both row-major. */
export interface Camera {
  name: string;
  width: number;
  height: number;
  K: number[];
  viewmat: number[];
}

/** Distance within which static points are hidden, since those near a new viewpoint may only have looked well from afar. */
export interface Clearance {
  focus: Vec3;
  share: number;
}

/** A checked manifest. */
export interface Manifest extends Listing {
  /** Absolute. The URIs of files are relative to it. */
  url: string;
  /** True while groups are still being added. There may be none yet. */
  live: boolean;
  fps: number;
  frames: number;
  shDegree: number;
  bounds: [Vec3, Vec3];
  up: Vec3;
  /** Near plane, in world units. */
  near: number;
  /** Static points nearer than `share` of the depth of `focus` are not drawn. */
  clearance: Clearance;
  /** Background color: red, green and blue, 0 to 1. The light of a group scales it. */
  background: Vec3;
  /** True if the page is shown behind the points instead of the background. */
  transparent: boolean;
  /** True if splats thinner than a pixel are drawn fainter. */
  antialias: boolean;
  camera: Camera;
  cameras: Camera[];
  /** Texts, images, sound and limits. */
  presentation: Presentation;
  /** Files of a local reel; null for one on the network. */
  files: LocalFiles | null;
  /** How the files are requested; undefined for a public reel. */
  access?: Access | undefined;
}

/** Download and check a manifest. access: of a private reel. early: its text, already requested; null if that failed. Throws `ReelError` with the URL in its message. */
export async function loadManifest(
  url: string,
  watcher: Watcher,
  signal: AbortSignal,
  access?: Access,
  early?: Promise<string | null>,
): Promise<Manifest> {
  const text = (await early) ?? (await downloadText(url, watcher, signal, access));
  return { ...parseText(text, new URL(url, globalThis.location?.href).href), access };
}

/** Read and check the manifest of a local reel. Throws `ReelError`. */
export async function readManifest(files: LocalFiles): Promise<Manifest> {
  // A local copy does not grow.
  return { ...parseText(await files.manifest(), files.url), files, live: false };
}

function parseText(text: string, url: string): Manifest {
  let value: unknown;
  try {
    value = parseJson(text);
  } catch (error) {
    const why = error instanceof ReelError ? `: ${error.message}` : "";
    throw new ReelError(`${url} is not a reel's manifest: it is not JSON${why}.`, { plain: PLAIN.other });
  }
  return parseManifest(value, url);
}

/** Check the fields of a manifest. Unknown fields are ignored; an unknown version throws. */
export function parseManifest(value: unknown, url: string): Manifest {
  const json = record(value, "the manifest");
  if (json.format !== "splatreel")
    throw new ReelError(`${url} is not a reel: its format is ${JSON.stringify(json.format)}.`, { plain: PLAIN.other });
  if (json.version !== 1 && json.version !== 2) {
    throw new ReelError(
      `${url} is a reel of version ${JSON.stringify(json.version)}; this player knows versions 1 and 2.`,
      { plain: PLAIN.newer },
    );
  }
  const bounds = list(json.bounds, "bounds").map((corner) => numbers(corner, 3, "bounds") as Vec3);
  if (bounds.length !== 2) throw new ReelError(`${url}: bounds needs two corners.`);
  if (bounds[0].some((low, axis) => low > bounds[1][axis]))
    throw new ReelError("The manifest is damaged: the first corner of its bounds is above the second.");
  const renditions = parseNames(json.renditions);
  const second = json.version === 2;
  const { first_group: start = 0, pages: listed = [] } = second ? json : {};
  const first = whole(start, 0, LAST, "first_group");
  const pages = parsePages(listed, first, renditions);
  const begin = pages.reduce((number, { count }) => number + count, first);
  const own = list(json.groups, "groups");
  const live = flag(json.live, "live");
  if (own.length === 0 && (!live || pages.length > 0))
    throw new ReelError(`${url} holds no group yet.`, { plain: "This reel has no content yet." });
  const end = begin + own.length;
  const layers = second ? parseRetiringLayers(json.layers, begin, end) : parseLayers(json.layers, end);
  const groups = own.map((item, i) => parseGroup(item, begin + i, renditions, layers));
  const frames = Math.max(0, ...[...pages, ...groups].map((span) => span.firstFrame + span.frames));
  if (json.frames !== frames)
    throw new ReelError(
      `The manifest is damaged: it has ${JSON.stringify(json.frames)} frames, and its groups ${frames}.`,
    );
  if (pages.length > 0 && pages.at(-1)!.firstFrame >= groups[0].firstFrame)
    throw new ReelError("The manifest is damaged: its pages end after its groups begin.");
  checkOrder(groups);
  checkBytes(json.renditions, renditions, pages, groups);
  whole(json.group_length, 1, MAX_NUMBER, "group_length");
  if (json.origin !== undefined) numbers(json.origin, 3, "origin");
  return {
    url,
    live,
    fps: within(json.fps, 1e-3, 1e5, "fps"),
    frames,
    overlap: whole(json.overlap, 0, MAX_NUMBER, "overlap"),
    shDegree: whole(json.sh_degree, 0, 3, "sh_degree"),
    near: json.near === undefined ? 0.01 : within(json.near, 1e-30, 1e30, "near"),
    clearance:
      json.clearance === undefined
        ? { focus: [0, 0, 0], share: 0 }
        : parseClearance(record(json.clearance, "clearance")),
    background: json.background === undefined ? [0, 0, 0] : parseColor(json.background),
    transparent: flag(json.transparent, "transparent", false),
    antialias: flag(json.antialias, "antialias", false),
    bounds: bounds as [Vec3, Vec3],
    up: numbers(json.up, 3, "up") as Vec3,
    camera: parseCamera(json.camera),
    cameras: list(json.cameras, "cameras").map(parseCamera),
    layers,
    first,
    groups: numbered(groups),
    pages,
    renditions,
    presentation: parsePresentation(json),
    files: null,
  };
}

/** Return true if two manifests belong to the same reel, which may have grown. */
export function isSameReel(a: Manifest, b: Manifest | null): boolean {
  return a.url === b?.url && a.files === b.files;
}

/** Return true if two manifests name the same files with the same contents. */
export function hasSameFiles(a: Manifest, b: Manifest): boolean {
  const [one, other] = [a, b].map(({ layers, groups, pages, first }) => JSON.stringify([layers, groups, pages, first]));
  return one === other;
}

/** Return true if a file that both manifests name has other contents in the second. */
export function hasOtherContents(a: Manifest, b: Manifest): boolean {
  const [old, present] = [a, b].map(({ layers, groups }) => [...layers, ...Object.values(groups)]); // groups has gaps
  const known = new Map(old.map((file) => [file.uri, file]));
  return present.some(({ uri, sha256, bytes }) => {
    const before = known.get(uri);
    return before !== undefined && (before.sha256 !== sha256 || before.bytes !== bytes);
  });
}

/** Return the source of a file of a reel, for `download`. */
export function sourceOf({ url, files, access }: Manifest, { uri, bytes, sha256 }: Asset): Source {
  return { url: addressWithin(url, uri), bytes, sha256, part: files?.part(uri), access };
}

/** Return the address of an image of a reel. Where a page adds to requests, as `<img>` cannot, it is a `data:` address. */
export async function addressOf(manifest: Manifest, asset: Asset): Promise<string> {
  const { url, files, access } = manifest;
  if (files) return files.address(asset.uri);
  if (!access?.request) return addressWithin(url, asset.uri);
  const silent = { received: () => undefined, trouble: () => undefined };
  const bytes = await download(sourceOf(manifest, asset), silent, new AbortController().signal);
  const reader = new FileReader();
  reader.readAsDataURL(new Blob([bytes as BlobPart]));
  await new Promise((resolve) => (reader.onloadend = resolve));
  return reader.result as string;
}

function parseColor(value: unknown): Vec3 {
  const color = numbers(value, 3, "background");
  if (!color.every((part) => part >= 0 && part <= 1))
    throw new ReelError(`The manifest is damaged: its background is ${JSON.stringify(color)}.`);
  return color as Vec3;
}

function parseClearance(json: Json): Clearance {
  return {
    focus: numbers(json.focus, 3, "clearance focus") as Vec3,
    share: within(json.share, 0, 1, "clearance share"),
  };
}

function parseCamera(value: unknown): Camera {
  const json = record(value, "a camera");
  const K = numbers(json.K, 9, "camera K");
  if (!(K[0] > 0 && K[4] > 0))
    throw new ReelError(`The manifest is damaged: a camera has the focal lengths ${K[0]} and ${K[4]}.`);
  const viewmat = numbers(json.viewmat, 16, "camera viewmat");
  const [a, b, c, , d, e, f, , g, h, i] = viewmat;
  const volume = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
  if (!(volume > 0.5 && volume < 2))
    throw new ReelError("The manifest is damaged: the viewmat of a camera is not a rotation and translation.");
  const name = shortText(json, "name", MAX_NAME);
  return {
    name,
    width: whole(json.width, 1, MAX_SIDE, "camera width"),
    height: whole(json.height, 1, MAX_SIDE, "camera height"),
    K,
    viewmat,
  };
}
