/** Shaders of the second pass with depth: splats are tested against the depth of meshes, and may write their own. */
import { splatVertexOf } from "splatreel-player/webgl/shaders";

/** Depth of a splat's center by the projection matrix: uDepth holds the elements 10 and 14. */
export const depthVertex = splatVertexOf("uDepth.y / uintBitsToFloat(color.w) - uDepth.x", "uniform vec2 uDepth;\n");

/** uCutoff: least alpha to draw. uLinear: the target holds linear colors instead of sRGB. uOpacity: factor on alpha. */
export const depthFragment = `#version 300 es
precision highp float;
uniform float uCutoff, uOpacity;
uniform bool uLinear;
in vec2 vAt;
flat in vec4 vColor;
flat in float vFall;
out vec4 outColor;
void main() {
  float square = dot(vAt, vAt);
  if (square > 1.0) discard;
  float alpha = min(0.999, vColor.a * exp2(vFall * square)) * uOpacity;
  if (alpha < uCutoff) discard;
  vec3 color = vColor.rgb;
  if (uLinear) color = mix(color / 12.92, pow((color + 0.055) / 1.055, vec3(2.4)), step(0.04045, color));
  outColor = vec4(color * alpha, alpha);
}`;
