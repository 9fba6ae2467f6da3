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
