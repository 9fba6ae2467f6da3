/** Saves the present frame as a PNG file in full resolution. */
import { ReelError } from "@splatreel/decoder/internal";
import type { Player } from "../player/player";

const NOT_READY = "The picture is not ready yet.";
const TOO_LARGE = "The picture is too large to save.";

/** Save a screenshot. Throws `ReelError` while there is no complete frame. */
export async function saveScreenshot(player: Player): Promise<void> {
  const { camera, canvas, manifest } = player;
  if (!camera || !manifest || !player.canPlay || player.waiting || player.seeking) throw failure(NOT_READY);
  const seconds = player.currentTime;
  const size = (css: number): number => Math.max(Math.round(css * devicePixelRatio), 1);
  const { width, height, data } = await player.playback.takePicture(
    camera.view(size(canvas.clientWidth), size(canvas.clientHeight)),
  );
  save(
    await encode(
      new ImageData(new Uint8ClampedArray(data.buffer as ArrayBuffer, data.byteOffset, data.byteLength), width, height),
    ),
    nameOf(manifest.presentation.title, seconds),
  );
}

function failure(why: string): ReelError {
  return new ReelError(why, { plain: why });
}

/** Return a file name of letters, digits and hyphens, such as "toy-train-1.40s.png". */
export function nameOf(title: string, seconds: number): string {
  const words = title.toLowerCase().match(/[\p{L}\p{N}]+/gu) ?? ["reel"];
  return `${words.join("-").slice(0, 60)}-${seconds.toFixed(2)}s.png`;
}

function encode(pixels: ImageData): Promise<Blob> {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [pixels.width, pixels.height];
  canvas.getContext("2d")!.putImageData(pixels, 0, 0);
  return new Promise((resolve, reject) =>
    canvas.toBlob((blob) => (blob ? resolve(blob) : reject(failure(TOO_LARGE))), "image/png"),
  );
}

function save(file: Blob, name: string): void {
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(file);
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 10_000);
}
