/** An error whose message is meant for the person watching. */
export class ReelError extends Error {
  override name = "ReelError";
}

export function messageOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
