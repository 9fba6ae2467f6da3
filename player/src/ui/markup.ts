/** An element from its markup. */
export function elementOf<T extends HTMLElement>(markup: string): T {
  const template = document.createElement("template");
  template.innerHTML = markup;
  return template.content.firstElementChild as T;
}
