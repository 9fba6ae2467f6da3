/** Shaders of the second pass with depth: splats are tested against the depth of meshes, and may write their own. */
import { splatFragmentOf, splatVertexOf } from "@splatreel/renderer";

/**
 * Depth of a splat's center in clip space, by its depth w in the camera: uDepth.x + uDepth.y / w + uDepth.z * (w - uDepth.w).
 * uFog: near and far distance, density, units per unit of w; uFogColor: in sRGB, with 0 as alpha without fog.
 */
export const depthVertex = splatVertexOf(
  "uDepth.x + uDepth.y / uintBitsToFloat(color.w) + uDepth.z * (uintBitsToFloat(color.w) - uDepth.w)",
  "uniform vec4 uDepth, uFog, uFogColor;\n",
  `float away = (uintBitsToFloat(color.w) - uDepth.w) * uFog.w;
  float fog = uFog.z > 0.0 ? 1.0 - exp(-uFog.z * uFog.z * away * away) : smoothstep(uFog.x, uFog.y, away);
  if (uFogColor.a > 0.0) vColor.rgb = mix(vColor.rgb, uFogColor.rgb, fog);`,
);

const conversions = `vec3 toLinear(vec3 color) {
  return mix(color / 12.92, pow((color + 0.055) / 1.055, vec3(2.4)), step(0.04045, color));
}
vec3 toSrgb(vec3 color) {
  return mix(color * 12.92, 1.055 * pow(color, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, color));
}
`;

/** uCutoff: least alpha to draw. uLinear: the target holds linear colors instead of sRGB. uOpacity: factor on alpha. */
export const depthFragment = splatFragmentOf(
  `alpha *= uOpacity;
  if (alpha < uCutoff) discard;
  outColor = vec4((uLinear ? toLinear(vColor.rgb) : vColor.rgb) * alpha, alpha);`,
  `uniform float uCutoff, uOpacity;\nuniform bool uLinear;\n${conversions}`,
);

/** Blends premultiplied splats in sRGB over linear colors, and writes linear colors. */
export const convertFragment = `#version 300 es
precision highp float;
uniform sampler2D uSplats;
uniform sampler2D uBehind;
out vec4 outColor;
${conversions}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 splats = texelFetch(uSplats, at, 0);
  if (splats == vec4(0.0)) discard;
  vec4 behind = texelFetch(uBehind, at, 0);
  outColor = vec4(toLinear(splats.rgb + (1.0 - splats.a) * toSrgb(max(behind.rgb, 0.0))), mix(behind.a, 1.0, splats.a));
}`;
