/** The open reel: the only owner of its manifest. */
import type { Manifest } from "./manifest";
import { withKnown, withPage, type Page } from "./pages";

/** Holds the manifest, which grows as pages arrive and while a reel is live. All other objects read it here. */
export class Reel {
  /** manifest: as first read. */
  constructor(private current: Manifest) {}

  get manifest(): Manifest {
    return this.current;
  }

  /** Take a newer manifest of a live reel. Returns false if `next` is older than the present one, as a delayed response may be. */
  grow(next: Manifest): boolean {
    const { current } = this;
    const older = next.live && (next.groups.length < current.groups.length || next.first < current.first);
    if (!current.live || older) return false;
    this.current = withKnown(next, current);
    return true;
  }

  /** Add the groups of a page. Returns false if the manifest no longer lists the page. Throws `ReelError` if the page is damaged. */
  addPage(page: Page, json: unknown): boolean {
    if (!this.current.pages.some(({ uri }) => uri === page.uri)) return false;
    this.current = withPage(this.current, page, json);
    return true;
  }
}
