/** A sheet over the picture that people open, read and close: by its button, Esc, or a click outside. */
import { CLOSE } from "./icons";
import { elementOf } from "./markup";

export class Dialog {
  readonly box: HTMLElement;

  /** name: its class; closed: called whenever it was closed. */
  constructor(name: string, label: string, private readonly closed: () => void, signal: AbortSignal) {
    this.box = elementOf(`<div class="sheet dialog ${name}" role="dialog" aria-label="${label}" hidden><button type="button" class="close" aria-label="Close">${CLOSE}</button></div>`);
    this.closeButton.onclick = () => (this.open = false);
    document.addEventListener("pointerdown", (event) => {
      if (this.open && !event.composedPath().includes(this.box)) this.open = false;
    }, { signal });
  }

  get open(): boolean {
    return !this.box.hidden;
  }

  set open(open: boolean) {
    if (open === this.open) return;
    this.box.hidden = !open;
    if (open) this.closeButton.focus();
    else this.closed();
  }

  private get closeButton(): HTMLElement {
    return this.box.querySelector<HTMLElement>(".close")!;
  }
}
