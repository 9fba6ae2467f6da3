/** Who may hold a graphics device: browsers keep some sixteen for a page, and take the oldest away from whoever has it. */

/** Leaves some to the rest of the page. */
const MOST = 12;

export interface ContextHolder {
  /** Nobody misses anything if it gives its device back now: its picture stays, and nothing moves in it. */
  readonly idle: boolean;
  /** Somebody waits for what it does now. */
  readonly needed: boolean;
  /** Take a device. */
  wake(): void;
  /** Give it back. */
  rest(): void;
}

export class ContextPool {
  private readonly holding: ContextHolder[] = [];
  /** Those that want one, in turn, and those that had to give theirs back. */
  private waiting: ContextHolder[] = [];
  private evicted: ContextHolder[] = [];

  constructor(private readonly most = MOST) {}

  /** Ask for a device. now: somebody's hand is on it, which goes before those that play. */
  claim(holder: ContextHolder, now = false): void {
    const at = this.holding.indexOf(holder);
    if (at >= 0) return void this.holding.push(...this.holding.splice(at, 1)); // used last
    this.forget(holder);
    const victim = now && this.holding.length >= this.most ? (this.victim() ?? this.holding.find(({ needed }) => !needed)) : null;
    if (victim) this.evict(victim);
    if (now) this.waiting.unshift(holder);
    else this.waiting.push(holder);
    this.review();
  }

  /** Want none any more. */
  leave(holder: ContextHolder): void {
    this.forget(holder);
    const at = this.holding.indexOf(holder);
    if (at < 0) return;
    this.holding.splice(at, 1);
    holder.rest();
    this.review();
  }

  /** See who may have one now: a holder has become idle. */
  review(): void {
    while (this.waiting.length > 0 && (this.holding.length < this.most || this.victim())) {
      if (this.holding.length >= this.most) this.evict(this.victim()!);
      this.grant(this.waiting.shift()!);
    }
    while (this.evicted.length > 0 && this.holding.length < this.most) this.grant(this.evicted.pop()!);
  }

  private victim(): ContextHolder | undefined {
    return this.holding.find((holder) => holder.idle);
  }

  private grant(holder: ContextHolder): void {
    this.holding.push(holder);
    holder.wake();
  }

  private evict(holder: ContextHolder): void {
    this.holding.splice(this.holding.indexOf(holder), 1);
    this.evicted.push(holder);
    holder.rest();
  }

  private forget(holder: ContextHolder): void {
    this.waiting = this.waiting.filter((other) => other !== holder);
    this.evicted = this.evicted.filter((other) => other !== holder);
  }
}
