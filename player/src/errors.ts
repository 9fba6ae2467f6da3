/** An error whose message is meant for the person watching. */
export class ReelError extends Error {
  override name = "ReelError";
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
