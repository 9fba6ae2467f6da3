/** Why a reel does not play, in the words of people who did not make it. */
export const PLAIN = {
  damaged: "A part of the reel is damaged, or of a kind that this player does not know.",
  device: "This browser cannot draw reels. Another one, or a newer one, may.",
  missing: "There is no reel at this address, or a part of it is missing.",
  network: "The reel cannot be downloaded. Check the network, and try again.",
  newer: "The reel was made for a newer player.",
  other: "What is at this address is no reel.",
  player: "The player failed. Its files may be missing, or this page may not let it run.",
  refused: "The site that has the reel does not let this page show it.",
};

/** What went wrong with a reel. The message is exact, for whoever made or serves it; `plain` is for whoever watches. */
export class ReelError extends Error {
  override name = "ReelError";
  readonly plain: string;

  constructor(message: string, { plain = PLAIN.damaged, ...options }: ErrorOptions & { plain?: string | undefined } = {}) {
    super(message, options);
    this.plain = plain;
  }
}

/** What `work` gives; an error of it then names the section. */
export async function inSection<T>(name: string, work: () => T | Promise<T>): Promise<T> {
  try {
    return await work();
  } catch (error) {
    throw new ReelError(`section ${name}: ${messageOf(error)}`, { cause: error });
  }
}

export function messageOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

export class DeviceLostError extends Error {
  override name = "DeviceLostError";

  constructor() {
    super("The graphics device was lost. The player goes on when it is back.");
  }
}

/** What to tell whoever watches. */
export function plainWords(error: Error): string {
  if (error instanceof ReelError) return error.plain;
  return error instanceof DeviceLostError ? error.message : PLAIN.player;
}
