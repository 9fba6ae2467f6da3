/** Folds a panel to its header, so that it does not cover the picture. */

/** Let the button `fold` in the header of a panel fold and unfold the rest. */
export function foldByHeader(panel: HTMLElement): void {
  const button = panel.querySelector<HTMLElement>(".fold")!;
  button.onclick = () => {
    const folded = panel.classList.toggle("folded");
    button.ariaExpanded = String(!folded);
  };
}
