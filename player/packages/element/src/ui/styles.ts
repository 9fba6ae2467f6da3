/** Styles of shadow roots. */

const sheets = new Map<string, CSSStyleSheet>();

/** Add styles to a shadow root, once. A page's policy may forbid style elements, but not these. */
export function adoptStyles(root: ShadowRoot, styles: string): void {
  const sheet = sheets.get(styles) ?? new CSSStyleSheet();
  if (root.adoptedStyleSheets.includes(sheet)) return;
  sheet.replaceSync(styles);
  sheets.set(styles, sheet);
  root.adoptedStyleSheets = [...root.adoptedStyleSheets, sheet];
}

/** Let the lower edge of a box fade while there is more to scroll to. Returns a function to call after its content changed. */
export function markOverflow(box: HTMLElement): () => void {
  const update = (): void => void box.classList.toggle("more", box.scrollHeight - box.scrollTop - box.clientHeight > 8);
  box.addEventListener("scroll", update, { passive: true });
  box.addEventListener("toggle", update, { capture: true });
  new ResizeObserver(update).observe(box);
  return update;
}
