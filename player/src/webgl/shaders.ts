/**
 * Shaders of the two passes. `project` runs once per point: it moves, projects and colors the point and writes its splat into integer
 * textures, which every WebGL 2 device can render to at full precision. `splat` draws the sorted quads.
 */
import { MOST_REMOVED } from "../draw/cutaway";
import { NO_POINT, TEXTURE_WIDTH } from "../draw/texture-layout";

/** Texels per point in the `points` texture, and per codebook entry: one per coefficient. */
export const POINT_TEXELS = 3;
export const ENTRY_TEXELS = 15;
export const ENTRIES_PER_ROW = 128;

/** Vertex shader of a triangle that covers the viewport. */
export const coverVertex = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

export const projectFragment = `#version 300 es
precision highp float;
precision highp int;
uniform highp usampler2DArray uPoints;
uniform highp sampler2D uCodebook;
uniform highp usampler2D uFlags;
uniform highp usampler2DArray uDx;
uniform highp usampler2DArray uDq;
uniform highp usampler2DArray uAppearance;
uniform int uFirstRow;
uniform int uCount;
uniform int uShDegree;
uniform bool uMoving, uWorldly, uHasAppearance, uAntialias;
uniform ivec2 uFrames;
uniform float uBetween;
uniform vec3 uDxMin, uDxStep;
uniform vec4 uDqMin, uDqStep;
uniform vec4 uAppearanceMin, uAppearanceStep;
uniform vec4 uWeights;
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

/** Square pixels that are added to the covariance in the image; antialiased, about a pixel's own area. */
const float BLUR = 0.3, FINE_BLUR = 0.1;
/** Splats end where their alpha is less than this. Training draws to 1/255: a quarter more pixels for two decibels above 48. */
const float LEAST_ALPHA = 0.01;

mat3 rotationOf(vec4 q) {
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

vec4 multiply(vec4 a, vec4 b) {
  return vec4(a.x * b.x - dot(a.yzw, b.yzw), a.x * b.yzw + b.x * a.yzw + cross(a.yzw, b.yzw));
}

vec3 movedBy(ivec2 at) {
  vec3 low = vec3(texelFetch(uDx, ivec3(at, uFrames.x), 0).xyz);
  vec3 high = vec3(texelFetch(uDx, ivec3(at, uFrames.y), 0).xyz);
  return uDxMin + uDxStep * mix(low, high, uBetween);
}

vec4 turnedBy(ivec2 at) {
  vec4 low = normalize(uDqMin + uDqStep * vec4(texelFetch(uDq, ivec3(at, uFrames.x), 0)));
  vec4 high = normalize(uDqMin + uDqStep * vec4(texelFetch(uDq, ivec3(at, uFrames.y), 0)));
  return normalize(mix(low, dot(low, high) < 0.0 ? -high : high, uBetween));
}

/** What the DC term and the opacity gain. */
vec4 shadedBy(ivec2 at) {
  vec4 low = vec4(texelFetch(uAppearance, ivec3(at, uFrames.x), 0));
  vec4 high = vec4(texelFetch(uAppearance, ivec3(at, uFrames.y), 0));
  return uAppearanceMin + uAppearanceStep * mix(low, high, uBetween);
}

/** The view-dependent part of a color: coefficients 1..15 in the 3DGS order, one texel each. */
vec3 viewDependent(int index, vec3 d) {
  ivec2 at = ivec2((index % ${ENTRIES_PER_ROW}) * ${ENTRY_TEXELS}, index / ${ENTRIES_PER_ROW});
  #define REST(i) texelFetch(uCodebook, at + ivec2(i, 0), 0).rgb
  float x = d.x, y = d.y, z = d.z;
  vec3 color = 0.4886025119029199 * (z * REST(1) - y * REST(0) - x * REST(2));
  if (uShDegree < 2) return color;
  float xx = x * x, yy = y * y, zz = z * z;
  color += 1.0925484305920792 * (x * y * REST(3) - y * z * REST(4) - x * z * REST(6))
    + 0.31539156525252005 * (2.0 * zz - xx - yy) * REST(5)
    + 0.5462742152960396 * (xx - yy) * REST(7);
  if (uShDegree < 3) return color;
  return color - 0.5900435899266435 * y * (3.0 * xx - yy) * REST(8)
    + 2.890611442640554 * x * y * z * REST(9)
    - 0.4570457994644658 * y * (4.0 * zz - xx - yy) * REST(10)
    + 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * REST(11)
    - 0.4570457994644658 * x * (4.0 * zz - xx - yy) * REST(12)
    + 1.445305721320277 * z * (xx - yy) * REST(13)
    - 0.5900435899266435 * x * (xx - 3.0 * yy) * REST(14);
}

void main() {
  outShape = uvec4(0u);
  outColor = uvec4(0u);
  ivec2 at = ivec2(gl_FragCoord.xy) - ivec2(0, uFirstRow);
  if (at.y * ${TEXTURE_WIDTH} + at.x >= uCount) return;
  float weight = uMoving ? uWeights.x : uWeights[texelFetch(uFlags, at, 0).x];
  if (weight <= 0.0) return;

  uvec4 p0 = texelFetch(uPoints, ivec3(at, 0), 0);
  uvec4 p1 = texelFetch(uPoints, ivec3(at, 1), 0);
  uvec4 p2 = texelFetch(uPoints, ivec3(at, 2), 0);
  vec3 mean = uintBitsToFloat(p0.xyz);
  vec3 scale = uintBitsToFloat(p1.xyz);
  vec2 opacityAndRed = unpackHalf2x16(p1.w);
  vec4 quat = vec4(unpackHalf2x16(p2.x), unpackHalf2x16(p2.y));
  vec3 color = vec3(opacityAndRed.y, unpackHalf2x16(p2.z));
  if (uMoving) {
    mean += movedBy(at);
    quat = uWorldly ? multiply(turnedBy(at), quat) : multiply(quat, turnedBy(at));
  }
  if (any(lessThan(mean, uLow)) || any(greaterThan(mean, uHigh))) return;
  for (int i = 0; i < uRemovals; i++) if (distance(mean, uRemoved[i].xyz) <= uRemoved[i].w) return;
  if (uHasAppearance) {
    vec4 gain = shadedBy(at);
    color += gain.rgb;
    opacityAndRed.x = clamp(opacityAndRed.x + gain.a, 0.0, 1.0);
  }
  // Faded in optical depth: two coinciding points of weights w and 1 - w absorb what one does.
  float opacity = 1.0 - pow(1.0 - min(opacityAndRed.x, 0.9999), weight);

  vec3 camera = (uView * vec4(mean, 1.0)).xyz;
  if (camera.z < uNear) return;
  vec2 slope = clamp(camera.xy / camera.z, uRange.xz, uRange.yw);
  vec2 focal = uLens.xy / camera.z;
  // Rows of the projection's Jacobian times the world-to-camera rotation, then times rotation and scales.
  mat3 view = transpose(mat3(uView));
  mat3 turn = rotationOf(normalize(quat));
  vec3 a = (focal.x * (view[0] - slope.x * view[2])) * turn * scale;
  vec3 b = (focal.y * (view[1] - slope.y * view[2])) * turn * scale;
  float blur = uAntialias ? FINE_BLUR : BLUR;
  float xx = dot(a, a) + blur;
  float yy = dot(b, b) + blur;
  float xy = dot(a, b);

  // A splat that the blur has made larger is fainter by as much.
  if (uAntialias) opacity *= sqrt(max(1.0 - blur * (xx + yy - blur) / (xx * yy - xy * xy), 0.0));
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
  color *= 0.28209479177387814;
  if (uShDegree > 0) color += viewDependent(int(p0.w), normalize(mean - uEye));
  color = max(color + 0.5, 0.0) * uLight;
  outShape = uvec4(floatBitsToUint(center), packHalf2x16(axis), packHalf2x16(other));
  outColor = uvec4(packHalf2x16(color.rg), packHalf2x16(vec2(color.b, opacity)), floatBitsToUint(extent), floatBitsToUint(camera.z));
}`;

/** Return the vertex shader of the second pass. depth: GLSL of the depth in clip space; declarations: of what it uses. */
export const splatVertexOf = (depth: string, declarations = ""): string => `#version 300 es
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
