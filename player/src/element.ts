/** <splat-reel src="…/manifest.json" autoplay loop controls>: a reel in a page. */
import { attachControls } from "./controls";
import { Player } from "./player";
import styles from "./ui.css";
import { Controls } from "./ui";

export class SplatReelElement extends HTMLElement {
  static readonly observedAttributes = ["src", "loop"];

  private current: Player | null = null;
  private detach: (() => void) | null = null;
  private resize: ResizeObserver | null = null;

  /** The player behind the element: time, events, camera, `renderAt`. Null while the element is not in a document. */
  get player(): Player | null {
    return this.current;
  }

  connectedCallback(): void {
    const root = this.shadowRoot ?? this.attachShadow({ mode: "open" });
    const style = document.createElement("style");
    style.textContent = styles;
    const canvas = document.createElement("canvas");
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "Volumetric video. Drag to look around, scroll to zoom.");
    root.replaceChildren(style, canvas);
    const player = new Player(canvas);
    this.current = player;
    player.loop = this.hasAttribute("loop");
    if (this.hasAttribute("controls")) new Controls(this, root, player);
    const focal = (): number => player.camera?.view(canvas.clientWidth, canvas.clientHeight).fx ?? 1;
    this.detach = attachControls(canvas, () => player.camera, focal, () => player.invalidate());
    this.resize = new ResizeObserver(() => player.invalidate());
    this.resize.observe(canvas);
    this.open();
  }

  disconnectedCallback(): void {
    this.detach?.();
    this.resize?.disconnect();
    this.current?.destroy();
    this.current = null;
  }

  attributeChangedCallback(name: string): void {
    if (!this.current) return;
    if (name === "loop") this.current.loop = this.hasAttribute("loop");
    if (name === "src") this.open();
  }

  private open(): void {
    const source = this.getAttribute("src");
    if (!source || !this.current) return;
    void this.current.load(source);
    const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (this.hasAttribute("autoplay") && !calm) this.current.play();
  }
}
