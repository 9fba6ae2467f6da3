/** Resources of the open reel: its workers, its stage, and the stream of its files. */
import type { Renderer } from "../draw/renderer";
import { Stage } from "../draw/stage";
import { EMBEDDED, embeddedReel } from "../files/embedded";
import type { LocalFiles } from "../files/local-files";
import { hasSameFiles, loadManifest, readManifest, type Manifest } from "../reel/manifest";
import type { Page } from "../reel/pages";
import type { Reel } from "../reel/reel";
import { DecoderPool } from "../stream/decoder-pool";
import { memoryBudget } from "../stream/file-cache";
import { freshManifest, nextManifest, watchManifest } from "../stream/live-manifest";
import { RenditionPolicy, guessOfBrowser } from "../stream/rendition-policy";
import { Stream } from "../stream/stream";

/** Milliseconds to wait for a new manifest after a file turned out to be missing or different. */
const MANIFEST_TIMEOUT = 8000;

/** Events of a session. */
export interface SessionEvents {
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

/** Opens one reel and closes it again. */
export class Session {
  readonly stage: Stage;
  readonly decoders: DecoderPool;
  stream: Stream | null = null;
  /** Reason for waiting for the manifest, to show to people; null if there is none. */
  trouble: string | null = null;
  /** True after an error: further files are ignored. */
  private abandoned = false;
  private reel: Reel | null = null;
  private readonly life = new AbortController();

  /** Start the workers at once, while the manifest downloads. worker: a decode worker that is already running. */
  constructor(renderer: Renderer, private readonly events: SessionEvents, worker?: Worker | null) {
    this.stage = new Stage(renderer, (error) => events.failed(error));
    this.decoders = new DecoderPool(worker);
  }

  get closed(): boolean {
    return this.life.signal.aborted;
  }

  /** Read the manifest of a reel; of a live one, wait for its first group. early: text of the manifest, already requested; null if that failed. */
  async findManifest(source: string | LocalFiles, early?: Promise<string | null>): Promise<Manifest> {
    const { signal } = this.life;
    if (typeof source !== "string") return readManifest(source);
    if (source === EMBEDDED) return readManifest(embeddedReel());
    let manifest = await loadManifest(source, { received: () => undefined, trouble: (why) => this.wait(why) }, signal, early);
    while (manifest.groups.length === 0) {
      this.wait("Live. Waiting for the first group.");
      manifest = await nextManifest(manifest, signal);
    }
    this.trouble = null;
    return manifest;
  }

  /** Begin to download the files of a reel. */
  open(reel: Reel): void {
    const { stage, decoders, events } = this;
    const { manifest } = reel;
    this.reel = reel;
    stage.open(reel);
    this.stream = new Stream(reel, decoders, memoryBudget(), {
      layer: (uri, file) => this.take(() => stage.addLayer(uri, file)),
      group: (index, file, layers) => this.take(() => stage.addGroup(index, file, layers)),
      page: (page, json) => this.take(() => this.addPage(page, json)),
      dropped: ({ groups, layers }) => {
        for (const index of groups) stage.dropGroup(index);
        for (const uri of layers) stage.dropLayer(uri);
        events.progress();
      },
      outdated: () => this.isOutdated(manifest),
      progress: () => events.progress(),
      failed: (error) => void (!this.closed && events.failed(error)),
    }, new RenditionPolicy(guessOfBrowser()));
    void watchManifest(manifest, (next) => this.grow(next), this.life.signal);
  }

  /** Ignore files that still arrive, after an error. */
  abandon(): void {
    this.abandoned = true;
  }

  close(): void {
    this.life.abort();
    this.reel?.manifest.files?.close();
    this.decoders.destroy();
    this.stage.destroy();
  }

  /** Read the manifest again after a file did not match it. Resolves to true if the reel was replaced, which reopens it. */
  private async isOutdated(manifest: Manifest): Promise<boolean> {
    if (manifest.files || this.stage.lost) return false;
    const late = new Promise<null>((resolve) => setTimeout(() => resolve(null), MANIFEST_TIMEOUT));
    const next = await Promise.race([freshManifest(manifest, this.life.signal), late]);
    if (!next || this.closed) return false;
    if (manifest.live) this.grow(next);
    const replaced = !manifest.live && !hasSameFiles(manifest, next);
    if (replaced) this.events.replaced();
    return replaced;
  }

  private grow(next: Manifest): void {
    if (this.closed || !this.reel!.grow(next)) return;
    this.stream?.refresh();
    this.events.grown();
  }

  private addPage(page: Page, json: unknown): void {
    if (this.reel!.addPage(page, json)) this.stream?.refresh();
  }

  private take(add: () => void): void {
    if (this.abandoned) return;
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
