/** Repetition of a part of the reel, chosen in steps: its start, its end, nothing. This part is loaded on demand. */
import type { Player } from "../player/player";
import { timeText } from "./time-text";

/** Starts of sections whose end is not chosen yet, in seconds. */
const starts = new WeakMap<Player, number>();

/** Take the next step. say: shows it to people. */
export function stepSection(player: Player, say: (words: string) => void): void {
  const { currentTime, words: t } = player;
  const start = starts.get(player);
  starts.delete(player);
  if (player.section) {
    player.section = null;
    say(t("Nothing repeats"));
  } else if (start === undefined) {
    starts.set(player, currentTime);
    say(t("Repeats from {0}. Choose the end the same way.", timeText(currentTime, true)));
  } else if (currentTime > start) {
    player.section = [start, currentTime];
    player.currentTime = start;
    say(t("Repeats {0} to {1}", timeText(start, true), timeText(currentTime, true)));
  } else say(t("The end must come after the start"));
}
