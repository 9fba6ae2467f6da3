/** The dialog about a reel. Its texts are inserted as text, never as markup. This part is loaded on demand. */
import type { Words } from "../base/words";
import type { Presentation } from "@splatreel/decoder/internal";

/** Return the content of the dialog. */
export function aboutOf({ author, description, licence }: Presentation, t: Words): HTMLElement {
  const box = document.createElement("div");
  box.className = "about";
  const lines = [author && t("By {0}", author), description, licence && t("License: {0}", licence)].filter(
    (words) => words !== "",
  );
  for (const words of lines) {
    const line = box.appendChild(document.createElement("p"));
    line.dir = "auto";
    line.textContent = words;
  }
  return box;
}
