/** Creation of elements. */
import { ENGLISH, type Words } from "../base/words";

/** Return the element of a piece of markup, in the language of `t`. */
export function elementOf<T extends HTMLElement>(markup: string, t: Words = ENGLISH): T {
  const template = document.createElement("template");
  template.innerHTML = markup;
  if (t !== ENGLISH) for (const element of template.content.querySelectorAll("*")) translate(element, t);
  for (const element of template.content.querySelectorAll("[class]")) element.part.value = element.className; // for styles of the page
  return template.content.firstElementChild as T;
}

/** Translate the texts of an element, but not those of its children. */
function translate(element: Element, t: Words): void {
  for (const name of ["aria-label", "title"]) {
    // Titles end with a key in parentheses.
    const [, text, key] = /^(.*?)( \(\S\))?$/.exec(element.getAttribute(name) ?? "")!;
    if (text) element.setAttribute(name, t(text) + (key ?? ""));
  }
  for (const node of element.childNodes) {
    if (node instanceof Text) node.data = node.data.replace(/\S.*\S|\S/s, (text) => t(text));
  }
}
