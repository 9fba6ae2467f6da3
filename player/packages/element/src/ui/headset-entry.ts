/** Entering and leaving a headset or augmented reality, whose part is loaded on demand. */
import { messageOf } from "@splatreel/decoder/internal";
import { loadPart } from "@splatreel/renderer";
import type { Headset } from "../player/headset";
import { supportsHeadset, type HeadsetMode } from "../player/headset-support";
import type { Player } from "../player/player";

/** What the entry needs of the controls. */
interface EntryOptions {
  /** Return the button of a mode. */
  button(mode: HeadsetMode): HTMLElement;
  /** Show an English text for some seconds. */
  say(words: string): void;
  /** Called before a headset shows the reel. */
  begins(): void;
  /** Called when `presenting` has changed. */
  changed(): void;
}

/** Enters and leaves the headset of one player. */
export class HeadsetEntry {
  /** What the headset shows; null for nothing. */
  presenting: HeadsetMode | null = null;
  private headset: Headset | null = null;

  constructor(
    private readonly player: Player,
    private readonly options: EntryOptions,
  ) {
    for (const mode of ["vr", "ar"] as const)
      void supportsHeadset(mode).then((there) => (options.button(mode).hidden = !there));
  }

  /** Leave the headset. */
  leave(): void {
    this.headset?.leave();
  }

  /** Enter a mode, or leave the headset. Returns false if there is none. */
  toggle(mode: HeadsetMode): boolean {
    const { options, headset } = this;
    headset?.leave();
    if (headset) return true;
    if (options.button(mode).hidden) return false;
    options.begins();
    this.enter(mode).catch((error) => {
      console.warn(`Immersive ${mode} cannot start: ${messageOf(error)}`); // browsers word it for developers
      options.say(
        mode === "vr"
          ? "The headset cannot be used. Connect it, and let this page use it."
          : "Augmented reality cannot start. Let this page use the camera.",
      );
    });
    return true;
  }

  private async enter(mode: HeadsetMode): Promise<void> {
    const { player, options } = this;
    const { Headset } = await loadPart("headset.js", () => import("../player/headset"));
    if (mode === "ar") options.say("Look at the floor and tap to place the reel");
    this.headset = await Headset.enter(player, mode, () => {
      this.headset = this.presenting = null;
      options.changed();
    });
    this.presenting = mode;
    options.changed();
  }
}
