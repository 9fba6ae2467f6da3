declare module "*.css" {
  const text: string;
  export default text;
}

/** The bundle, beside which the page's first script lies. */
declare module "*/player.js";
