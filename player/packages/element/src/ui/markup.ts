/** Creation of elements. */
import { ENGLISH, type Words } from "../base/words";

/** A tag or a text of the player's markup. Values have double quotes, and tags without content end with a slash. */
const PIECES = /<(\/?)([\w-]+)((?:\s+[\w-]+(?:="[^"]*")?)*)\s*(\/?)>|([^<]+)/g;
const ATTRIBUTES = /([\w-]+)(?:="([^"]*)")?/g;
const SVG = "http://www.w3.org/2000/svg";

/**
 * Return the element of a piece of markup, in the language of `t`. Tags become elements one by one: pages that require Trusted Types
 * forbid `innerHTML`.
 */
export function elementOf<T extends Element = HTMLElement>(markup: string, t: Words = ENGLISH): T {
  const root = document.createDocumentFragment();
  let parent: Node = root;
  for (const [, end, name, attributes, single, text] of markup.matchAll(PIECES)) {
    if (end) parent = parent.parentNode!;
    else if (text) parent.appendChild(document.createTextNode(text.replaceAll("&lt;", "<")));
    else {
      const element =
        name === "svg" || parent instanceof SVGElement
          ? document.createElementNS(SVG, name)
          : document.createElement(name);
      for (const [, attribute, value = ""] of attributes.matchAll(ATTRIBUTES)) element.setAttribute(attribute, value);
      parent.appendChild(element);
      if (!single) parent = element;
    }
  }
  for (const element of root.querySelectorAll("*")) {
    if (t !== ENGLISH) translate(element, t);
    if (element instanceof HTMLElement && element.className) element.part.value = element.className; // for styles of the page
  }
  return root.firstElementChild as T;
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
