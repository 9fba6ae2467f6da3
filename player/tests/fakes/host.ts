/** A host that answers as a test tells it to. */

export interface Asked {
  url: string;
  range: string | null;
  cache: string | undefined;
  mode: string | undefined;
  /** Value of the header Authorization, and whether cookies go to other hosts. */
  authorization: string | null;
  credentials: string | undefined;
  /** Milliseconds. */
  at: number;
}

export type Answer = (options: RequestInit, url: string) => Response;

/** In place of fetch, from when it is made. */
export class FakeHost {
  readonly asked: Asked[] = [];
  /** What it answers, one after the other; the last one from then on. */
  answers: Answer[] = [];

  constructor() {
    globalThis.fetch = async (url, options = {}) => {
      const [range, authorization] = ["range", "authorization"].map((name) => new Headers(options.headers).get(name));
      const { cache, mode, credentials } = options;
      this.asked.push({ url: String(url), range, authorization, cache, mode, credentials, at: performance.now() });
      options.signal?.throwIfAborted();
      return (this.answers.length > 1 ? this.answers.shift()! : this.answers[0])(options, String(url));
    };
  }

  /** Forget what was asked, and answer like this. */
  answer(...answers: Answer[]): void {
    this.asked.length = 0;
    this.answers = answers;
  }
}

export const whole =
  (bytes: Uint8Array | string): Answer =>
  () =>
    new Response(bytes as BodyInit);
export const status =
  (code: number): Answer =>
  () =>
    new Response("", { status: code });
export const unreachable: Answer = () => {
  throw new TypeError("Failed to fetch");
};

/** From where the request asks for it on. */
export const ranged =
  (bytes: Uint8Array): Answer =>
  ({ headers }) => {
    const from = Number(/^bytes=(\d+)-$/.exec(new Headers(headers).get("range") ?? "")?.[1] ?? 0);
    return new Response(bytes.slice(from) as BodyInit, { status: from > 0 ? 206 : 200 });
  };

/** These pieces, so many milliseconds apart, and then the connection breaks ("broken"), nothing follows ("silent") or it is all ("over"). */
export const pieces =
  (parts: Uint8Array[], then: "broken" | "silent" | "over", code = 200, pause = 0): Answer =>
  ({ signal }) => {
    const left = [...parts];
    const body = new ReadableStream<Uint8Array>(
      {
        start: (controller) => signal?.addEventListener("abort", () => controller.error(signal.reason)),
        pull: async (controller) => {
          if (pause > 0) await new Promise<void>((resolve) => setTimeout(resolve, pause));
          const part = left.shift();
          if (signal?.aborted) return;
          if (part) controller.enqueue(part);
          else if (then === "broken") controller.error(new TypeError("network error"));
          else if (then === "over") controller.close();
          else await new Promise(() => undefined);
        },
      },
      { highWaterMark: 0 },
    );
    return new Response(body, { status: code });
  };
