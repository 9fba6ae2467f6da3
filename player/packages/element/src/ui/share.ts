/** The share dialog: a link, its QR code, and code to embed the reel. This part is loaded on demand. */
import { encode } from "uqr";
import type { Words } from "../base/words";
import { copyText } from "./copy-text";
import { elementOf } from "./markup";
import fields from "./fields.css";
import styles from "./share.css";
import { adoptStyles } from "./styles";

/** Addresses and title to share. */
export interface Shared {
  /** Address of the page with the present time and view, and without. */
  link: string;
  page: string;
  /** Addresses of the manifest and of the player's module; null if other pages cannot load the module. */
  reel: string;
  player: string | null;
  title: string;
}

const PERMISSIONS = "fullscreen; clipboard-write; xr-spatial-tracking; autoplay";

const field = (name: string, label: string, lines: number): string => `<div class="field">
  <label for="share-${name}">${label}</label>
  <textarea id="share-${name}" name="${name}" rows="${lines}" readonly spellcheck="false"></textarea>
  <button type="button" class="copy">Copy</button>
</div>`;

const MARKUP = `<div class="share">
  <div class="fields">
    ${field("link", "Link", 2)}
    <label class="exact">At this time and view<input type="checkbox" role="switch" checked /></label>
    ${field("frame", "Embed in a page, as a frame", 2)}
    ${field("element", "Embed in a page, as an element", 2)}
  </div>
  <div class="code" role="img" aria-label="QR code of the link"></div>
</div>`;

/** Return the content of the dialog. root: of the dialog. say: shows whether a copy succeeded. */
export function shareOf(root: ShadowRoot, shared: Shared, t: Words, say: (words: string) => void): HTMLElement {
  adoptStyles(root, fields);
  adoptStyles(root, styles);
  const box = elementOf(MARKUP, t);
  const area = (name: string): HTMLTextAreaElement => box.querySelector<HTMLTextAreaElement>(`[name=${name}]`)!;
  const { player } = shared;
  area("element").parentElement!.hidden = !player;
  const exact = box.querySelector<HTMLInputElement>(".exact input")!;
  const update = (): void => {
    const link = exact.checked ? shared.link : shared.page;
    area("link").value = link;
    area("frame").value = frameOf(link, shared.title);
    area("element").value = player ? elementCodeOf(player, shared.reel) : "";
    box.querySelector(".code")!.replaceChildren(codeOf(link));
  };
  exact.onchange = update;
  for (const button of box.querySelectorAll<HTMLElement>(".copy")) {
    const text = button.parentElement!.querySelector("textarea")!;
    button.ariaLabel = `${t("Copy")}: ${text.parentElement!.querySelector("label")!.textContent}`;
    button.onclick = async () =>
      say((await copyText(text)) ? "Copied" : "Selected: copy it with the keyboard or the browser's menu");
    text.onfocus = () => text.select();
  }
  update();
  return box;
}

function frameOf(link: string, title: string): string {
  return `<iframe src="${escaped(link)}" title="${escaped(title || "Volumetric video")}" width="800" height="450" style="border: 0" allow="${PERMISSIONS}" allowfullscreen loading="lazy"></iframe>`;
}

function elementCodeOf(player: string, reel: string): string {
  return `<script type="module" src="${escaped(player)}"></script>\n<splat-reel src="${escaped(reel)}" controls loop></splat-reel>`;
}

function escaped(text: string): string {
  return text.replace(/[&"<>]/g, (mark) => `&#${mark.charCodeAt(0)};`);
}

/** Return a QR code, black on white in any color scheme, with the border that readers need. */
function codeOf(text: string): SVGElement {
  const { data, size } = encode(text, { ecc: "L", border: 3 });
  const squares = data.flatMap((row, y) => row.flatMap((dark, x) => (dark ? `M${x} ${y}h1v1h-1z` : [])));
  return elementOf<SVGElement>(
    `<svg viewBox="0 0 ${size} ${size}" shape-rendering="crispEdges"><path d="M0 0h${size}v${size}H0z" fill="#fff" stroke="none" /><path d="${squares.join("")}" fill="#000" stroke="none" /></svg>`,
  );
}
