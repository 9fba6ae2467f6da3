/** Resolve when `reached` returns true, which is checked on each event; reject when the player has an error. */
export function waitUntil(
  player: EventTarget & { error: Error | null },
  event: string,
  reached: () => boolean,
): Promise<void> {
  return new Promise((resolve, reject) => {
    const check = (): void => {
      if (player.error) reject(player.error);
      else if (reached()) resolve();
      else return;
      player.removeEventListener(event, check);
      player.removeEventListener("error", check);
    };
    player.addEventListener(event, check);
    player.addEventListener("error", check);
    check();
  });
}
