/** The test of the sound: that of the reel, or a tone if the reel is silent. */
import type { Player } from "../player/player";
import { wait } from "./measurements";

/** Seconds of sound. */
const SECONDS = 2;

/** Play a sound in response to a tap, and return what the browser reports. Throws if the reel's sound does not advance. */
export async function playSound(player: Player, signal: AbortSignal): Promise<string> {
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
