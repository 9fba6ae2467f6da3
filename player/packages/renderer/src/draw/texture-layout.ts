/** Width of the textures that hold points and their order, row by row. */
export const TEXTURE_WIDTH = 1024;

/** Entry that fills the last row of the order. */
export const NO_POINT = 2 ** 32 - 1;
