/** Gets a reel's sound, segment by segment, and gives it to an audio element. */
import { messageOf, PLAIN, ReelError } from "../base/errors";
import { download } from "../files/download";
import { sourceOf, type Manifest } from "../reel/manifest";
import type { Reel } from "../reel/reel";
import type { Asset, Sound, SoundSegment } from "../reel/presentation";
import { feedOf, type SoundFeed } from "./sound-feed";

/** Seconds of sound to hold at most, beyond what is wanted. */
const HELD = 90;
/** Milliseconds in which a live reel's manifest is read again. */
const NEWS = 4000;

export interface SoundEvents {
  /** A segment is here, or one is late: `trouble` says why. */
  progress(): void;
  /** The audio element begins anew: its time is lost. */
  renewed(): void;
  /** There is no sound any more. */
  failed(error: Error): void;
}

export class SoundSource {
  /** Why a segment is late, for people; null while all is well. */
  trouble: string | null = null;

  private readonly feed: SoundFeed;
  private readonly life = new AbortController();
  private filling = false;
  /** Segments of a live reel that were not there when they were asked for. */
  private readonly gone = new Set<string>();
  private wanted: number[] = [];
  /** What is being downloaded. */
  private coming: { index: number; transfer: AbortController } | null = null;

  /** Throws `ReelError` where the browser does not play this kind of sound. */
  constructor(audio: HTMLAudioElement, private readonly reel: Reel, private readonly events: SoundEvents) {
    this.feed = feedOf(audio, this.sound.type, this.manifest.live, () => events.renewed());
  }

  /** Whether the sound at this time is here. */
  has(seconds: number): boolean {
    const index = segmentAt(this.sound.segments, seconds);
    return index >= 0 && this.feed.ready && this.feed.holds(this.sound.segments[index]);
  }

  /** Have the sound at this time and so many seconds after it; again: the time that comes after the end. */
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

  /** Get what is wanted and not here, one after the other. */
  private async fill(): Promise<void> {
    this.filling = true;
    const { signal } = this.life;
    try {
      await this.feed.begin(() => this.get(this.sound.init, signal));
      for (let index = this.missing(); index !== undefined && !signal.aborted; index = this.missing()) await this.add(index);
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
      if (!transfer.signal.aborted) await this.waitForNews(segments[index], error);
      return null; // another segment is needed sooner
    });
    this.coming = null;
    if (!bytes) return;
    for (const spare of spareSegments(segments, this.wanted, (segment) => this.feed.holds(segment))) await this.feed.drop(segments[spare]);
    await this.feed.add(segments[index], bytes);
    const complete = !this.manifest.live && this.feed.holds(segments.at(-1)!);
    if (complete) this.feed.end();
    this.events.progress();
  }

  /** A segment that a live reel has dropped is not wanted by the time that its manifest is read again. Throws where it was waited for before. */
  private async waitForNews({ uri }: SoundSegment, error: unknown): Promise<void> {
    const dropped = this.manifest.live && error instanceof ReelError && error.plain === PLAIN.missing;
    if (!dropped || this.gone.has(uri)) throw error;
    this.gone.add(uri);
    await new Promise((resolve) => setTimeout(resolve, NEWS));
  }

  private get(asset: Asset, signal: AbortSignal): Promise<Uint8Array> {
    const told = (why: string | null): void => {
      if (this.trouble === why) return;
      this.trouble = why;
      this.events.progress();
    };
    return download(sourceOf(this.manifest, asset), { received: () => told(null), trouble: told }, signal);
  }
}

/** The segment that a time is in; -1: none. */
export function segmentAt(segments: SoundSegment[], seconds: number): number {
  const index = segments.findLastIndex(({ start }) => start <= seconds);
  return index >= 0 && seconds < segments[index].start + segments[index].seconds ? index : -1;
}

/** The segments from a time to so many seconds later, in the order in which they are needed. */
export function wantedSegments(segments: SoundSegment[], seconds: number, ahead: number, again: number | null): number[] {
  const touches = (from: number, to: number): number[] => segments.flatMap(({ start, seconds: length }, index) => (start < to && start + length > from ? [index] : []));
  const end = segments.length > 0 ? segments.at(-1)!.start + segments.at(-1)!.seconds : 0;
  const over = seconds + ahead - end;
  return [...new Set([...touches(seconds, seconds + ahead), ...(over > 0 && again !== null ? touches(again, Math.min(again + over, seconds)) : [])])];
}

/** What to drop before one more comes, so that no more is held than is good: what was heard longest ago first. */
export function spareSegments(segments: SoundSegment[], wanted: number[], held: (segment: SoundSegment) => boolean): number[] {
  const now = wanted[0] ?? 0;
  const behind = (index: number): number => (now - index + segments.length) % segments.length;
  const spare = [...segments.keys()].filter((index) => !wanted.includes(index) && held(segments[index])).sort((a, b) => behind(b) - behind(a));
  let total = spare.reduce((sum, index) => sum + segments[index].seconds, 0);
  return spare.filter((index) => {
    if (total <= HELD) return false;
    total -= segments[index].seconds;
    return true;
  });
}
