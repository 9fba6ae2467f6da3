/** Reads a reel at any time: downloads and decodes what a time needs, and prefetches what follows. */
import { ReelError } from "../base/errors";
import type { DecodedGroup, DecodedLayer } from "../decode/decode-file";
import type { LocalFiles } from "../files/local-files";
import type { Access } from "../files/source";
import type { Manifest } from "../reel/manifest";
import { Reel } from "../reel/reel";
import { layersAt } from "../reel/reel-file";
import { momentAt, overlapOf, type Moment, type Shown } from "../reel/timeline";
import type { DecodeWorkers } from "../stream/decoder-pool";
import { ReelLoader, type FileReceiver } from "../stream/reel-loader";
import { pointsAt, type GroupAt, type GroupData, type Points } from "./points";

/** Milliseconds between checks for renditions to improve and failed downloads to repeat. */
const HEARTBEAT = 500;

/** Fields of the manifest that describe a reel. */
const FIELDS = [
  "live",
  "fps",
  "frames",
  "shDegree",
  "bounds",
  "up",
  "near",
  "clearance",
  "background",
  "antialias",
  "camera",
  "cameras",
  "renditions",
  "presentation",
] as const;

/** The properties of a reel (docs/format.md). */
export interface ReelInfo extends Pick<Manifest, (typeof FIELDS)[number]> {
  /** First and last time, in seconds. A live reel grows, and may drop what was first. */
  start: number;
  end: number;
}

/** A group as the manifest lists it. */
export interface GroupInfo {
  number: number;
  firstFrame: number;
  frames: number;
  /** Number of dynamic points. */
  points: number;
  /** Number of static points, over all layers that live at the group. */
  staticPoints: number;
  bytes: number;
}

/** The Gaussians of a time. */
export interface Frame extends Points {
  seconds: number;
  /** Groups that the frame shows: the current one, and before it the one that fades out. */
  groups: number[];
}

/** Options of `openReel`. */
export interface ReelOptions extends Access {
  /** Name of the rendition to decode, by default the best; null to adapt to the network. */
  rendition?: string | null;
}

interface Waiting {
  isDone(): boolean;
  resolve(): void;
  reject(error: Error): void;
}

/** A reel that is open. Calls that wait for files run one after the other. */
export class ReelReader {
  private readonly reel: Reel;
  private readonly loader: ReelLoader;
  private readonly layers = new Map<string, DecodedLayer>();
  private readonly decoded = new Map<number, DecodedGroup>();
  private waiting: Waiting[] = [];
  private failure: Error | null = null;
  private seconds: number;
  private last: Promise<unknown> = Promise.resolve();
  private readonly timer: ReturnType<typeof setInterval>;

  /** Open a reel by the address of its manifest, or a local one. Throws `ReelError`. */
  static async open(
    source: string | LocalFiles,
    workers: DecodeWorkers,
    { rendition, ...access }: ReelOptions = {},
  ): Promise<ReelReader> {
    const held: { reader?: ReelReader } = {};
    const on =
      <T extends unknown[]>(act: (reader: ReelReader, ...rest: T) => void) =>
      (...rest: T): void =>
        void (held.reader && act(held.reader, ...rest));
    const receiver: FileReceiver = {
      addLayer: on((reader, uri, file) => reader.layers.set(uri, file)),
      addGroup: on((reader, index, file) => reader.decoded.set(index, file)),
      dropLayer: on((reader, uri) => reader.layers.delete(uri)),
      dropGroup: on((reader, index) => reader.decoded.delete(index)),
      lost: false,
    };
    const changed = on((reader) => reader.update());
    const failed = on((reader, error: unknown) =>
      reader.fail(error instanceof Error ? error : new ReelError(String(error))),
    );
    const replaced = (): void => failed(new ReelError("The reel was replaced by another one. Open it again."));
    const loader = new ReelLoader(
      receiver,
      { arrived: changed, grown: changed, progress: () => undefined, replaced, failed },
      workers,
    );
    try {
      const reel = new Reel(await loader.findManifest(source, access));
      checkRendition(rendition, reel.manifest);
      loader.open(reel);
      loader.stream!.choose(rendition === undefined ? (reel.manifest.renditions[0] ?? null) : rendition);
      return (held.reader = new ReelReader(reel, loader));
    } catch (error) {
      loader.close();
      throw error;
    }
  }

  private constructor(reel: Reel, loader: ReelLoader) {
    [this.reel, this.loader] = [reel, loader];
    this.seconds = this.info.start;
    this.timer = setInterval(() => this.update(), HEARTBEAT);
  }

  /** Properties of the reel, as known now. */
  get info(): ReelInfo {
    const { manifest } = this.reel;
    const { first, groups, pages, frames, fps } = manifest;
    const described = Object.fromEntries(FIELDS.map((name) => [name, manifest[name]])) as Pick<
      Manifest,
      (typeof FIELDS)[number]
    >;
    return { ...described, start: (groups[first] ?? pages[0]).firstFrame / fps, end: frames / fps };
  }

  /** Groups in order of time. Those of pages that were not needed yet are absent. */
  get groups(): GroupInfo[] {
    return this.reel.manifest.groups.flatMap((file) => {
      const { group: number, firstFrame, frames, points, bytes } = file;
      return [
        {
          number,
          firstFrame,
          frames,
          points,
          bytes,
          staticPoints: layersAt(file).reduce((sum, layer) => sum + layer.points, 0),
        },
      ];
    });
  }

  /** Bytes downloaded per second, in bits; 0 if unknown. */
  get throughput(): number {
    return this.loader.decoders.meter.rate;
  }

  /** Return the Gaussians at a time, which is clamped to the reel. Throws `ReelError`. */
  frame(seconds: number): Promise<Frame> {
    return this.enqueue(async () => {
      const { current, previous, weight } = await this.load(seconds);
      const points = pointsAt(this.groupAt(current), previous && this.groupAt(previous), weight);
      return { seconds: this.seconds, groups: [previous, current].flatMap((shown) => shown?.group ?? []), ...points };
    });
  }

  /** Return a group and its layers as decoded, for renderers that move points themselves. Throws `ReelError`. */
  group(number: number): Promise<GroupData> {
    return this.enqueue(async () => {
      const known = this.reel.manifest.groups[number];
      if (!known)
        throw new RangeError(`There is no group ${number}, or its page is not loaded. Seek to its time first.`);
      await this.load(
        (known.firstFrame + Math.min(overlapOf(this.reel.manifest, number), known.frames - 1)) / this.reel.manifest.fps,
      );
      return this.groupData(number);
    });
  }

  /** Go to a time: download and decode what it needs, then what follows, until memory is full. */
  seek(seconds: number): void {
    if (Number.isNaN(seconds)) throw new TypeError("The time is NaN.");
    const { start, fps, frames } = this.info;
    this.seconds = Math.min(Math.max(seconds, start), Math.max(frames - 1, 0) / fps);
    this.update();
  }

  /** Resolve once the files of the present time and all that are prefetched after it are decoded. */
  prefetch(): Promise<void> {
    return this.enqueue(() => this.until(() => this.isHere() && !this.loader.stream!.busy));
  }

  /** Free the memory and end the workers. Pending calls reject. */
  close(): void {
    clearInterval(this.timer);
    this.loader.close();
    this.fail(new ReelError("The reel was closed."));
    this.layers.clear();
    this.decoded.clear();
  }

  private enqueue<T>(work: () => Promise<T>): Promise<T> {
    const next = this.last.then(work, work);
    this.last = next.catch(() => undefined);
    return next;
  }

  private async load(seconds: number): Promise<Moment> {
    this.seek(seconds);
    await this.until(() => this.isHere());
    return this.moment!;
  }

  private get moment(): Moment | null {
    const { manifest } = this.reel;
    return momentAt(manifest, manifest.fps, this.seconds);
  }

  private isHere(): boolean {
    const { moment } = this;
    return (
      moment !== null &&
      [moment.current, moment.previous].every((shown) => shown === null || this.loader.stream!.has(shown.group))
    );
  }

  private until(isDone: () => boolean): Promise<void> {
    return new Promise((resolve, reject) => {
      this.waiting.push({ isDone, resolve, reject });
      this.update();
    });
  }

  /** Update the demand of the stream, and settle the calls whose files are here. */
  private update(): void {
    const {
      moment,
      loader: { stream },
      failure,
    } = this;
    if (!failure) {
      const [current, previous] = [moment?.current.group ?? null, moment?.previous?.group ?? null];
      stream!.want({
        current,
        previous,
        inUse: [],
        frame: this.seconds * this.reel.manifest.fps,
        rate: 1,
        loop: false,
      });
    }
    const ready = this.waiting.filter(({ isDone }) => failure ?? isDone());
    this.waiting = this.waiting.filter((call) => !ready.includes(call));
    for (const { resolve, reject } of ready) failure ? reject(failure) : resolve();
  }

  private fail(error: Error): void {
    this.failure ??= error;
    this.loader.abandon();
    this.update();
  }

  private groupData(number: number): GroupData {
    const layers = layersAt(this.reel.manifest.groups[number]).map(({ uri }) => ({ uri, file: this.layers.get(uri)! }));
    return { group: this.decoded.get(number)!, layers };
  }

  private groupAt({ group, frame }: Shown): GroupAt {
    return { ...this.groupData(group), frame };
  }
}

function checkRendition(name: string | null | undefined, { renditions, url }: Manifest): void {
  if (name == null || renditions.includes(name)) return;
  throw new ReelError(
    `${url} has no rendition ${name}. ${renditions.length > 0 ? `It has ${renditions.join(", ")}.` : "It has one only, without a name."}`,
  );
}
