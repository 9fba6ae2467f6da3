/** What belongs to the reel that is open: its workers, its stage, and the stream of its files. */
import { Stage } from "../draw/stage";
import { EMBEDDED, embeddedReel } from "../files/embedded";
import type { LocalFiles } from "../files/local-files";
import { hasSameFiles, loadManifest, readManifest, type Manifest } from "../reel/manifest";
import { withKnown, withPage, type Page } from "../reel/pages";
import { DecoderPool } from "../stream/decoder-pool";
import { memoryBudget } from "../stream/file-cache";
import { freshManifest, nextManifest, watchManifest } from "../stream/live-manifest";
import { RenditionPolicy, guessOfBrowser } from "../stream/rendition-policy";
import { Stream } from "../stream/stream";

/** Milliseconds to wait for a manifest that may explain why a file is not what it should be. */
const PATIENCE = 8000;

export interface SessionEvents {
  /** A file was taken in. */
  arrived(): void;
  /** A live reel has other groups, or is whole. */
  grown(manifest: Manifest): void;
  /** More is known of the reel's groups. `arrived` follows. */
  known(manifest: Manifest): void;
  /** The reel's host has another one by now. */
  replaced(): void;
  /** Something came, went or is late. */
  progress(): void;
  failed(error: unknown): void;
}

export class Session {
  readonly stage: Stage;
  readonly decoders: DecoderPool;
  stream: Stream | null = null;
  /** Why there is no reel yet, for people. */
  trouble: string | null = null;
  /** Nothing is taken in any more. */
  private abandoned = false;
  private manifest: Manifest | null = null;
  private readonly life = new AbortController();

  /** Workers start and shaders compile at once, while the manifest is on its way. worker: one that decodes, already started. Throws `ReelError` where there is no WebGL 2. */
  constructor(canvas: HTMLCanvasElement, private readonly events: SessionEvents, worker?: Worker | null) {
    this.stage = new Stage(canvas, (error) => events.failed(error));
    this.decoders = new DecoderPool(worker);
  }

  get closed(): boolean {
    return this.life.signal.aborted;
  }

  /** A reel's manifest; of a live one, once it has a group. early: its text, already asked for; null: in vain. */
  async findManifest(source: string | LocalFiles, early?: Promise<string | null>): Promise<Manifest> {
    const { signal } = this.life;
    if (typeof source !== "string") return readManifest(source);
    if (source === EMBEDDED) return readManifest(embeddedReel());
    let manifest = await loadManifest(source, { received: () => undefined, trouble: (why) => this.wait(why) }, signal, early);
    while (manifest.groups.length === 0) {
      this.wait("Live. The first group is not here yet.");
      manifest = await nextManifest(manifest, signal);
    }
    this.trouble = null;
    return manifest;
  }

  /** Begin to get the reel's files. */
  open(manifest: Manifest): void {
    const { stage, decoders, events } = this;
    this.manifest = manifest;
    stage.open(manifest);
    this.stream = new Stream(manifest, decoders, memoryBudget(), {
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

  /** Take nothing in any more: the reel has an error. */
  abandon(): void {
    this.abandoned = true;
  }

  close(): void {
    this.life.abort();
    this.manifest?.files?.close();
    this.decoders.destroy();
    this.stage.destroy();
  }

  /** A file is not what the manifest says: read the manifest again. True if the reel was replaced, and is opened anew. */
  private async isOutdated(manifest: Manifest): Promise<boolean> {
    if (manifest.files || this.stage.lost) return false;
    const late = new Promise<null>((resolve) => setTimeout(() => resolve(null), PATIENCE));
    const next = await Promise.race([freshManifest(manifest, this.life.signal), late]);
    if (!next || this.closed) return false;
    if (manifest.live) this.grow(next);
    const replaced = !manifest.live && !hasSameFiles(manifest, next);
    if (replaced) this.events.replaced();
    return replaced;
  }

  /** The manifest of a live reel was read again. */
  private grow(next: Manifest): void {
    const before = this.manifest!;
    // An answer that was long under way may be older than what is known.
    const older = next.live && (next.groups.length < before.groups.length || next.first < before.first);
    if (this.closed || !before.live || older) return;
    this.use(withKnown(next, before));
    this.events.grown(this.manifest!);
  }

  private addPage(page: Page, json: unknown): void {
    const { manifest } = this;
    if (!manifest?.pages.some(({ uri }) => uri === page.uri)) return; // it was dropped meanwhile
    this.use(withPage(manifest, page, json));
    this.events.known(this.manifest!);
  }

  private use(manifest: Manifest): void {
    this.manifest = manifest;
    this.stage.update(manifest);
    this.stream?.update(manifest);
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
