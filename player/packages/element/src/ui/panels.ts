/** What opens over the picture: menus, dialogs, panels, statistics and the walk mode. This part and theirs are loaded on demand. */
import { isReelError, messageOf, type Presentation } from "@splatreel/decoder/internal";
import { loadPart } from "@splatreel/renderer";
import { LACKING } from "../base/words";
import type { Player } from "../player/player";
import type { Dialog } from "./dialog";
import type { Actions, KeyTable } from "./keys";
import type { Menu, MenuState } from "./menu";
import type { PathHost } from "./path-panel";
import type { Statistics } from "./statistics";

/** English title of the help. */
const HELP = "Keys and gestures";

/** What the panels need of the controls. */
export interface PanelOptions {
  readonly host: PathHost & { readonly link: string };
  readonly root: ShadowRoot;
  readonly player: Player;
  /** Element of all controls. */
  readonly holder: HTMLElement;
  readonly keys: KeyTable;
  /** Actions that the menu shares with keys. */
  readonly actions: Actions;
  /** Button of the menu. */
  readonly settings: HTMLElement;
  /** Address of the player's module for other pages; null if it is bundled. */
  readonly address: string | null;
  /** Show an English text for some seconds. */
  say(words: string): void;
  /** Show a text in the language of the player for some seconds. */
  toast(text: string): void;
  /** Aborted when the controls are removed. */
  readonly signal: AbortSignal;
}

/** Something that can be closed. */
interface Closable {
  close(): void;
}

/** Opens and closes the panels of one element. */
export class Panels {
  private menu: Menu | null = null;
  private dialog: Dialog | null = null;
  private statistics: Statistics | null = null;
  private path: Closable | null = null;
  private walk: Closable | null = null;
  private editing: Closable | null = null;

  constructor(private readonly options: PanelOptions) {
    options.signal.addEventListener("abort", () => {
      for (const panel of [this.walk, this.path, this.editing]) panel?.close();
    });
  }

  /** True while a menu or a dialog is open. */
  get open(): boolean {
    return this.menu?.open === true || !!this.dialog?.open;
  }

  /** Show the present state. */
  update(): void {
    this.menu?.update();
  }

  /** Close the open dialog or menu, or else end the walk. Returns false if there is none of them. */
  closeTop(): boolean {
    if (this.dialog?.open) this.dialog.close();
    else if (this.menu?.open) {
      this.openMenu(false);
      this.options.settings.focus();
    } else if (this.walk) this.walk.close();
    else return false;
    return true;
  }

  toggleMenu(): void {
    this.openMenu(!this.menu?.open);
  }

  /** Open or close the menu. */
  openMenu(open: boolean): void {
    if (!this.menu) return void (open && this.createMenu());
    this.menu.open = open;
    this.options.settings.setAttribute("aria-expanded", String(open));
  }

  private createMenu(): void {
    const { host, root, player, holder } = this.options;
    const actions = {
      ...this.options.actions,
      share: () => this.share(),
      about: () => this.about(),
      path: () => this.openPath(),
      edit: () => this.openEdit(),
      loop: (on: boolean) => void host.toggleAttribute("loop", on),
    };
    const state = (): MenuState => {
      const { manifest } = player;
      return {
        statistics: this.statistics?.shown === true,
        shares: host.hasAttribute("share") && !!manifest && !manifest.files,
        describes: !!manifest && hasTexts(manifest.presentation),
      };
    };
    void this.withPart(
      loadPart("menu.js", () => import("./menu")),
      ({ Menu }) => {
        if (this.menu) return;
        this.menu = new Menu(root, player, actions, state);
        holder.append(this.menu.box);
        this.openMenu(true);
      },
    );
  }

  /** Open the context menu at a position of the picture, in layout pixels; null for its middle. */
  openContext(at: [number, number] | null): void {
    const { host, root, holder, player, say } = this.options;
    if (!player.manifest) return;
    const place = at ?? [player.canvas.offsetWidth / 2, player.canvas.offsetHeight / 2];
    const actions = {
      link: host.hasAttribute("share") && !player.manifest.files ? host.link : null,
      say,
      share: () => this.share(),
      section: () => this.stepSection(),
      walk: () => this.toggleWalk(),
      statistics: () => this.toggleStatistics(),
      about: hasTexts(player.manifest.presentation) ? () => this.about() : null,
      help: () => void this.help(),
    };
    void this.withPart(
      loadPart("context-menu.js", () => import("./context-menu")),
      ({ ContextMenu }) => new ContextMenu(root, holder, place as [number, number], player, actions),
    );
  }

  /** Take the next step of the repetition of a part of the reel. */
  stepSection(): void {
    const { player, toast } = this.options;
    void this.withPart(
      loadPart("section.js", () => import("./section")),
      ({ stepSection }) => stepSection(player, toast),
    );
  }

  /** Save a picture of the present view. */
  async saveScreenshot(): Promise<void> {
    const { player, say } = this.options;
    try {
      const { saveScreenshot } = await loadPart("screenshot.js", () => import("./screenshot"));
      await saveScreenshot(player);
    } catch (error) {
      console.warn(`The picture cannot be saved: ${messageOf(error)}`);
      say(isReelError(error) ? error.plain : "The picture cannot be saved");
    }
  }

  /** Begin or end a walk. */
  toggleWalk(): void {
    this.openMenu(false);
    if (this.walk) return this.walk.close();
    const { root, holder, player, say } = this.options;
    void this.withPart(
      loadPart("walk-mode.js", () => import("./walk-mode")),
      ({ WalkMode }) => {
        if (this.walk || !player.camera || player.presented) return;
        this.walk = new WalkMode(root, holder, player, say, () => (this.walk = null));
      },
    );
  }

  /** End a walk. */
  endWalk(): void {
    this.walk?.close();
  }

  private openPath(): void {
    this.openMenu(false);
    if (this.path) return this.path.close();
    const { host, root, player } = this.options;
    void this.withPart(
      loadPart("path-panel.js", () => import("./path-panel")),
      ({ PathPanel }) => {
        if (this.path || !player.camera) return;
        this.path = new PathPanel(host, root, () => {
          this.path = null;
          player.canvas.focus();
        });
      },
    );
  }

  /** Open the panel that makes an edit list. */
  private openEdit(): void {
    this.openMenu(false);
    if (this.editing) return this.editing.close();
    const { root, player } = this.options;
    void this.withPart(
      loadPart("edit-panel.js", () => import("./edit-panel")),
      ({ EditPanel }) => {
        if (this.editing || !player.camera) return;
        this.path?.close();
        this.editing = new EditPanel(player, root, () => {
          this.editing = null;
          player.canvas.focus();
        });
      },
    );
  }

  /** Show or hide the statistics. */
  toggleStatistics(): void {
    const { root, holder, player, signal } = this.options;
    void this.withPart(
      loadPart("statistics.js", () => import("./statistics")),
      ({ Statistics }) => {
        this.statistics ??= new Statistics(root, holder, player, signal);
        this.statistics.toggle();
        this.update();
      },
    );
  }

  /** Show or hide the help. */
  toggleHelp(): void {
    if (this.dialog?.open === this.options.player.words(HELP)) this.dialog.close();
    else void this.help();
  }

  private help(): Promise<void> {
    const {
      root,
      keys,
      player: { words },
    } = this.options;
    return this.withPart(
      loadPart("help.js", () => import("./help")),
      ({ helpOf }) => this.show(words(HELP), helpOf(root, keys, words)),
    );
  }

  private about(): void {
    const { words, manifest } = this.options.player;
    const { presentation } = manifest!;
    void this.withPart(
      loadPart("about.js", () => import("./about")),
      ({ aboutOf }) => this.show(presentation.title || words("About this reel"), aboutOf(presentation, words)),
    );
  }

  private share(): void {
    const {
      host,
      root,
      say,
      address,
      player: { manifest, words },
    } = this.options;
    this.openMenu(false);
    void this.withPart(
      loadPart("share.js", () => import("./share")),
      ({ shareOf }) => {
        const [page] = location.href.split("#");
        const {
          url: reel,
          presentation: { title },
        } = manifest!;
        this.show(words("Share"), shareOf(root, { link: host.link, page, reel, player: address, title }, words, say));
      },
    );
  }

  private show(title: string, content: HTMLElement): void {
    this.openMenu(false);
    const { root, player, holder, signal } = this.options;
    void this.withPart(
      loadPart("dialog.js", () => import("./dialog")),
      ({ Dialog }) => {
        this.dialog ??= new Dialog(root, () => player.canvas.focus(), player.words, signal);
        holder.append(this.dialog.box);
        this.dialog.show(title, content);
      },
    );
  }

  /** Load a part of the player and use it, unless the controls are gone by then. */
  private async withPart<T>(loading: Promise<T>, use: (part: T) => void): Promise<void> {
    try {
      const part = await loading;
      if (!this.options.signal.aborted) use(part);
    } catch {
      this.options.say(LACKING);
    }
  }
}

/** Return true if the reel has any such text. */
function hasTexts({ title, author, description, licence }: Presentation): boolean {
  return [title, author, description, licence].some((words) => words !== "");
}
