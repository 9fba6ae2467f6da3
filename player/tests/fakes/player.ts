/** A player without a browser: pictures go nowhere, files come when a test says so, and points are sorted by the real code. */
import { Player } from "../../packages/element/src/player/player";
import type { Stage } from "../../packages/renderer/src/draw/stage";
import "./audio";
import { FakeHost, whole } from "./host";
import "./page";
import { ADDRESS, birthOf, documentOf, livingAt, pageAt, shareOf, type Plan } from "./reel";
import { FakeTime, settled } from "./time";
import { FakeWorker, Transfers } from "./workers";
import "../../packages/renderer/src/draw/sort-worker";

// eslint-disable-next-line @typescript-eslint/no-explicit-any
const scope = globalThis as any;
let frame: ((now: number) => void) | null = null;
scope.requestAnimationFrame = (call: (now: number) => void) => ((frame = call), 1);
scope.cancelAnimationFrame = () => void (frame = null);
scope.matchMedia = () => ({ matches: false });

/** The sort worker answers at once. */
const sort = scope.onmessage;
FakeWorker.posted = (worker, message) => {
  if (!(message as { type?: string }).type) return;
  scope.postMessage = (reply: unknown) => queueMicrotask(() => worker.say(reply));
  sort({ data: message });
};

/** A graphics device that draws nothing and answers everything. */
class FakeDevice {
  lost = false;
  /** Names of what was called, and how often. */
  readonly calls = new Map<string, number>();
  readonly gl = new Proxy({}, { get: (_, name: string) => this.find(name) });

  private find(name: string): unknown {
    if (/^[A-Z0-9_]+$/.test(name)) return name;
    return (...values: unknown[]): unknown => {
      this.calls.set(name, (this.calls.get(name) ?? 0) + 1);
      if (name === "isContextLost") return this.lost;
      if (name === "getParameter") return values[0] === "MAX_TEXTURE_SIZE" ? 256 : "a device";
      if (name === "getExtension")
        return {
          UNMASKED_RENDERER_WEBGL: "renderer",
          loseContext: () => this.tell("webglcontextlost"),
          restoreContext: () => this.tell("webglcontextrestored"),
        };
      return /^(create|get)/.test(name) ? {} : undefined;
    };
  }

  tell: (event: string) => void = () => undefined;
}

/** Points in a row before the start camera, each in its own place; frames: of a group. index: number of the group, or of that at which a layer is born. */
export function pointsOf(count: number, frames: number, alive: number, index = 0): object {
  const fill = (numbers: number, value: number): Float32Array => new Float32Array(numbers).fill(value);
  const means = Float32Array.from({ length: 3 * count }, (_, i) => (i % 3 === 2 ? i / (3 * count) : 0));
  const points = {
    count,
    means,
    quats: fill(4 * count, 0.5),
    scales: fill(3 * count, 0.01),
    opacities: fill(count, 0.5),
    shBase: fill(3 * count, 0),
    shRest: new Uint16Array(count),
    codebook: new Float32Array(),
    shDegree: 0,
  };
  const offsets = {
    frames,
    dx: new Uint16Array(4 * count * frames),
    dq: new Uint8Array(4 * count * frames),
    dxMin: [0, 0, 0],
    dxStep: [0, 0, 0],
    dqMin: [1, 0, 0, 0],
    dqStep: [0, 0, 0, 0],
    worldly: false,
    shade: null,
  };
  const header = { index, firstFrame: 10 * index, frames };
  if (frames === 0) return { kind: "layer", ...header, points };
  return { kind: "group", ...header, points, alive: new Uint8Array(alive).fill(1), offsets, light: null };
}

/** The file of a layer or group of a plan, decoded. */
export function pointsAt(plan: Plan, uri: string): object {
  const number = Number(/\d+/.exec(uri));
  const { points = 100 } = plan;
  if (uri.startsWith("layers")) return pointsOf(points, 0, 0, birthOf(plan, number));
  return pointsOf(points * shareOf(plan, uri), 10, points * livingAt(plan, number).length, number);
}

export class FakePlayer {
  static readonly time = new FakeTime();
  static readonly host = new FakeHost();
  private static last: FakePlayer | null = null;

  readonly device = new FakeDevice();
  readonly player: Player;
  /** Events in the order in which they came; those that come all the time only once in a row. */
  events: string[] = [];
  readonly files: Transfers;

  /** A player that somebody looks at; the one before is put to rest. */
  constructor(public plan: Plan = {}) {
    FakePlayer.last?.player.close();
    FakePlayer.last?.player.rest();
    FakePlayer.last = this;
    FakeWorker.all.length = 0;
    this.files = new Transfers((uri) => (uri.startsWith("pages") ? pageAt(this.plan, uri) : pointsAt(this.plan, uri)));
    const canvas = Object.assign(new EventTarget(), {
      width: 0,
      height: 0,
      clientWidth: 160,
      clientHeight: 90,
      getContext: (): unknown => this.device.gl,
    });
    this.device.tell = (event) => void setTimeout(() => canvas.dispatchEvent(new Event(event)));
    this.player = new Player(canvas as unknown as HTMLCanvasElement);
    const emit = this.player.emit.bind(this.player);
    this.player.emit = (name) => {
      if (this.events.at(-1) !== name) this.events.push(name);
      emit(name);
    };
    this.answer(plan);
    this.player.wake();
    this.player.show(true);
  }

  /** Answer requests for the manifest with that of a plan; files are those of this plan from now on. */
  answer(plan: Plan): void {
    this.plan = plan;
    FakePlayer.host.answer(whole(JSON.stringify(documentOf(plan))));
  }

  get stage(): Stage {
    return this.player.stage!;
  }

  /** Open the reel, whose files do not come yet. */
  async open(): Promise<void> {
    void this.player.load(ADDRESS);
    await FakePlayer.time.pass(0);
  }

  /** Let time pass, with a picture every 20 milliseconds. */
  async pass(milliseconds: number, step = 20): Promise<void> {
    for (let passed = 0; passed < milliseconds; passed += step) {
      await FakePlayer.time.pass(step);
      const call = frame;
      frame = null;
      call?.(performance.now());
      await settled();
    }
  }

  /** Open the reel, have all its files, and see the first picture. */
  async start(): Promise<void> {
    await this.open();
    this.files.giveAll();
    await this.pass(60);
  }

  /** The events since the last time that this was asked, without some. */
  heard(...without: string[]): string[] {
    const events = this.events.filter((name) => !without.includes(name));
    this.events = [];
    return events.filter((name, i) => name !== events[i - 1]);
  }
}

/** Events that come at any time, for `heard`. */
export const OFTEN = ["progress", "drawn", "timeupdate", "volumechange"];

/** A player that has started to show a reel. Its events so far are forgotten. */
export async function started(plan: Plan = { groups: 3 }): Promise<FakePlayer> {
  const fake = new FakePlayer(plan);
  await fake.start();
  fake.heard();
  return fake;
}
