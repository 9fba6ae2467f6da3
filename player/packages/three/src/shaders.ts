/** Shaders of the second pass with depth: splats are tested against the depth of meshes, and may write their own. */
import { splatFragmentOf, splatVertexOf } from "splatreel-player/webgl/shaders";

/** Depth of a splat's center by the projection matrix: uDepth holds the elements 10 and 14. */
export const depthVertex = splatVertexOf("uDepth.y / uintBitsToFloat(color.w) - uDepth.x", "uniform vec2 uDepth;\n");

/** uCutoff: least alpha to draw. uLinear: the target holds linear colors instead of sRGB. uOpacity: factor on alpha. */
export const depthFragment = splatFragmentOf(
  `alpha *= uOpacity;
  if (alpha < uCutoff) discard;
  vec3 color = vColor.rgb;
  if (uLinear) color = mix(color / 12.92, pow((color + 0.055) / 1.055, vec3(2.4)), step(0.04045, color));
  outColor = vec4(color * alpha, alpha);`,
  "uniform float uCutoff, uOpacity;\nuniform bool uLinear;\n",
);
