/** Time that passes only when a test says so. */

interface Timer {
  at: number;
  call: () => void;
}

/** In place of performance.now, setTimeout and clearTimeout, from when it is made. */
export class FakeTime {
  /** Milliseconds. */
  now = 0;
  private readonly timers = new Map<number, Timer>();
  private next = 1;

  constructor() {
    performance.now = () => this.now;
    globalThis.setTimeout = ((call: () => void, milliseconds = 0) => {
      this.timers.set(this.next, { at: this.now + milliseconds, call });
      return this.next++;
    }) as unknown as typeof setTimeout;
    globalThis.clearTimeout = ((id: number) => void this.timers.delete(id)) as unknown as typeof clearTimeout;
  }

  /** Timers that are set. */
  get pending(): number {
    return this.timers.size;
  }

  /** Let so many milliseconds pass; what they set off is over then, also what that sets off within them. */
  async pass(milliseconds: number): Promise<void> {
    const end = this.now + milliseconds;
    await settled();
    for (;;) {
      const [id, timer] = [...this.timers].sort(([, a], [, b]) => a.at - b.at)[0] ?? [];
      if (!timer || timer.at > end) break;
      this.timers.delete(id!);
      this.now = Math.max(this.now, timer.at);
      timer.call();
      await settled();
    }
    this.now = end;
  }

  /** Let time pass until a promise is settled, an hour at most. */
  async until<T>(promise: Promise<T>): Promise<T> {
    let over = false;
    const done = (): void => void (over = true);
    promise.then(done, done);
    for (let i = 0; i < 36_000 && !over; i++) await this.pass(100);
    return promise;
  }
}

/** Resolves once promises that can be settled are. */
export async function settled(): Promise<void> {
  for (let i = 0; i < 6; i++) await new Promise((resolve) => setImmediate(resolve));
}
