/** Pages: the groups of a long reel that its manifest does not list itself, in files that are got when one of them is needed. */
import { ReelError, messageOf } from "../base/errors";
import { list, record, whole, within } from "./json";
import { parseAsset, type Asset } from "./presentation";
import { parseGroup, parsePassingLayers, type ReelFile } from "./reel-file";
import type { PageSpan, Schedule } from "./timeline";

/** Most groups of a page, and of all; most pages, and bytes of one and of all. */
const MOST_OF_A_PAGE = 1024;
const MOST_GROUPS = 2 ** 20;
const MOST_PAGES = 2 ** 14;
const MOST_BYTES = 2 ** 20;
const MOST_BYTES_OF_ALL = 2 ** 26;
/** The last frame, and the last group, that there may be. */
export const LAST = 2 ** 31;

export interface Page extends Asset, PageSpan {}

/** The files of a manifest. */
export interface Listing extends Schedule {
  /** All that are never retired, and others that live at the groups which are in no page; in order of birth. */
  layers: ReelFile[];
  groups: ReelFile[];
  /** The groups before those that the manifest lists itself. */
  pages: Page[];
  /** Names of the rates that the groups are there in, best first; the first is that of the groups' own files. Layers are common to all. Empty where there is nothing to choose. */
  renditions: string[];
}

/** Of a manifest, whose first group has this number. */
export function parsePages(value: unknown, first: number): Page[] {
  let [group, begin, bytes] = [first, 0, 0];
  const pages = list(value, "pages").map((item) => {
    const json = record(item, "a page");
    const count = whole(json.groups, 1, MOST_OF_A_PAGE, "groups of a page");
    const firstFrame = whole(json.first_frame, begin, LAST, "first_frame of a page");
    const page = { ...parseAsset(json, MOST_BYTES), group, count, firstFrame, frames: whole(json.frames, 1, LAST, "frames of a page") };
    [group, begin, bytes] = [group + count, firstFrame + 1, bytes + page.bytes];
    return page;
  });
  within(pages.length, 0, MOST_PAGES, "the number of its pages");
  within(group - first, 0, MOST_GROUPS, "groups of all pages");
  within(bytes, 0, MOST_BYTES_OF_ALL, "bytes of all pages");
  return pages;
}

/** A manifest with the groups of a page, whose JSON this is. Throws `ReelError` that names the page. */
export function withPage<L extends Listing>(manifest: L, page: Page, value: unknown): L {
  try {
    return { ...manifest, groups: numbered(groupsOf(manifest, page, value), manifest.groups) };
  } catch (error) {
    throw new ReelError(`${page.uri} cannot be used. ${messageOf(error)}`, { cause: error });
  }
}

/** A manifest that was read anew, with the groups of its pages that an earlier one of the same reel had. */
export function withKnown<L extends Listing>(next: L, { groups }: Listing): L {
  const known = next.pages.map(({ group, count }) => groups.slice(group, group + count).filter(Boolean));
  return { ...next, groups: numbered(known.filter((some, i) => some.length === next.pages[i].count).flat(), next.groups) };
}

/** A list of groups by their numbers, with others. There may be many that are missing. */
export function numbered(groups: ReelFile[], others: ReelFile[] = []): ReelFile[] {
  return Object.assign([], others, Object.fromEntries(groups.map((group) => [group.group, group])));
}

function groupsOf({ layers, renditions }: Listing, page: Page, value: unknown): ReelFile[] {
  const json = record(value, "it");
  const passing = parsePassingLayers(json.layers, page.group, page.group + page.count);
  // Layers that are never retired are the manifest's alone; it may list others, which are the page's as well. Sorting keeps the former first.
  const all = [...layers, ...passing].filter((layer, i) => (i < layers.length) === (layer.until === Infinity)).sort((a, b) => a.group - b.group);
  const groups = list(json.groups, "groups").map((item, i) => parseGroup(item, page.group + i, renditions, all));
  const end = Math.max(...groups.map(({ firstFrame, frames }) => firstFrame + frames));
  const found = [groups.length, groups[0]?.firstFrame, end].join(", ");
  const told = [page.count, page.firstFrame, page.firstFrame + page.frames].join(", ");
  if (found !== told) throw new ReelError(`Its groups, their first frame and their end are ${found}; the manifest says ${told}.`);
  return groups;
}
