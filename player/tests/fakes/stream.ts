/** A stream whose files come when a test says so. */
import type { Manifest } from "../../packages/decoder/src/reel/manifest";
import { Reel } from "../../packages/decoder/src/reel/reel";
import { momentAt } from "../../packages/decoder/src/reel/timeline";
import { DecoderPool } from "../../packages/decoder/src/stream/decoder-pool";
import { costOf } from "../../packages/decoder/src/stream/file-cache";
import type { Demand } from "../../packages/decoder/src/stream/queue";
import { RenditionPolicy } from "../../packages/decoder/src/stream/rendition-policy";
import { Stream } from "../../packages/decoder/src/stream/stream";
import { decodeWorkers } from "../../packages/renderer/src/files/bundle";
import { fileAt, manifestOf, pageAt, type Plan } from "./reel";
import { FakeTime } from "./time";
import { FakeWorker, Transfers } from "./workers";

export const time = new FakeTime();
/** Bytes of memory that a group takes. */
export const GROUP = costOf({ points: 100, frames: 10 });

export class World extends Transfers {
  readonly log: string[] = [];
  readonly pool: DecoderPool;
  readonly stream: Stream;
  outdated = (): Promise<boolean> => Promise.resolve(false);
  readonly reel: Reel;
  private demand: Demand = { current: 0, previous: null, inUse: [], loop: false, frame: 0, rate: 1 };

  constructor(plan: Plan = {}, groupsInMemory = 100) {
    super((uri) => (uri.startsWith("pages") ? pageAt(plan, uri) : fileAt(plan, uri)));
    FakeWorker.all.length = 0;
    this.pool = new DecoderPool(decodeWorkers);
    this.reel = new Reel(manifestOf(plan));
    this.stream = new Stream(
      this.reel,
      this.pool,
      groupsInMemory * GROUP,
      {
        layer: (uri) => this.log.push(uri.replace(/s.(\d+).*/, " $1")),
        group: (index) => this.log.push(`group ${index}`),
        page: (page, json) => {
          this.reel.addPage(page, json);
          this.stream.refresh();
          this.look();
        },
        dropped: ({ groups, layers }) =>
          this.log.push(...groups.map((index) => `dropped ${index}`), ...layers.map((uri) => `dropped ${uri}`)),
        outdated: () => this.outdated(),
        progress: () => undefined,
        failed: (error) => this.log.push(`failed ${error.message}`),
      },
      new RenditionPolicy(5e6),
    );
  }

  get manifest(): Manifest {
    return this.reel.manifest;
  }

  /** The live reel's manifest is read again. */
  grow(next: Manifest): void {
    this.reel.grow(next);
    this.stream.refresh();
  }

  /** Want what shows at the frame of the last demand, as far as it is known. */
  look(): void {
    const { frame } = this.demand;
    const moment = momentAt(this.manifest, 1, frame);
    this.want({ current: moment?.current.group ?? null, previous: moment?.previous?.group ?? null, frame });
  }

  want(demand: Partial<Demand>): void {
    const current = demand.current ?? this.demand.current ?? 0;
    this.demand = { ...this.demand, frame: 10 * current, ...demand };
    this.stream.want(this.demand);
  }

  /** The first layer comes, at 16 kbit/s. */
  measure(): void {
    this.want({});
    time.now += 250;
    this.bytes("layers/0.bin", 500);
    this.give("layers/0.bin");
  }
}
