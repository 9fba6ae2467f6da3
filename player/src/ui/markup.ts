/** Creation of elements. */

/** Return the element of a piece of markup. */
export function elementOf<T extends HTMLElement>(markup: string): T {
  const template = document.createElement("template");
  template.innerHTML = markup;
  return template.content.firstElementChild as T;
}
