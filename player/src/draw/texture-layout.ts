/** Points lie row by row in textures this wide, and so does their order. */
export const TEXTURE_WIDTH = 1024;

/** Fills the last row of the order. */
export const NO_POINT = 2 ** 32 - 1;
