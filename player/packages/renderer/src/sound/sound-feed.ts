/** Feeds sound segments to an audio element: by MediaSource, or as one file in memory if the browser lacks it. */
import { ReelError, type SoundSegment } from "@splatreel/decoder/internal";

/** Destination of sound segments. */
export interface SoundFeed {
  /** True if all segments must be loaded before playback. */
  readonly whole: boolean;
  /** True if the loaded segments can be played. */
  readonly ready: boolean;
  holds(segment: SoundSegment): boolean;
  /** Load the head of the stream, once. */
  begin(head: () => Promise<Uint8Array>): Promise<void>;
  add(segment: SoundSegment, bytes: Uint8Array): Promise<void>;
  drop(segment: SoundSegment): Promise<void>;
  /** End the stream after the last segment. */
  end(): void;
  close(): void;
}

/** Return the feed that the browser supports. renewed: called when the element restarts. Throws `ReelError` if it cannot play this type. */
export function feedOf(audio: HTMLAudioElement, type: string, live: boolean, renewed: () => void): SoundFeed {
  // iPhones have only ManagedMediaSource.
  const { ManagedMediaSource } = globalThis as { ManagedMediaSource?: typeof MediaSource };
  const Source = globalThis.MediaSource ?? ManagedMediaSource;
  if (Source?.isTypeSupported(type)) return new SourceFeed(audio, new Source(), type);
  if (live) throw new ReelError("This browser plays the sound of a live reel only once the reel is complete.");
  if (audio.canPlayType(type)) return new FileFeed(audio, type, renewed);
  throw new ReelError(`This browser does not play sound of the type ${type}.`);
}

class SourceFeed implements SoundFeed {
  readonly whole = false;
  readonly ready = true;
  private readonly url: string;
  private readonly opened: Promise<unknown>;
  private buffer: SourceBuffer | null = null;

  constructor(
    private readonly audio: HTMLAudioElement,
    private readonly source: MediaSource,
    private readonly type: string,
  ) {
    this.url = URL.createObjectURL(source);
    this.opened = new Promise((resolve) => source.addEventListener("sourceopen", resolve, { once: true }));
    audio.disableRemotePlayback = true; // ManagedMediaSource requires this
    audio.src = this.url;
  }

  holds({ start, seconds }: SoundSegment): boolean {
    const middle = start + seconds / 2;
    const ranges = this.buffer?.buffered;
    for (let i = 0; i < (ranges?.length ?? 0); i++)
      if (ranges!.start(i) <= middle && middle < ranges!.end(i)) return true;
    return false;
  }

  async begin(head: () => Promise<Uint8Array>): Promise<void> {
    if (this.buffer) return;
    const bytes = await head();
    await this.opened;
    this.buffer = this.source.addSourceBuffer(this.type);
    await this.change((buffer) => buffer.appendBuffer(bytes as BufferSource));
  }

  async add(segment: SoundSegment, bytes: Uint8Array): Promise<void> {
    await this.change((buffer) => buffer.appendBuffer(bytes as BufferSource));
    if (!this.holds(segment)) throw new ReelError(`${segment.uri} does not hold the sound from ${segment.start} s on.`);
  }

  async drop({ start, seconds }: SoundSegment): Promise<void> {
    await this.change((buffer) => buffer.remove(start, start + seconds));
  }

  end(): void {
    if (this.source.readyState === "open") this.source.endOfStream();
  }

  close(): void {
    leave(this.audio, this.url);
  }

  private change(act: (buffer: SourceBuffer) => void): Promise<void> {
    const buffer = this.buffer!;
    return new Promise((resolve, reject) => {
      buffer.onupdateend = () => resolve();
      buffer.onerror = () => reject(new ReelError("The sound is damaged: the browser cannot read it."));
      act(buffer);
    });
  }
}

class FileFeed implements SoundFeed {
  readonly whole = true;
  private readonly parts: Uint8Array[] = [];
  private readonly held = new Set<string>();
  private url = "";

  constructor(
    private readonly audio: HTMLAudioElement,
    private readonly type: string,
    private readonly renewed: () => void,
  ) {}

  get ready(): boolean {
    return this.url !== "";
  }

  holds({ uri }: SoundSegment): boolean {
    return this.held.has(uri);
  }

  async begin(head: () => Promise<Uint8Array>): Promise<void> {
    if (this.parts.length === 0) this.parts.push(await head());
  }

  add({ uri }: SoundSegment, bytes: Uint8Array): Promise<void> {
    this.parts.push(bytes);
    this.held.add(uri);
    return Promise.resolve();
  }

  drop(): Promise<void> {
    return Promise.resolve();
  }

  end(): void {
    leave(this.audio, this.url);
    this.url = URL.createObjectURL(new Blob(this.parts as BlobPart[], { type: this.type }));
    this.audio.src = this.url;
    this.renewed();
  }

  close(): void {
    leave(this.audio, this.url);
  }
}

function leave(audio: HTMLAudioElement, url: string): void {
  audio.removeAttribute("src");
  audio.load();
  URL.revokeObjectURL(url);
}
