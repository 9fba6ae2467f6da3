/** Entry point of the self-test page, which `splatreel serve` shows to phones. It plays the reel, tests the player, and writes a result to copy. */
import { costOf, messageOf } from "@splatreel/decoder/internal";
import type { Player } from "../player/player";
import { deviceFacts, fact, graphicsFacts } from "./device";
import { type Finding, megabytes, reportOf, spreadOf } from "./report";
import type { CameraState } from "../camera/pose";
import { version } from "../../../../package.json";
import { Panel } from "./panel";
import styles from "./self-test.css";

/** Seconds for which frame times are measured, and radians per second by which the camera turns meanwhile. */
const MEASURED_SECONDS = 4;
const TURN = 0.3;

/** Follows a player from its start. */
class Measurements {
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
    await wait(1000 * MEASURED_SECONDS, signal);
    player.removeEventListener("drawn", drawn);
    camera?.rotate(null);
    player.pause();
    if (times.length === 0) throw new Error(`no picture was drawn in ${MEASURED_SECONDS} s`);
    return `${spreadOf(times)}; ${times.length + 1} pictures in ${MEASURED_SECONDS} s at ${canvas.width} x ${canvas.height}`;
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
function wait(milliseconds: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    setTimeout(resolve, milliseconds);
    signal.addEventListener("abort", () => reject(signal.reason));
  });
}

/** Radians of a drag and factor of a pinch that count. */
const TURNED = 0.1;
const PINCHED = 1.1;
/** Milliseconds within which two taps are a double tap, and in which the reel answers it. */
const DOUBLE = 320;
const ANSWER = 600;

/** Resolve once one finger has turned the view. */
function dragTest({ canvas, camera }: Player, signal: AbortSignal): Promise<string> {
  return watchFingers(canvas, signal, (fingers, start) => {
    const angle = fingers === 1 ? angleBetween(start(camera!.state), camera!.state) : 0;
    return angle > TURNED ? `turned the view by ${Math.round((180 * angle) / Math.PI)} degrees` : null;
  });
}

/** Resolve once two fingers have changed the distance. */
function pinchTest({ canvas, camera }: Player, signal: AbortSignal): Promise<string> {
  return watchFingers(canvas, signal, (fingers, start) => {
    const factor = fingers === 2 ? start(camera!.state).distance / camera!.state.distance : 1;
    return Math.max(factor, 1 / factor) > PINCHED
      ? `changed the distance by a factor of ${(1 / factor).toFixed(2)}`
      : null;
  });
}

/** Resolve once a double tap has chosen a new middle, or has stepped through the time. */
function doubleTapTest(player: Player, signal: AbortSignal): Promise<string> {
  const { canvas, camera } = player;
  return new Promise((resolve) => {
    let last = -Infinity;
    canvas.addEventListener(
      "pointerup",
      ({ timeStamp }) => {
        const double = timeStamp - last < DOUBLE;
        last = double ? -Infinity : timeStamp;
        if (!double) return;
        const [before, time] = [camera!.state, player.currentTime];
        setTimeout(() => {
          const { state } = camera!;
          if (Math.abs(player.currentTime - time) > 0.02 && player.paused) resolve("stepped through the time");
          else if (angleBetween(before, state) > 0.005 || Math.abs(state.distance / before.distance - 1) > 0.005)
            resolve("chose a new middle");
        }, ANSWER);
      },
      { signal },
    );
  });
}

/** Resolve once the window has been turned and the picture fills its place. */
function rotationTest({ canvas }: Player, signal: AbortSignal): Promise<string> {
  const lies = (): boolean => innerWidth > innerHeight;
  const [before, size] = [lies(), `${innerWidth} x ${innerHeight}`];
  return new Promise((resolve, reject) => {
    addEventListener(
      "resize",
      () => {
        if (lies() === before) return;
        setTimeout(() => {
          const wide = document.documentElement.scrollWidth > innerWidth;
          const skew = (canvas.width * canvas.clientHeight) / (canvas.height * canvas.clientWidth);
          if (wide || Math.abs(skew - 1) > 0.05)
            reject(new Error(wide ? "the page is wider than the screen" : "the picture is distorted"));
          else resolve(`from ${size} to ${innerWidth} x ${innerHeight}`);
        }, ANSWER);
      },
      { signal },
    );
  });
}

/** Call `done` at each move with the number of fingers on a canvas, until it returns a text. start: remembers a value of the first call per number of fingers. */
function watchFingers(
  canvas: HTMLElement,
  signal: AbortSignal,
  done: (fingers: number, start: <T>(now: T) => T) => string | null,
): Promise<string> {
  return new Promise((resolve) => {
    const fingers = new Set<number>();
    let first: unknown = null;
    canvas.addEventListener(
      "pointerdown",
      ({ pointerId }) => {
        fingers.add(pointerId);
        first = null;
      },
      { signal },
    );
    for (const name of ["pointerup", "pointercancel"] as const)
      canvas.addEventListener(name, ({ pointerId }) => (fingers.delete(pointerId), (first = null)), { signal });
    canvas.addEventListener(
      "pointermove",
      () => {
        const text = done(fingers.size, <T>(now: T) => (first ??= now) as T);
        if (text !== null) resolve(text);
      },
      { signal },
    );
  });
}

/** Return the angle between two views, in radians. */
function angleBetween(a: CameraState, b: CameraState): number {
  const dot = a.turn.reduce((sum, value, i) => sum + value * b.turn[i], 0);
  return 2 * Math.acos(Math.min(Math.abs(dot), 1));
}

/** Seconds of sound. */
const SECONDS = 2;

/** Play a sound in response to a tap, and return what the browser reports. Throws if the reel's sound does not advance. */
async function playSound(player: Player, signal: AbortSignal): Promise<string> {
  const { soundtrack } = player;
  if (!soundtrack.available) return playTone(signal);
  const before = player.currentTime;
  soundtrack.muted = false;
  player.play();
  await wait(1000 * SECONDS, signal);
  const [muted, stands] = [soundtrack.muted, player.currentTime === before];
  player.pause();
  if (muted || stands)
    throw new Error(muted ? "the browser muted the reel's sound" : "the reel did not play with its sound");
  return "the reel's sound";
}

async function playTone(signal: AbortSignal): Promise<string> {
  const context = new AudioContext();
  const tone = context.createOscillator();
  const volume = context.createGain();
  volume.gain.value = 0.2;
  tone.connect(volume).connect(context.destination);
  tone.start();
  try {
    await wait((1000 * SECONDS) / 2, signal);
    const latency = context.outputLatency ? `, latency ${Math.round(1000 * context.outputLatency)} ms` : "";
    return `a tone, audio ${context.state} at ${context.sampleRate} Hz${latency}`;
  } finally {
    await context.close();
  }
}

/** Buttons of a test that people do. */
const SKIP = "Skip";
const BROKEN = "It does not work";

/** One test. */
interface Step {
  name: string;
  instruction: string;
  /** Resolves with what was found; rejects if the test failed. */
  run(signal: AbortSignal): Promise<string>;
  /** True if people do it, and may skip it. */
  byHand?: boolean;
}

const sheet = new CSSStyleSheet();
sheet.replaceSync(styles);
document.adoptedStyleSheets.push(sheet); // a host's policy may forbid style elements

const problems: string[] = [];
addEventListener("error", ({ message }) => problems.push(message));
addEventListener("unhandledrejection", ({ reason }) => problems.push(messageOf(reason)));

await customElements.whenDefined("splat-reel");
const reel = document.createElement("splat-reel");
reel.setAttribute("gestures", "greedy");
reel.setAttribute("prompt", "none"); // the panel instructs people
for (const name of ["loop", "muted"]) reel.toggleAttribute(name, true);
const { player } = reel;
const measurements = new Measurements(player);
player.addEventListener("error", () => problems.push(messageOf(player.error)));
reel.src = new URLSearchParams(location.search).get("src") ?? "reel/manifest.json";

const steps: Step[] = [
  { name: "First picture", instruction: "Loading the reel", run: () => measurements.firstPicture() },
  {
    name: "Frame time",
    instruction: "Measuring for four seconds. Do not touch the picture",
    run: (signal) => measurements.frameTimes(signal),
  },
  {
    name: "Drag",
    instruction: "Drag the picture with one finger",
    byHand: true,
    run: (signal) => dragTest(player, signal),
  },
  {
    name: "Pinch",
    instruction: "Pinch the picture with two fingers",
    byHand: true,
    run: (signal) => pinchTest(player, signal),
  },
  {
    name: "Double tap",
    instruction: "Double-tap something in the middle of the picture",
    byHand: true,
    run: (signal) => doubleTapTest(player, signal),
  },
  { name: "Sound", instruction: "Turn the volume up, then press Play", byHand: true, run: testSound },
  {
    name: "Rotation",
    instruction: "Turn the device to its side, or back",
    byHand: true,
    run: (signal) => rotationTest(player, signal),
  },
];
const panel = new Panel(steps.map(({ name }) => name));
document.querySelector("main")!.append(reel, panel.box);
await run();

/** Run all tests in order, and show the result. */
async function run(): Promise<void> {
  const findings: Finding[] = [];
  for (const [index, step] of steps.entries()) {
    panel.instruct(index, step.instruction);
    const { state, text } = player.error
      ? { state: "skipped" as const, text: "the reel cannot be played" }
      : await attempt(step);
    panel.tick(index, state);
    findings.push({ name: step.name, state, text });
  }
  const facts = [...(await deviceFacts()), ...graphicsFacts(player.canvas), ...measurements.facts()];
  findings.push(...facts, fact("Problems", [...new Set(problems)].join("; ") || "none"));
  panel.finish(reportOf(version, findings));
}

async function attempt({ run, byHand }: Step): Promise<Pick<Finding, "state" | "text">> {
  const life = new AbortController();
  const choice = byHand
    ? panel
        .choose([BROKEN, SKIP], life.signal)
        .then((label) => ({ state: label === SKIP ? ("skipped" as const) : ("failed" as const), text: "" }))
    : null;
  const result = run(life.signal).then(
    (text) => ({ state: "passed" as const, text }),
    (error) => ({ state: "failed" as const, text: messageOf(error) }),
  );
  try {
    return await (choice ? Promise.race([result, choice]) : result);
  } finally {
    life.abort(new Error("ended"));
  }
}

/** Play a sound, and ask whether it was heard. */
async function testSound(signal: AbortSignal): Promise<string> {
  await panel.choose(["Play"], signal);
  const played = await playSound(player, signal);
  const heard = await panel.choose(["I heard it", "I heard nothing"], signal);
  if (heard !== "I heard it") throw new Error(`not heard: ${played}`);
  return `heard ${played}`;
}
