/** Pages: files that list groups of a long reel, downloaded when one of the groups is needed. */
import { ReelError, messageOf } from "../base/errors";
import { MAX_NUMBER, list, record, whole, within } from "./json";
import { parseAsset, type Asset } from "./presentation";
import { bytesOf, parseGroup, parseRetiringLayers, type ReelFile } from "./reel-file";
import type { PageSpan, Schedule } from "./timeline";

/** Maximum groups of a page and of all pages, number of pages, and bytes of a page and of all pages. */
const MAX_GROUPS_PER_PAGE = 1024;
const MAX_GROUPS = 2 ** 20;
const MAX_PAGES = 2 ** 14;
const MAX_BYTES = 2 ** 20;
const MAX_BYTES_OF_ALL = 2 ** 26;
/** Maximum number of a frame or group. */
export const LAST = 2 ** 31;

/** A page as the manifest lists it. */
export interface Page extends Asset, PageSpan {
  /** Bytes of its groups in each rendition; empty if there is no choice. */
  renditionBytes: number[];
}

/** The files of a manifest. */
export interface Listing extends Schedule {
  /** Layers in order of birth: all that are never retired, and those that live at groups outside of pages. */
  layers: ReelFile[];
  groups: ReelFile[];
  /** Pages of the groups before those that the manifest lists itself. */
  pages: Page[];
  /** Names of the renditions, best first; the first is that of the groups' own files. Empty if there is no choice. */
  renditions: string[];
}

/** Parse the pages of a manifest. first: number of its first group. names: of the renditions. */
export function parsePages(value: unknown, first: number, names: string[]): Page[] {
  let [group, begin, bytes] = [first, 0, 0];
  const pages = list(value, "pages").map((item) => {
    const json = record(item, "a page");
    const count = whole(json.groups, 1, MAX_GROUPS_PER_PAGE, "groups of a page");
    const firstFrame = whole(json.first_frame, begin, LAST, "first_frame of a page");
    const { rendition_bytes: sizes = {} } = json;
    const renditionBytes = names.map((name) =>
      whole(record(sizes, "rendition_bytes")[name], 1, MAX_NUMBER, "rendition_bytes"),
    );
    const page = {
      ...parseAsset(json, MAX_BYTES),
      group,
      count,
      firstFrame,
      frames: whole(json.frames, 1, LAST, "frames of a page"),
      renditionBytes,
    };
    [group, begin, bytes] = [group + count, firstFrame + 1, bytes + page.bytes];
    return page;
  });
  within(pages.length, 0, MAX_PAGES, "the number of its pages");
  within(group - first, 0, MAX_GROUPS, "groups of all pages");
  within(bytes, 0, MAX_BYTES_OF_ALL, "bytes of all pages");
  return pages;
}

/** Return a manifest with the groups of a page added. value: JSON of the page. Throws `ReelError` that names the page. */
export function withPage<L extends Listing>(manifest: L, page: Page, value: unknown): L {
  try {
    return { ...manifest, groups: numbered(groupsOf(manifest, page, value), manifest.groups) };
  } catch (error) {
    throw new ReelError(`${page.uri} cannot be used. ${messageOf(error)}`, { cause: error });
  }
}

/** Return a newly read manifest with the page groups that an earlier one already had. */
export function withKnown<L extends Listing>(next: L, { groups }: Listing): L {
  const known = next.pages.map(({ group, count }) => groups.slice(group, group + count).filter(Boolean));
  return {
    ...next,
    groups: numbered(known.filter((some, i) => some.length === next.pages[i].count).flat(), next.groups),
  };
}

/** Return a sparse list of groups, indexed by their numbers. others: list to extend. */
export function numbered(groups: ReelFile[], others: ReelFile[] = []): ReelFile[] {
  return Object.assign([], others, Object.fromEntries(groups.map((group) => [group.group, group])));
}

function groupsOf({ layers, renditions, groups: others }: Listing, page: Page, value: unknown): ReelFile[] {
  const json = record(value, "it");
  const retiring = parseRetiringLayers(json.layers, page.group, page.group + page.count);
  checkLayers(retiring, [layers, ...Object.values(others).map((group) => group.layers)]);
  // Permanent layers come from the manifest, retired ones from the page. The stable sort keeps permanent ones first.
  const all = [...layers.filter(({ until }) => until === Infinity), ...retiring].sort((a, b) => a.group - b.group);
  const groups = list(json.groups, "groups").map((item, i) => parseGroup(item, page.group + i, renditions, all));
  checkOrder(
    [others[page.group - 1], ...groups, others[page.group + page.count]].filter((group) => group !== undefined),
  );
  const end = Math.max(...groups.map(({ firstFrame, frames }) => firstFrame + frames));
  const found = [groups.length, groups[0]?.firstFrame, end, ...bytesOf(renditions, groups)].join(", ");
  const told = [page.count, page.firstFrame, page.firstFrame + page.frames, ...page.renditionBytes].join(", ");
  if (found !== told)
    throw new ReelError(
      `Its groups, their first frame, their end and their bytes are ${found}; the manifest says ${told}.`,
    );
  return groups;
}

/** Compare the layers of a page, all of which must be retired, with what other lists say of the same layers. */
function checkLayers(retiring: ReelFile[], lists: ReelFile[][]): void {
  const known = new Map([...new Set(lists)].flat().map((layer) => [layer.uri, JSON.stringify(layer)]));
  for (const layer of retiring) {
    if (layer.until === Infinity) throw new ReelError(`The page lists ${layer.uri}, which is never retired.`);
    if ((known.get(layer.uri) ?? JSON.stringify(layer)) !== JSON.stringify(layer))
      throw new ReelError(`Two lists of layers say different things of ${layer.uri}.`);
  }
}

/** Check that groups are in order of time, without a gap. */
export function checkOrder(groups: ReelFile[]): void {
  for (const [index, { uri, firstFrame }] of groups.entries()) {
    const before = groups[index - 1];
    if (before && (firstFrame <= before.firstFrame || firstFrame > before.firstFrame + before.frames)) {
      throw new ReelError(
        `The manifest is damaged: ${uri} begins at frame ${firstFrame}, and the group before it lasts from ${before.firstFrame} to ${before.firstFrame + before.frames}.`,
      );
    }
  }
}
