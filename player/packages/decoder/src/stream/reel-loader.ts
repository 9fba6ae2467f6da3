/** Loads one reel: its manifest, which may grow, its pages, and the files that playback needs. */
import { hasOtherContents, hasSameFiles, loadManifest, type Manifest, readManifest } from "../reel/manifest";
import type { DecodedGroup, DecodedLayer } from "../decode/decode-file";
import type { LocalFiles } from "../files/local-files";
import type { Access } from "../files/source";
import type { Page } from "../reel/pages";
import type { Reel } from "../reel/reel";
import { DecoderPool, type DecodeWorkers, type EarlyWorker } from "./decoder-pool";
import { type Dropped, memoryBudget } from "./file-cache";
import { guessOfBrowser, RenditionPolicy } from "./rendition-policy";
import { Stream } from "./stream";

/** Milliseconds between two requests. */
const POLL = 3000;

/** Wait until a reel has new groups, has dropped or replaced some, or is complete, and return its manifest. Failed requests are repeated. */
async function nextManifest(manifest: Manifest, signal: AbortSignal): Promise<Manifest> {
  for (;;) {
    await new Promise((resolve) => setTimeout(resolve, POLL));
    const next = await freshManifest(manifest, signal);
    signal.throwIfAborted();
    if (!next) continue;
    if (
      next.groups.length > manifest.groups.length ||
      next.first > manifest.first ||
      !next.live ||
      hasOtherContents(manifest, next)
    )
      return next;
  }
}

/** Request the manifest; null if that fails. */
function freshManifest({ url, access }: Manifest, signal: AbortSignal): Promise<Manifest | null> {
  return loadManifest(url, { received: () => undefined, trouble: () => undefined }, signal, access).catch(() => null);
}

/** Call `grown` with each new manifest of a live reel, until the reel is complete. */
async function watchManifest(manifest: Manifest, grown: (next: Manifest) => void, signal: AbortSignal): Promise<void> {
  let known = manifest;
  while (known.live) {
    const next = await nextManifest(known, signal).catch(() => null);
    if (next === null) return;
    known = next;
    grown(next);
  }
}

/** Milliseconds to wait for a new manifest after a file turned out to be missing or different. */
const MANIFEST_TIMEOUT = 8000;

/** Events of an open reel. */
export interface LoaderEvents {
  /** A file was decoded, or a page was added to the manifest. */
  arrived(): void;
  /** A live reel has new groups, or is complete. */
  grown(): void;
  /** The host has replaced the reel. */
  replaced(): void;
  /** Bytes arrived, files were dropped, or something is late. */
  progress(): void;
  /** Playback cannot go on. */
  failed(error: unknown): void;
}

/** Receives decoded files, and forgets dropped ones. */
export interface FileReceiver {
  addLayer(uri: string, file: DecodedLayer): void;
  /** layers: URIs of the layers that live at the group. */
  addGroup(index: number, file: DecodedGroup, layers: string[]): void;
  dropLayer(uri: string): void;
  dropGroup(index: number): void;
  /** True after the receiver has failed for a reason of its own, such as a lost graphics device. */
  readonly lost: boolean;
}

/** Opens one reel and closes it again. */
export class ReelLoader {
  readonly decoders: DecoderPool;
  stream: Stream | null = null;
  /** Reason for waiting for the manifest, to show to people; null if there is none. */
  trouble: string | null = null;
  /** True after an error: further files are ignored. */
  private abandoned = false;
  private reel: Reel | null = null;
  private readonly life = new AbortController();

  /** Start the first worker at once, while the manifest downloads. early: a decode worker that is already running. */
  constructor(
    private readonly receiver: FileReceiver,
    private readonly events: LoaderEvents,
    workers: DecodeWorkers,
    early?: EarlyWorker | null,
  ) {
    this.decoders = new DecoderPool(workers, early);
  }

  get closed(): boolean {
    return this.life.signal.aborted;
  }

  /** Read the manifest of a reel; of a live one, wait for its first group. access: of a private reel. early: text of the manifest, already requested; null if that failed. */
  async findManifest(source: string | LocalFiles, access?: Access, early?: Promise<string | null>): Promise<Manifest> {
    const { signal } = this.life;
    if (typeof source !== "string") return readManifest(source);
    const isPrivate = access?.request || access?.credentials;
    let manifest = await loadManifest(
      source,
      { received: () => undefined, trouble: (why) => this.wait(why) },
      signal,
      isPrivate ? access : undefined,
      early,
    );
    while (manifest.groups.length === 0) {
      this.wait("Live. Waiting for the first group.");
      manifest = await nextManifest(manifest, signal);
    }
    this.trouble = null;
    return manifest;
  }

  /** Begin to download the files of a reel. */
  open(reel: Reel): void {
    const { receiver, decoders, events } = this;
    const { manifest } = reel;
    this.reel = reel;
    this.stream = new Stream(
      reel,
      decoders,
      memoryBudget(),
      {
        layer: (uri, file) => this.take(() => receiver.addLayer(uri, file)),
        group: (index, file, layers) => this.take(() => receiver.addGroup(index, file, layers)),
        page: (page, json) => this.take(() => this.addPage(page, json)),
        dropped: (dropped) => this.drop(dropped),
        outdated: () => this.isOutdated(manifest),
        progress: () => events.progress(),
        failed: (error) => void (!this.closed && events.failed(error)),
      },
      new RenditionPolicy(guessOfBrowser()),
    );
    void watchManifest(manifest, (next) => this.grow(next), this.life.signal);
  }

  /** Request no further files and ignore those that still arrive, after an error. */
  abandon(): void {
    this.abandoned = true;
    this.stream?.stop();
  }

  close(): void {
    this.life.abort();
    this.reel?.manifest.files?.close();
    this.decoders.destroy();
  }

  /** Read the manifest again after a file did not match it. Resolves to true if the reel was replaced, which reopens it. */
  private async isOutdated(manifest: Manifest): Promise<boolean> {
    if (manifest.files || this.receiver.lost) return false;
    const late = new Promise<null>((resolve) => setTimeout(() => resolve(null), MANIFEST_TIMEOUT));
    const next = await Promise.race([freshManifest(manifest, this.life.signal), late]);
    if (!next || this.closed) return false;
    if (manifest.live) return this.grow(next);
    const replaced = !manifest.live && !hasSameFiles(manifest, next);
    if (replaced) this.events.replaced();
    return replaced;
  }

  /** Take a newer manifest of a live reel. Returns true if the reel was replaced, as the preview of a keyframe is, which reopens it. */
  private grow(next: Manifest): boolean {
    if (this.closed) return false;
    if (hasOtherContents(this.reel!.manifest, next)) {
      this.events.replaced();
      return true;
    }
    if (!this.reel!.grow(next)) return false;
    this.stream?.refresh();
    this.events.grown();
    return false;
  }

  private addPage(page: Page, json: unknown): void {
    if (this.reel!.addPage(page, json)) this.stream?.refresh();
  }

  private drop({ groups, layers }: Dropped): void {
    for (const index of groups) this.receiver.dropGroup(index);
    for (const uri of layers) this.receiver.dropLayer(uri);
    this.events.progress();
  }

  private take(add: () => void): void {
    if (this.abandoned || this.closed) return; // a worker may have answered before it ended
    try {
      add();
    } catch (error) {
      return this.events.failed(error);
    }
    this.events.arrived();
  }

  private wait(why: string): void {
    this.trouble = why;
    this.events.progress();
  }
}
