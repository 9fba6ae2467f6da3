/** Entry point of the self-test page, which `splatreel serve` shows to phones. It plays the reel, tests the player, and writes a result to copy. */
import type { Player } from "../player/player";
import { Measurements, wait } from "./measurements";
import { messageOf } from "@splatreel/decoder/internal";
import { version } from "../../../../package.json";
import { deviceFacts, fact, graphicsFacts } from "./device";
import { doubleTapTest, dragTest, pinchTest, rotationTest } from "./gesture-steps";
import { Panel } from "./panel";
import { type Finding, reportOf } from "./report";
import styles from "./self-test.css";

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
