/** States of the element that styles select: `:state(idle)`, `:state(clear)` and `:state(filling)`. Its classes belong to the page. */

/** An element with such states. */
export type HostWithStates = HTMLElement & { readonly states: HostStates };

/** The states of one element. Browsers without custom states get attributes instead, `data-splatreel-idle`. */
export class HostStates {
  private readonly custom: Set<string> | null;

  constructor(private readonly host: HTMLElement) {
    this.custom = CSS.supports("selector(:state(idle))") ? host.attachInternals().states : null;
  }

  has(name: string): boolean {
    return this.custom?.has(name) ?? this.host.hasAttribute(`data-splatreel-${name}`);
  }

  /** Set or clear a state; without `on`, change it. */
  toggle(name: string, on = !this.has(name)): void {
    if (!this.custom) this.host.toggleAttribute(`data-splatreel-${name}`, on);
    else if (on) this.custom.add(name);
    else this.custom.delete(name);
  }
}
