/** The menu of a right click on the picture. This part is loaded on demand. */
import styles from "./context-menu.css";
import type { Player } from "../player/player";
import { elementOf } from "./markup";
import { adoptStyles, markOverflow } from "./styles";

/** Actions of the entries. */
export interface ContextActions {
  /** Address of the page with the present time and view; null if the page opens none. */
  link: string | null;
  /** Show a text for some seconds. */
  say(words: string): void;
  share(): void;
  section(): void;
  walk(): void;
  statistics(): void;
  /** Null if the reel has no texts. */
  about: (() => void) | null;
  help(): void;
}

/** Space to the edges of the picture, in pixels. */
const EDGE = 4;

/** The open menu. */
export class ContextMenu {
  private readonly box = elementOf(`<div class="sheet context" role="menu"></div>`);
  private readonly life = new AbortController();

  /** Open the menu at a position of the holder, in pixels. */
  constructor(
    root: ShadowRoot,
    holder: HTMLElement,
    [x, y]: [number, number],
    private readonly player: Player,
    private readonly actions: ContextActions,
  ) {
    const {
      box,
      life: { signal },
    } = this;
    adoptStyles(root, styles);
    box.ariaLabel = player.words("Menu of the picture");
    this.fill();
    holder.append(box);
    markOverflow(box);
    box.style.left = `${Math.max(Math.min(x, holder.clientWidth - box.offsetWidth - EDGE), EDGE)}px`;
    box.style.top = `${Math.max(Math.min(y, holder.clientHeight - box.offsetHeight - EDGE), EDGE)}px`;
    box.addEventListener("keydown", (event) => this.key(event));
    box.addEventListener("contextmenu", (event) => event.preventDefault());
    document.addEventListener("pointerdown", (event) => void (event.composedPath().includes(box) || this.close()), {
      signal,
    });
    addEventListener("blur", () => this.close(), { signal });
    this.items[0].focus();
  }

  /** Close the menu. */
  close(): void {
    if (this.life.signal.aborted) return;
    this.life.abort();
    this.box.remove();
    this.player.canvas.focus();
  }

  private get items(): HTMLElement[] {
    return [...this.box.children] as HTMLElement[];
  }

  private fill(): void {
    const { actions, player } = this;
    const add = (text: string, act: (() => void) | null): void =>
      void (act && this.box.append(this.entryOf(text, act)));
    add("Copy a link to this time and view", actions.link === null ? null : () => void this.copyLink(actions.link!));
    add(player.section ? "Stop repeating" : "Repeat a part", () => actions.section());
    add("Walk mode", () => actions.walk());
    add("Statistics", () => actions.statistics());
    add("About this reel", actions.about);
    add("Keys and gestures", () => actions.help());
  }

  /** Copy the link, or show it where the browser does not allow that. */
  private async copyLink(link: string): Promise<void> {
    const copied = await navigator.clipboard?.writeText(link).then(
      () => true,
      () => false,
    );
    if (copied) this.actions.say("Copied");
    else this.actions.share();
  }

  private entryOf(text: string, act: () => void): HTMLElement {
    const entry = elementOf(`<button type="button" role="menuitem" tabindex="-1"></button>`);
    entry.textContent = this.player.words(text);
    entry.onclick = () => {
      this.close();
      act();
    };
    return entry;
  }

  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const { items } = this;
    const at = items.indexOf(event.target as HTMLElement);
    const ways: Record<string, number> = {
      ArrowDown: at + 1,
      ArrowUp: at - 1 + items.length,
      Home: 0,
      End: items.length - 1,
    };
    if (event.key in ways) items[ways[event.key] % items.length].focus();
    else if (event.key === "Escape" || event.key === "Tab") this.close();
    else return event.stopPropagation(); // the browser clicks the entry for Enter and Space, and has keys of its own
    event.preventDefault();
    event.stopPropagation();
  }
}
