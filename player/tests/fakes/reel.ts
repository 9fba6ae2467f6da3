/** Manifests of small reels. */
import { parseManifest, type Manifest } from "../../packages/decoder/src/reel/manifest";

export const ADDRESS = "https://page.example/reel/manifest.json";

export interface Plan {
  /** Groups of a second, ten frames each. */
  groups?: number;
  /** Groups at which layers are born, with those at which they are retired, if they are. */
  layers?: (number | [number, number])[];
  /** The number of the first group that there is; `groups` counts those before it. */
  first?: number;
  /** Groups of a page. At least one group, and less than these and one, are left to the manifest. */
  page?: number;
  /** Names of renditions, best first: each has half of the bytes and points of the one before. */
  renditions?: string[];
  live?: boolean;
  overlap?: number;
  /** Points of a group. */
  points?: number;
  /** Bytes of a layer. */
  layerBytes?: number;
}

/** The JSON of a manifest, of version 2 where it needs that. Group I is groups/I.bin, in other renditions groups/I.NAME.bin, of 1000 bytes; layer I is layers/I.bin of 500 if the plan says nothing else, the page from group I on pages/I.json. */
export function documentOf(plan: Plan = {}): Record<string, unknown> {
  const { groups = 5, renditions = [], live = false, overlap = 2, first = 0, page } = plan;
  const viewmat = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 4, 0, 0, 0, 1];
  const pages = page ? Math.floor((groups - first - 1) / page) : 0;
  const own = first + pages * (page ?? 0);
  const layers = layersOf(plan).filter(({ until }) => until === undefined || until > own);
  const second =
    first > 0 ||
    pages > 0 ||
    layersOf(plan).some(({ group, until }, i, all) => until !== undefined || group === all[i - 1]?.group);
  const paged = Array.from({ length: pages }, (_, i) => ({
    uri: `pages/${first + i * page!}.json`,
    bytes: 200,
    sha256: "0".repeat(64),
    groups: page,
    first_frame: 10 * (first + i * page!),
    frames: 10 * page!,
    rendition_bytes: bytesOf(renditions, page!),
  }));
  return {
    format: "splatreel",
    version: second ? 2 : 1,
    ...(first > 0 ? { first_group: first } : {}),
    ...(pages > 0 ? { pages: paged } : {}),
    live,
    fps: 10,
    frames: 10 * groups,
    group_length: 10,
    overlap,
    sh_degree: 0,
    bounds: [
      [-1, -1, -1],
      [1, 1, 1],
    ],
    up: [0, -1, 0],
    camera: { name: "start", width: 160, height: 90, K: [100, 0, 80, 0, 100, 45, 0, 0, 1], viewmat },
    cameras: [],
    layers,
    renditions: Object.entries(bytesOf(renditions, groups - first)).map(([name, bytes]) => ({ name, bytes })),
    groups: groupsOf(plan, own, groups),
  };
}

/** The JSON of a page, by its uri. */
export function pageAt(plan: Plan, uri: string): Record<string, unknown> {
  const begin = Number(/\d+/.exec(uri));
  const end = begin + plan.page!;
  return {
    layers: layersOf(plan).filter(({ group, until }) => until !== undefined && group < end && until > begin),
    groups: groupsOf(plan, begin, end),
  };
}

/** The numbers of the layers that live at a group. */
export function livingAt(plan: Plan, at: number): number[] {
  return layersOf(plan).flatMap(({ group, until = Infinity }, index) => (group <= at && at < until ? [index] : []));
}

/** The group at which a layer is born, by the number of its file. */
export function birthOf(plan: Plan, index: number): number {
  return layersOf(plan)[index]!.group;
}

/** What is decoded of the file of a layer or group, without the points. */
export function fileAt(plan: Plan, uri: string): object {
  const number = Number(/\d+/.exec(uri));
  const points = { count: (plan.points ?? 100) * shareOf(plan, uri), shDegree: 0 };
  if (uri.startsWith("layers"))
    return { kind: "layer", index: birthOf(plan, number), firstFrame: 10 * birthOf(plan, number), frames: 0, points };
  const alive = new Uint8Array((plan.points ?? 100) * livingAt(plan, number).length);
  return {
    kind: "group",
    index: number,
    firstFrame: 10 * number,
    frames: 10,
    points,
    alive,
    offsets: null,
    light: null,
  };
}

/** The share of the points that a group's file holds, which depends on its rendition. */
export function shareOf({ renditions = [] }: Plan, uri: string): number {
  return (
    0.5 **
    Math.max(
      renditions.findIndex((name) => uri.includes(`.${name}.`)),
      0,
    )
  );
}

function layersOf(plan: Plan): { group: number; until?: number }[] {
  return (plan.layers ?? [0]).map((layer, index) => {
    const [group = 0, until] = [layer].flat();
    return {
      ...fileOf(plan, `layers/${index}.bin`, plan.layerBytes ?? 500),
      group,
      first_frame: 10 * group,
      ...(until === undefined ? {} : { until }),
    };
  });
}

function groupsOf(plan: Plan, begin: number, end: number): object[] {
  const others = (index: number) =>
    (plan.renditions ?? [])
      .slice(1)
      .map((name, i) => [name, fileOf(plan, `groups/${index}.${name}.bin`, 1000, 0.5 ** (i + 1))]);
  return Array.from({ length: end - begin }, (_, i) => i + begin).map((index) => ({
    ...fileOf(plan, `groups/${index}.bin`, 1000),
    first_frame: 10 * index,
    frames: 10,
    renditions: Object.fromEntries(others(index)),
  }));
}

function fileOf({ points = 100 }: Plan, uri: string, bytes: number, part = 1): object {
  return { uri, bytes: bytes * part, sha256: "0".repeat(64), points: points * part };
}

/** The bytes of so many groups in each rendition. */
function bytesOf(names: string[], groups: number): Record<string, number> {
  return Object.fromEntries(names.map((name, i) => [name, 1000 * 0.5 ** i * groups]));
}

export function manifestOf(plan: Plan = {}): Manifest {
  return parseManifest(documentOf(plan), ADDRESS);
}
