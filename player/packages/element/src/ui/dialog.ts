/** A modal dialog, closed by its button, Esc, or a click outside. This part is loaded on demand. */
import type { Words } from "../base/words";
import styles from "./dialog.css";
import { CLOSE } from "./icons";
import { elementOf } from "./markup";
import { adoptStyles, markOverflow } from "./styles";

const MARKUP = `<div class="sheet dialog" role="dialog" aria-modal="true" hidden>
  <button type="button" class="close" aria-label="Close">${CLOSE}</button>
  <h2 dir="auto"></h2>
  <div class="content"></div>
</div>`;

/** The dialog of one player. */
export class Dialog {
  readonly box: HTMLElement;
  private readonly button: HTMLElement;
  private readonly mark: () => void;

  /** root: of the element. closed: called when the dialog closes. */
  constructor(
    root: ShadowRoot,
    private readonly closed: () => void,
    t: Words,
    signal: AbortSignal,
  ) {
    adoptStyles(root, styles);
    this.box = elementOf(MARKUP, t);
    this.button = this.box.querySelector(".close")!;
    this.mark = markOverflow(this.box);
    this.button.onclick = () => this.close();
    this.box.addEventListener("keydown", (event) => event.key === "Tab" && this.trapFocus(event));
    document.addEventListener(
      "pointerdown",
      (event) => void (event.composedPath().includes(this.box) || this.close()),
      { signal },
    );
  }

  /** Title of the open dialog; "" if it is closed. */
  get open(): string {
    return this.box.hidden ? "" : this.box.ariaLabel!;
  }

  show(title: string, content: HTMLElement): void {
    this.box.ariaLabel = title;
    this.box.querySelector("h2")!.textContent = title;
    this.box.querySelector(".content")!.replaceChildren(content);
    this.box.hidden = false;
    this.button.focus();
    this.mark();
  }

  /** Keep the focus within the dialog. */
  private trapFocus(event: KeyboardEvent): void {
    const stops = [
      ...this.box.querySelectorAll<HTMLElement>("button, input, textarea, select, summary, a[href]"),
    ].filter((stop) => stop.getClientRects().length > 0);
    const [first, last] = event.shiftKey ? [stops[0], stops.at(-1)!] : [stops.at(-1)!, stops[0]];
    if (event.composedPath()[0] !== first) return;
    event.preventDefault();
    last.focus();
  }

  close(): void {
    if (!this.open) return;
    this.box.hidden = true;
    this.closed();
  }
}
