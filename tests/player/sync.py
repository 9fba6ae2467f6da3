"""Offset of images from sound in a browser: the times of drawn flashes and of their clicks."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from playwright.sync_api import Page

LISTEN = """
async () => {
  const element = document.querySelector('splat-reel');
  const { spatial } = element.player.soundtrack;
  while (!spatial.node) await new Promise((resolve) => setTimeout(resolve, 20));
  const { context, node } = spatial;
  // Hears every sample before it goes to the panner; a click begins where 10 ms were quiet.
  const code = `registerProcessor('clicks', class extends AudioWorkletProcessor {
    process([[samples]]) {
      for (let i = 0; i < (samples?.length ?? 0); i++) {
        if (Math.abs(samples[i]) < 0.2) continue;
        const at = currentFrame + i;
        if (at - (this.last ?? -sampleRate) > sampleRate / 100) this.port.postMessage(at / sampleRate);
        this.last = at;
      }
      return true;
    }
  })`;
  await context.audioWorklet.addModule(URL.createObjectURL(new Blob([code], { type: 'text/javascript' })));
  const clicks = new AudioWorkletNode(context, 'clicks');
  node.connect(clicks).connect(context.destination); // it gives silence
  const heard = (window.heard = []);
  const seen = (window.seen = []);
  const drawn = (window.drawn = []);
  clicks.port.onmessage = ({ data }) => {
    const { contextTime, performanceTime } = context.getOutputTimestamp();
    heard.push(performanceTime + 1000 * (data - contextTime));
  };
  const gl = element.player.canvas.getContext('webgl2');
  const pixel = new Uint8Array(4);
  let bright = true;
  const look = () => {
    requestAnimationFrame(look); // after the player's own, which has drawn
    const { pictures } = element.player.stage;
    if (pictures === look.pictures) return; // what was drawn before is gone from the buffer
    look.pictures = pictures;
    drawn.push([performance.now(), element.currentTime]);
    gl.readPixels(gl.drawingBufferWidth >> 1, gl.drawingBufferHeight >> 1, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    const now = pixel[0] > 128;
    if (now && !bright) seen.push(performance.now());
    bright = now;
  };
  requestAnimationFrame(look);
}
"""


@dataclass(frozen=True)
class Sync:
    """Milliseconds from each click to its image; positive if the image is late.

    pictures: to the first image of the flash. clock: to the time at which the image clock reaches the click, interpolated; a
    slow renderer does not count.
    """

    pictures: list[float]
    clock: list[float]
    clicks: int


def listen(page: Page) -> None:
    """Start the measurement after the reel's sound is connected to Web Audio."""
    page.evaluate(LISTEN)


def measured(page: Page, times: tuple[float, ...], within: float = 140.0) -> Sync:
    """Return the measurements since `listen`. times: of the clicks, seconds. within: milliseconds from a click to its picture; a click
    without one belongs to a seek."""
    heard, seen, drawn = page.evaluate("[window.heard, window.seen, window.drawn]")
    passed = [
        before + (time - a) / (b - a) * (after - before)
        for (before, a), (after, b) in pairwise(drawn)
        for time in times
        if a < time <= b < a + 0.5
    ]

    def offsets(found: list[float]) -> list[float]:
        nearest = [min((time - click for time in found), key=abs, default=within) for click in heard]
        return [offset for offset in nearest if abs(offset) < within]

    return Sync(offsets(seen), offsets(passed), len(heard))
