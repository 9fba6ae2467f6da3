/** Opens local reels: a dropped folder or zip, or chosen files if the page has no reel. This part is loaded on demand. */
import { type LocalFiles, messageOf, PLAIN } from "@splatreel/decoder/internal";
import { loadPart } from "@splatreel/renderer";
import type { Player } from "../player/player";
import styles from "./drop.css";
import { directionOf } from "../base/words";
import { elementOf } from "./markup";
import { adoptStyles } from "./styles";

const WORDS = "Drop its folder here, or a zip of it.";
const MARKUP = `<div class="drop" hidden><div class="sheet choice">
  <h2>Open a reel</h2>
  <p role="status">${WORDS}</p>
  <div class="choices">
    <button type="button" class="folder">Open a folder</button><button type="button" class="zip">Open a zip</button>
    <input type="file" class="folder" webkitdirectory hidden /><input type="file" class="zip" accept=".zip,application/zip" hidden />
  </div>
</div></div>`;

/** An element with the attribute `drop`. With `drop="ask"` it asks for a reel if it has none. */
export interface FileDropHost extends HTMLElement {
  readonly player: Player;
  srcObject: LocalFiles | null;
}

/** Drop target and dialog of one element. */
export class FileDrop {
  private readonly box: HTMLElement;
  /** Text shown while there is no reel; "" otherwise. */
  private question = "";

  /** Accept drops on the host until the signal. */
  constructor(
    private readonly host: FileDropHost,
    root: ShadowRoot,
    signal: AbortSignal,
  ) {
    adoptStyles(root, styles);
    this.box = elementOf(MARKUP, host.player.words);
    this.box.dir = directionOf(host.player.language);
    if (signal.aborted) return;
    root.append(this.box);
    signal.addEventListener("abort", () => this.box.remove());
    host.addEventListener("dragover", (event) => this.hover(event), { signal });
    host.addEventListener(
      "dragleave",
      (event) => void (host.contains(event.relatedTarget as Node | null) || this.settle()),
      { signal },
    );
    this.box.addEventListener("click", (event) => event.target === this.box && this.settle());
    this.box.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      this.settle();
      if (this.box.hidden) event.preventDefault();
    });
    for (const name of ["folder", "zip"]) this.listen(name);
    if (host.getAttribute("drop") !== "ask") return;
    host.player.addEventListener("error", () => this.ask(), { signal });
    this.ask();
  }

  private listen(name: string): void {
    const input = this.box.querySelector<HTMLInputElement>(`input.${name}`)!;
    this.box.querySelector<HTMLElement>(`button.${name}`)!.onclick = () => input.click();
    input.onchange = () => {
      const files = [...input.files!];
      input.value = ""; // allow the same file to be chosen again
      if (files.length > 0) void this.open((opener) => opener.openFiles(files));
    };
  }

  /** Ask people for a reel if the page has none. */
  private ask(): void {
    const { host } = this;
    const { error, manifest } = host.player;
    const { plain } = (error ?? {}) as { plain?: string }; // this part has a class ReelError of its own
    if (manifest || host.srcObject || plain !== PLAIN.missing) return;
    host.removeAttribute("src");
    const t = host.player.words;
    this.question = `${t("There is none beside this page.")} ${t(WORDS)}`;
    this.settle();
  }

  private hover(event: DragEvent): void {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    this.box.hidden = false;
    this.box.classList.add("over");
    this.say(this.host.player.words(WORDS));
  }

  /** Open the dropped entries or files. */
  take(entries: FileSystemEntry[], files: File[]): void {
    void this.open((opener) => opener.openDropped({ entries, files }));
  }

  private async open(read: (opener: typeof import("../files/open-files")) => Promise<LocalFiles>): Promise<void> {
    try {
      const files = await read(await loadPart("open-files.js", () => import("../files/open-files")));
      this.question = "";
      this.settle();
      this.host.srcObject = files;
    } catch (error) {
      this.say(messageOf(error));
      this.box.hidden = false;
      this.box.classList.remove("over");
    }
  }

  private say(words: string): void {
    this.box.querySelector("p")!.textContent = words;
  }

  private settle(): void {
    this.box.classList.remove("over");
    this.box.hidden = !this.question;
    this.say(this.question);
  }
}
