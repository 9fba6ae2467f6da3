/** What a reel says of itself. Its words are text, whatever they hold. */
import type { Presentation } from "../reel/presentation";

/** Whether there is anything to say. */
export function saysAnything({ title, author, description, licence }: Presentation): boolean {
  return [title, author, description, licence].some((words) => words !== "");
}

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
