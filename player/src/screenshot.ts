/** Saves what shows as a PNG file, in all the pixels of the screen. */
import { ReelError } from "./errors";
import type { Player } from "./player";

/** Throws `ReelError` while there is no whole picture. */
export async function saveScreenshot(player: Player): Promise<void> {
  const { stage, camera, canvas, manifest } = player;
  if (!stage || !camera || !manifest || !player.canPlay || player.waiting || player.seeking) throw new ReelError("The picture is not here yet.");
  const seconds = player.currentTime;
  const size = (css: number): number => Math.max(Math.round(css * devicePixelRatio), 1);
  player.held = true;
  try {
    const view = camera.view(size(canvas.clientWidth), size(canvas.clientHeight));
    const { width, height, data } = await stage.snapshot(player.playback.scene, player.clock.moment.weight, view);
    save(await encode(new ImageData(new Uint8ClampedArray(data.buffer as ArrayBuffer, data.byteOffset, data.byteLength), width, height)), nameOf(manifest.presentation.title, seconds));
  } finally {
    player.held = false;
    player.invalidate();
  }
}

/** Letters, digits and hyphens only: "toy-train-1.40s.png". */
export function nameOf(title: string, seconds: number): string {
  const words = title.toLowerCase().match(/[\p{L}\p{N}]+/gu) ?? ["reel"];
  return `${words.join("-").slice(0, 60)}-${seconds.toFixed(2)}s.png`;
}

function encode(pixels: ImageData): Promise<Blob> {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [pixels.width, pixels.height];
  canvas.getContext("2d")!.putImageData(pixels, 0, 0);
  return new Promise((resolve, reject) => canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new ReelError("The picture is too large to be saved."))), "image/png"));
}

function save(file: Blob, name: string): void {
  const anchor = document.createElement("a");
  anchor.href = URL.createObjectURL(file);
  anchor.download = name;
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 10_000);
}
