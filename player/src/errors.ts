/** An error whose message is meant for the person watching. */
export class ReelError extends Error {
  override name = "ReelError";
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
