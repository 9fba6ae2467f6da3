/** Steps in time. */
import type { Player } from "../player/player";

/** Go back or on by a part of the reel, at most `most` seconds. Negative parts go back. */
export function skip(player: Player, part: number, most: number): void {
  player.currentTime += Math.sign(part) * Math.min(Math.abs(part) * (player.duration - player.earliest), most);
}
