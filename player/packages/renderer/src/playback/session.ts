/** Resources of the open reel: its workers, its stage, and the stream of its files. */
import {
  type Access,
  type EarlyWorker,
  type LoaderEvents,
  type LocalFiles,
  type Manifest,
  type Reel,
  ReelLoader,
} from "@splatreel/decoder/internal";
import type { PointSorter } from "../draw/point-sorter";
import type { Renderer } from "../draw/renderer";
import { Stage } from "../draw/stage";
import { decodeWorkers } from "../files/bundle";
import { EMBEDDED, embeddedReel } from "../files/embedded";

/** Events of a session. */
export type SessionEvents = LoaderEvents;

/** Opens one reel, draws it on a stage, and closes it again. */
export class Session extends ReelLoader {
  /** Start the workers at once, while the manifest downloads. sorterOf: creates the sorter. early: a decode worker that is already running. */
  static start(
    renderer: Renderer,
    sorterOf: (failed: (message: string) => void) => PointSorter,
    events: SessionEvents,
    early?: EarlyWorker | null,
  ): Session {
    return new Session(
      new Stage(
        renderer,
        sorterOf((message) => events.failed(new Error(message))),
      ),
      events,
      early,
    );
  }

  private constructor(
    readonly stage: Stage,
    events: SessionEvents,
    early?: EarlyWorker | null,
  ) {
    super(stage, events, decodeWorkers, early);
  }

  override findManifest(
    source: string | LocalFiles,
    access?: Access,
    early?: Promise<string | null>,
  ): Promise<Manifest> {
    return super.findManifest(source === EMBEDDED ? embeddedReel() : source, access, early);
  }

  override open(reel: Reel): void {
    this.stage.open(reel);
    super.open(reel);
  }

  override close(): void {
    super.close();
    this.stage.destroy();
  }
}
