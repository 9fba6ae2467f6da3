/** Downloads the sound of a reel by segments and feeds it to an audio element. */
import {
  type Asset,
  download,
  type Manifest,
  messageOf,
  PLAIN,
  type Reel,
  ReelError,
  type Sound,
  type SoundSegment,
  sourceOf,
} from "@splatreel/decoder/internal";
import { feedOf, type SoundFeed } from "./sound-feed";

/** Maximum seconds of sound to keep beyond the wanted segments. */
const KEPT = 90;
/** Milliseconds after which the manifest of a live reel has been polled again. */
const POLL = 4000;

/** Events of a sound source. */
export interface SoundEvents {
  /** A segment arrived or is late, see `trouble`. */
  progress(): void;
  /** The audio element restarted and lost its time. */
  renewed(): void;
  /** Sound cannot be played. */
  failed(error: Error): void;
}

/** Keeps the segments around the present time loaded. */
export class SoundSource {
  /** Reason for a delay, to show to people; null if there is none. */
  trouble: string | null = null;

  private readonly feed: SoundFeed;
  private readonly life = new AbortController();
  private filling = false;
  /** URIs of segments of a live reel that were missing once. */
  private readonly gone = new Set<string>();
  private wanted: number[] = [];
  /** Present download. */
  private coming: { index: number; transfer: AbortController } | null = null;

  /** Throws `ReelError` if the browser cannot play this type of sound. */
  constructor(
    audio: HTMLAudioElement,
    private readonly reel: Reel,
    private readonly events: SoundEvents,
  ) {
    this.feed = feedOf(audio, this.sound.type, this.manifest.live, () => events.renewed());
  }

  /** Return true if the sound at a time is loaded. */
  has(seconds: number): boolean {
    const index = segmentAt(this.sound.segments, seconds);
    return index >= 0 && this.feed.ready && this.feed.holds(this.sound.segments[index]);
  }

  /** Set the wanted range: `ahead` seconds from a time on. again: time that follows the end in a loop, or null. */
  want(seconds: number, ahead: number, again: number | null): void {
    const { segments } = this.sound;
    this.wanted = this.feed.whole ? [...segments.keys()] : wantedSegments(segments, seconds, ahead, again);
    if (this.coming && !this.wanted.includes(this.coming.index)) this.coming.transfer.abort();
    if (!this.filling) void this.fill();
  }

  /** Take over changes of the manifest. */
  refresh(): void {
    this.wanted = []; // the first segments may have been dropped, which shifts the indices
  }

  close(): void {
    this.life.abort();
    this.coming?.transfer.abort();
    this.feed.close();
  }

  private get manifest(): Manifest {
    return this.reel.manifest;
  }

  private get sound(): Sound {
    return this.manifest.presentation.sound!;
  }

  /** Download the wanted segments one by one. */
  private async fill(): Promise<void> {
    this.filling = true;
    const { signal } = this.life;
    try {
      await this.feed.begin(() => this.get(this.sound.init, signal));
      for (let index = this.missing(); index !== undefined && !signal.aborted; index = this.missing())
        await this.add(index);
      signal.throwIfAborted();
    } catch (error) {
      if (!signal.aborted) this.events.failed(error instanceof Error ? error : new ReelError(messageOf(error)));
    }
    this.filling = false;
  }

  private missing(): number | undefined {
    return this.wanted.find((index) => !this.feed.holds(this.sound.segments[index]));
  }

  private async add(index: number): Promise<void> {
    const { segments } = this.sound;
    const transfer = new AbortController();
    this.coming = { index, transfer };
    const bytes = await this.get(segments[index], transfer.signal).catch(async (error: unknown) => {
      if (!transfer.signal.aborted) await this.waitForManifest(segments[index], error);
      return null; // cancelled for a more urgent segment
    });
    this.coming = null;
    if (!bytes) return;
    for (const spare of spareSegments(segments, this.wanted, (segment) => this.feed.holds(segment)))
      await this.feed.drop(segments[spare]);
    await this.feed.add(segments[index], bytes);
    const complete = !this.manifest.live && this.feed.holds(segments.at(-1)!);
    if (complete) this.feed.end();
    this.events.progress();
  }

  /** Wait until the manifest of a live reel is polled again, which may drop a missing segment. Throws if the segment was missing before. */
  private async waitForManifest({ uri }: SoundSegment, error: unknown): Promise<void> {
    const dropped = this.manifest.live && error instanceof ReelError && error.plain === PLAIN.missing;
    if (!dropped || this.gone.has(uri)) throw error;
    this.gone.add(uri);
    await new Promise((resolve) => setTimeout(resolve, POLL));
  }

  private get(asset: Asset, signal: AbortSignal): Promise<Uint8Array> {
    const report = (why: string | null): void => {
      if (this.trouble === why) return;
      this.trouble = why;
      this.events.progress();
    };
    return download(sourceOf(this.manifest, asset), { received: () => report(null), trouble: report }, signal);
  }
}

/** Return the index of the segment at a time; -1 for none. */
export function segmentAt(segments: SoundSegment[], seconds: number): number {
  const index = segments.findLastIndex(({ start }) => start <= seconds);
  return index >= 0 && seconds < segments[index].start + segments[index].seconds ? index : -1;
}

/** Return the indices of the segments in a range of time, in order of need. */
export function wantedSegments(
  segments: SoundSegment[],
  seconds: number,
  ahead: number,
  again: number | null,
): number[] {
  const touches = (from: number, to: number): number[] =>
    segments.flatMap(({ start, seconds: length }, index) => (start < to && start + length > from ? [index] : []));
  const end = segments.length > 0 ? segments.at(-1)!.start + segments.at(-1)!.seconds : 0;
  const over = seconds + ahead - end;
  return [
    ...new Set([
      ...touches(seconds, seconds + ahead),
      ...(over > 0 && again !== null ? touches(again, Math.min(again + over, seconds)) : []),
    ]),
  ];
}

/** Return the indices of segments to drop, those played longest ago first. */
export function spareSegments(
  segments: SoundSegment[],
  wanted: number[],
  held: (segment: SoundSegment) => boolean,
): number[] {
  const now = wanted[0] ?? 0;
  const behind = (index: number): number => (now - index + segments.length) % segments.length;
  const spare = [...segments.keys()]
    .filter((index) => !wanted.includes(index) && held(segments[index]))
    .sort((a, b) => behind(b) - behind(a));
  let total = spare.reduce((sum, index) => sum + segments[index].seconds, 0);
  return spare.filter((index) => {
    if (total <= KEPT) return false;
    total -= segments[index].seconds;
    return true;
  });
}
