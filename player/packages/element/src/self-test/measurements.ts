/** Measurements of the reel that the page plays: start, decoding, frame times, memory. */
import { costOf } from "@splatreel/decoder/internal";
import type { Player } from "../player/player";
import { fact } from "./device";
import { megabytes, spreadOf, type Finding } from "./report";

/** Seconds for which frame times are measured, and radians per second by which the camera turns meanwhile. */
const SECONDS = 4;
const TURN = 0.3;

/** Follows a player from its start. */
export class Measurements {
  private readonly decodeTimes: number[] = [];
  private staticPicture = 0;
  private picture = 0;

  constructor(private readonly player: Player) {
    const now = (): number => performance.now(); // since the page was opened
    player.addEventListener("loadeddata", () => (this.staticPicture ||= now()));
    player.addEventListener("canplay", () => (this.picture ||= now()));
    player.addEventListener("progress", () => this.noteDecoding());
  }

  /** Resolve once a complete frame is drawn; reject on an error of the player. */
  async firstPicture(): Promise<string> {
    await this.player.whenReady();
    return `after ${seconds(this.picture)}, static points after ${seconds(this.staticPicture)}`;
  }

  /** Play and turn for some seconds, and return the times between pictures. */
  async frameTimes(signal: AbortSignal): Promise<string> {
    const {
      player,
      player: { camera, canvas },
    } = this;
    const times: number[] = [];
    let last = 0;
    const drawn = (): void => {
      const now = performance.now();
      if (last > 0) times.push(now - last);
      last = now;
    };
    player.addEventListener("drawn", drawn, { signal });
    camera?.rotate({ speed: TURN, delay: 0 });
    player.play(true);
    await wait(1000 * SECONDS, signal);
    player.removeEventListener("drawn", drawn);
    camera?.rotate(null);
    player.pause();
    if (times.length === 0) throw new Error(`no picture was drawn in ${SECONDS} s`);
    return `${spreadOf(times)}; ${times.length + 1} pictures in ${SECONDS} s at ${canvas.width} x ${canvas.height}`;
  }

  /** Return what was measured beside the tests. */
  facts(): Finding[] {
    const { manifest, stats } = this.player;
    const reel = manifest
      ? `${manifest.frames} frames at ${manifest.fps} per second, ${stats?.points ?? 0} points drawn`
      : "not opened";
    return [
      fact("Reel", reel),
      fact("Decode time", `${spreadOf(this.decodeTimes)} of ${this.decodeTimes.length} files`),
      fact("Memory", this.memory()),
    ];
  }

  private noteDecoding(): void {
    const milliseconds = this.player.stats?.decodeMilliseconds ?? 0;
    if (milliseconds > 0 && milliseconds !== this.decodeTimes.at(-1)) this.decodeTimes.push(milliseconds);
  }

  /** Return the memory of the decoded files, and of the scripts where the browser reports it. */
  private memory(): string {
    const { stream, manifest } = this.player;
    const files = stream && manifest ? [...manifest.layers, ...stream.held.map((group) => stream.fileOf(group))] : [];
    const decoded = files.reduce((sum, { points, frames }) => sum + costOf({ points, frames, until: 0 }), 0);
    const { memory } = performance as { memory?: { usedJSHeapSize: number; jsHeapSizeLimit: number } };
    const heap = memory
      ? `scripts ${megabytes(memory.usedJSHeapSize)} of at most ${megabytes(memory.jsHeapSizeLimit)}`
      : "scripts unknown";
    return `decoded files ${megabytes(decoded)}, ${heap}`;
  }
}

function seconds(milliseconds: number): string {
  return `${(milliseconds / 1000).toFixed(2)} s`;
}

/** Resolve after milliseconds; reject when aborted. */
export function wait(milliseconds: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    setTimeout(resolve, milliseconds);
    signal.addEventListener("abort", () => reject(signal.reason));
  });
}
