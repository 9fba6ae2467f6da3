/** The dialog about a reel. Its texts are inserted as text, never as markup. */
import type { Presentation } from "@splatreel/decoder/reel/presentation";

/** Return true if the reel has any such text. */
export function hasTexts({ title, author, description, licence }: Presentation): boolean {
  return [title, author, description, licence].some((words) => words !== "");
}

/** Return the content of the dialog. */
export function aboutOf({ author, description, licence }: Presentation): HTMLElement {
  const box = document.createElement("div");
  box.className = "about";
  const lines = [author && `By ${author}`, description, licence && `Licence: ${licence}`].filter((words) => words !== "");
  for (const words of lines) {
    const line = box.appendChild(document.createElement("p"));
    line.dir = "auto";
    line.textContent = words;
  }
  return box;
}
