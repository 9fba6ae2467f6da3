/** Servers that render pages import the player in Node, where there is no page. */
import assert from "node:assert/strict";
import { test } from "node:test";

test("the player is imported without a page", async () => {
  assert.ok(!("document" in globalThis) && !("HTMLElement" in globalThis));
  const { SplatReelElement, Player } = await import("../packages/element/src/main");
  assert.equal(typeof Player, "function");
  assert.equal(SplatReelElement.NETWORK_EMPTY, 0);
  assert.deepEqual(SplatReelElement.observedAttributes.slice(0, 2), ["src", "poster"]);
});
