/**
 * Shaders of the two passes. `project` runs once per point: it moves, projects and colors the point and writes its splat into integer
 * textures, which every WebGL 2 device can render to at full precision. `splat` draws the sorted quads.
 */
import { MOST_REMOVED } from "../draw/cutaway";
import { NO_POINT, TEXTURE_WIDTH } from "../draw/texture-layout";
import { pointGlsl } from "./point-shaders";

/** Vertex shader of a triangle that covers the viewport. */
export const coverVertex = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

export const projectFragment = `#version 300 es
precision highp float;
precision highp int;
${pointGlsl}
uniform int uFirstRow;
uniform int uCount;
uniform bool uAntialias;
uniform mat4 uView;
uniform vec3 uEye;
uniform vec4 uLens;
uniform vec4 uRange;
uniform vec2 uSize;
uniform float uNear;
uniform vec3 uLight;
uniform vec3 uLow, uHigh;
uniform vec4 uRemoved[${MOST_REMOVED}];
uniform int uRemovals;
layout(location = 0) out uvec4 outShape;
layout(location = 1) out uvec4 outColor;

/** Splats end where their alpha is less than this. Training draws to 1/255: a quarter more pixels for two decibels above 48. */
const float LEAST_ALPHA = 0.01;

void main() {
  outShape = uvec4(0u);
  outColor = uvec4(0u);
  ivec2 at = ivec2(gl_FragCoord.xy) - ivec2(0, uFirstRow);
  if (at.y * ${TEXTURE_WIDTH} + at.x >= uCount) return;
  float weight = weightOf(at);
  if (weight <= 0.0) return;
  Point point = pointAt(at);
  vec3 mean = point.mean;
  if (any(lessThan(mean, uLow)) || any(greaterThan(mean, uHigh))) return;
  for (int i = 0; i < uRemovals; i++) if (distance(mean, uRemoved[i].xyz) <= uRemoved[i].w) return;
  float opacity = faded(point.opacity, weight);

  vec3 camera = (uView * vec4(mean, 1.0)).xyz;
  if (camera.z < uNear) return;
  vec2 slope = clamp(camera.xy / camera.z, uRange.xz, uRange.yw);
  vec2 focal = uLens.xy / camera.z;
  float blur = uAntialias ? FINE_BLUR : BLUR;
  vec3 covariance = covarianceOf(point, transpose(mat3(uView)), slope, focal) + vec3(blur, blur, 0.0);
  float xx = covariance.x, yy = covariance.y, xy = covariance.z;
  if (uAntialias) opacity *= thinned(covariance);
  if (opacity <= LEAST_ALPHA) return;

  // Axes of the ellipse where alpha falls to the least.
  float middle = 0.5 * (xx + yy);
  float spread = length(vec2(0.5 * (xx - yy), xy));
  float major = middle + spread;
  float minor = max(middle - spread, 0.0);
  vec2 direction = abs(xy) < 1e-6 * major ? (xx >= yy ? vec2(1, 0) : vec2(0, 1)) : normalize(vec2(xy, major - xx));
  float extent = sqrt(2.0 * log(opacity / LEAST_ALPHA));
  vec2 axis = direction * sqrt(major) * extent;
  vec2 other = vec2(-direction.y, direction.x) * sqrt(minor) * extent;

  vec2 center = focal * camera.xy + uLens.zw;
  vec2 reach = abs(axis) + abs(other);
  if (any(lessThan(center + reach, vec2(0.0))) || any(greaterThan(center - reach, uSize))) return;
  vec3 color = colorOf(point, normalize(mean - uEye)) * uLight;
  outShape = uvec4(floatBitsToUint(center), packHalf2x16(axis), packHalf2x16(other));
  outColor = uvec4(packHalf2x16(color.rg), packHalf2x16(vec2(color.b, opacity)), floatBitsToUint(extent), floatBitsToUint(camera.z));
}`;

/** Return the vertex shader of the second pass. depth: GLSL of the depth in clip space; declarations: of what it uses; end: more GLSL. */
export const splatVertexOf = (depth: string, declarations = "", end = ""): string => `#version 300 es
precision highp float;
precision highp int;
${declarations}uniform highp usampler2D uShape;
uniform highp usampler2D uColor;
uniform highp usampler2D uOrder;
uniform vec2 uSize;
out vec2 vAt;
flat out vec4 vColor;
flat out float vFall;
void main() {
  gl_Position = vec4(2.0, 2.0, 0.0, 1.0); // outside: nothing is drawn
  uint point = texelFetch(uOrder, ivec2(gl_VertexID >> 2, gl_InstanceID), 0).x;
  if (point == ${NO_POINT}u) return;
  ivec2 at = ivec2(point % ${TEXTURE_WIDTH}u, point / ${TEXTURE_WIDTH}u);
  uvec4 color = texelFetch(uColor, at, 0);
  float extent = uintBitsToFloat(color.z);
  if (extent <= 0.0) return;
  uvec4 shape = texelFetch(uShape, at, 0);
  vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0;
  vec2 pixel = uintBitsToFloat(shape.xy) + corner.x * unpackHalf2x16(shape.z) + corner.y * unpackHalf2x16(shape.w);
  gl_Position = vec4(pixel / uSize * vec2(2.0, -2.0) + vec2(-1.0, 1.0), ${depth}, 1.0);
  vAt = corner;
  vColor = vec4(unpackHalf2x16(color.x), unpackHalf2x16(color.y));
  // exp(-r^2 / 2) at r standard deviations, as a power of two of the place in the quad.
  vFall = -0.7213475204444817 * extent * extent;
  ${end}
}`;

/** Return the fragment shader of the second pass. end: GLSL from alpha to outColor; declarations: of what it uses. */
export const splatFragmentOf = (end: string, declarations = ""): string => `#version 300 es
precision highp float;
${declarations}in vec2 vAt;
flat in vec4 vColor;
flat in float vFall;
out vec4 outColor;
void main() {
  float square = dot(vAt, vAt);
  if (square > 1.0) discard;
  float alpha = min(0.999, vColor.a * exp2(vFall * square));
  ${end}
}`;

export const splatFragment = splatFragmentOf("outColor = vec4(vColor.rgb * alpha, alpha);");

export const fadeFragment = `#version 300 es
precision highp float;
uniform sampler2D uPicture;
uniform ivec2 uCorner;
out vec4 outColor;
void main() {
  outColor = texelFetch(uPicture, ivec2(gl_FragCoord.xy) - uCorner, 0);
}`;
