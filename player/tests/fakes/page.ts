/** The little of a page that the player's logic asks for: an address, a network, events of the window. */

export const page = new EventTarget();
export const device = { onLine: true, platform: "", deviceMemory: 2, userActivation: { hasBeenActive: true } };

const define = (name: string, value: unknown): unknown =>
  Object.defineProperty(globalThis, name, { value, configurable: true, writable: true });
define("location", new URL("https://page.example/index.html"));
define("self", globalThis);
define("origin", "https://page.example");
define("navigator", device);
define("addEventListener", page.addEventListener.bind(page));
define("removeEventListener", page.removeEventListener.bind(page));
define(
  "document",
  Object.assign(new EventTarget(), {
    querySelector: () => null,
    getElementById: () => null,
    baseURI: "https://page.example/index.html",
  }),
);
define("CSS", { escape: (text: string) => text });
