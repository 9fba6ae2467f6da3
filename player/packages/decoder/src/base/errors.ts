/** Reasons why a reel does not play, for viewers. */
export const PLAIN = {
  damaged: "A part of the reel is damaged, or this player cannot read it.",
  device: "This browser cannot draw reels. Try another or a newer one.",
  missing: "There is no reel at this address, or a part of it is missing.",
  network: "The reel cannot be downloaded. Check the network, and try again.",
  newer: "The reel was made for a newer player.",
  other: "The file at this address is not a reel.",
  player: "The player failed. Its files may be missing, or the page may block it.",
  refused: "The site that hosts the reel does not let this page show it.",
};

/** An error of a reel. `message` is exact, for its author or host; `plain` is for viewers. */
export class ReelError extends Error {
  override name = "ReelError";
  readonly plain: string;

  constructor(
    message: string,
    { plain = PLAIN.damaged, ...options }: ErrorOptions & { plain?: string | undefined } = {},
  ) {
    super(message, options);
    this.plain = plain;
  }
}

/** Return true for a `ReelError`, also of a script that is loaded on demand and has a class of its own. */
export function isReelError(error: unknown): error is ReelError {
  return error instanceof Error && error.name === "ReelError";
}

/** Return the result of `work`. Errors are rethrown with the name of the section. */
export async function inSection<T>(name: string, work: () => T | Promise<T>): Promise<T> {
  try {
    return await work();
  } catch (error) {
    throw new ReelError(`section ${name}: ${messageOf(error)}`, { cause: error });
  }
}

/** Return the message of anything that was thrown. */
export function messageOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

/** The browser took the graphics device away. */
export class DeviceLostError extends Error {
  override name = "DeviceLostError";

  constructor() {
    super("The graphics device was lost. Playback continues when it is back.");
  }
}

/** Return the message of an error for viewers. */
export function plainWords(error: Error): string {
  if (isReelError(error)) return error.plain;
  return error instanceof DeviceLostError ? error.message : PLAIN.player;
}
