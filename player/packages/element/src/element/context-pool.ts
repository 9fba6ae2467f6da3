/** Shares graphics devices among elements. Browsers allow about sixteen per page and take the oldest away beyond that. */

/** Maximum number of devices, to leave some to the rest of the page. */
const MAX_DEVICES = 12;

/** An element that may hold a device. */
export interface ContextHolder {
  /** True if it may release its device unnoticed, since its image is static. */
  readonly idle: boolean;
  /** True if it must keep its device. */
  readonly needed: boolean;
  /** Acquire a device. */
  wake(): void;
  /** Release the device. */
  rest(): void;
}

/** Grants devices in order of requests, and takes them from idle holders. */
export class ContextPool {
  private readonly holding: ContextHolder[] = [];
  /** Holders that wait for a device, in order, and those that lost theirs. */
  private waiting: ContextHolder[] = [];
  private evicted: ContextHolder[] = [];

  constructor(private readonly most = MAX_DEVICES) {}

  /** Request a device. now: people interact with the holder, so that it takes precedence. */
  claim(holder: ContextHolder, now = false): void {
    const at = this.holding.indexOf(holder);
    if (at >= 0) return void this.holding.push(...this.holding.splice(at, 1)); // most recently used
    this.forget(holder);
    const victim =
      now && this.holding.length >= this.most ? (this.victim() ?? this.holding.find(({ needed }) => !needed)) : null;
    if (victim) this.evict(victim);
    if (now) this.waiting.unshift(holder);
    else this.waiting.push(holder);
    this.review();
  }

  /** Withdraw from the pool. */
  leave(holder: ContextHolder): void {
    this.forget(holder);
    const at = this.holding.indexOf(holder);
    if (at < 0) return;
    this.holding.splice(at, 1);
    holder.rest();
    this.review();
  }

  /** Grant devices again, after a holder became idle. */
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
