declare module "*.css" {
  const text: string;
  export default text;
}

declare module "*.wasm" {
  const bytes: Uint8Array<ArrayBuffer>;
  export default bytes;
}

/** The bundle, beside which the page's first script lies. */
declare module "*/player.js";
