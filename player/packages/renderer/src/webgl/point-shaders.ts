/** GLSL that reads the points of a file, moves them to a time and colors them. The player and other engines share it. */
import { ENTRIES_PER_ROW, ENTRY_TEXELS } from "../draw/point-words";

export const pointGlsl = `
uniform highp usampler2DArray uPoints;
uniform highp sampler2D uCodebook;
uniform highp usampler2D uFlags;
uniform highp usampler2DArray uDx;
uniform highp usampler2DArray uDq;
uniform highp usampler2DArray uAppearance;
uniform int uShDegree;
uniform bool uMoving, uWorldly, uHasAppearance;
uniform ivec2 uFrames;
uniform float uBetween;
uniform vec3 uDxMin, uDxStep;
uniform vec4 uDqMin, uDqStep;
uniform vec4 uAppearanceMin, uAppearanceStep;
uniform vec4 uWeights;

/** Square pixels that are added to the covariance in the image; antialiased, about a pixel's own area. */
const float BLUR = 0.3, FINE_BLUR = 0.1;

struct Point {
  vec3 mean, scale, color;
  vec4 quat;
  float opacity;
  int entry;
};

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

/** Changes of the DC term and of the opacity. */
vec4 shadedBy(ivec2 at) {
  vec4 low = vec4(texelFetch(uAppearance, ivec3(at, uFrames.x), 0));
  vec4 high = vec4(texelFetch(uAppearance, ivec3(at, uFrames.y), 0));
  return uAppearanceMin + uAppearanceStep * mix(low, high, uBetween);
}

vec3 rest(ivec2 at, int i) {
  return texelFetch(uCodebook, at + ivec2(i, 0), 0).rgb;
}

/** The view-dependent part of a color: coefficients 1..15 in the 3DGS order, one texel each. */
vec3 viewDependent(int index, vec3 d) {
  ivec2 at = ivec2((index % ${ENTRIES_PER_ROW}) * ${ENTRY_TEXELS}, index / ${ENTRIES_PER_ROW});
  float x = d.x, y = d.y, z = d.z;
  vec3 color = 0.4886025119029199 * (z * rest(at, 1) - y * rest(at, 0) - x * rest(at, 2));
  if (uShDegree < 2) return color;
  float xx = x * x, yy = y * y, zz = z * z;
  color += 1.0925484305920792 * (x * y * rest(at, 3) - y * z * rest(at, 4) - x * z * rest(at, 6))
    + 0.31539156525252005 * (2.0 * zz - xx - yy) * rest(at, 5)
    + 0.5462742152960396 * (xx - yy) * rest(at, 7);
  if (uShDegree < 3) return color;
  return color - 0.5900435899266435 * y * (3.0 * xx - yy) * rest(at, 8)
    + 2.890611442640554 * x * y * z * rest(at, 9)
    - 0.4570457994644658 * y * (4.0 * zz - xx - yy) * rest(at, 10)
    + 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * rest(at, 11)
    - 0.4570457994644658 * x * (4.0 * zz - xx - yy) * rest(at, 12)
    + 1.445305721320277 * z * (xx - yy) * rest(at, 13)
    - 0.5900435899266435 * x * (xx - 3.0 * yy) * rest(at, 14);
}

/** Weight of a point in a cross-fade; 0 if it is not shown. */
float weightOf(ivec2 at) {
  return uMoving ? uWeights.x : uWeights[texelFetch(uFlags, at, 0).x];
}

/** A point at the present frame. Its color lacks the view-dependent part. */
Point pointAt(ivec2 at) {
  uvec4 p0 = texelFetch(uPoints, ivec3(at, 0), 0);
  uvec4 p1 = texelFetch(uPoints, ivec3(at, 1), 0);
  uvec4 p2 = texelFetch(uPoints, ivec3(at, 2), 0);
  vec2 opacityAndRed = unpackHalf2x16(p1.w);
  Point point;
  point.mean = uintBitsToFloat(p0.xyz);
  point.scale = uintBitsToFloat(p1.xyz);
  point.color = vec3(opacityAndRed.y, unpackHalf2x16(p2.z));
  point.quat = vec4(unpackHalf2x16(p2.x), unpackHalf2x16(p2.y));
  point.opacity = opacityAndRed.x;
  point.entry = int(p0.w);
  if (uMoving) {
    point.mean += movedBy(at);
    point.quat = uWorldly ? multiply(turnedBy(at), point.quat) : multiply(point.quat, turnedBy(at));
  }
  point.quat = normalize(point.quat);
  if (uHasAppearance) {
    vec4 gain = shadedBy(at);
    point.color += gain.rgb;
    point.opacity = clamp(point.opacity + gain.a, 0.0, 1.0);
  }
  return point;
}

/** The color of a point that is seen along a direction. */
vec3 colorOf(Point point, vec3 direction) {
  vec3 color = 0.28209479177387814 * point.color;
  if (uShDegree > 0) color += viewDependent(point.entry, direction);
  return max(color + 0.5, 0.0);
}

/** Faded in optical depth: two coinciding points of weights w and 1 - w absorb what one does. */
float faded(float opacity, float weight) {
  return 1.0 - pow(1.0 - min(opacity, 0.9999), weight);
}

/** Covariance in the image, xx, yy and xy in square pixels. view: rows of the rotation; focal: pixels at the point's depth. */
vec3 covarianceOf(Point point, mat3 view, vec2 slope, vec2 focal) {
  // Rows of the projection's Jacobian times the world-to-camera rotation, then times rotation and scales.
  mat3 turn = rotationOf(point.quat);
  vec3 a = (focal.x * (view[0] - slope.x * view[2])) * turn * point.scale;
  vec3 b = (focal.y * (view[1] - slope.y * view[2])) * turn * point.scale;
  return vec3(dot(a, a), dot(b, b), dot(a, b));
}

/** Factor on the opacity of a splat that antialiasing has made larger: it is fainter by as much. covariance: blurred. */
float thinned(vec3 covariance) {
  float xx = covariance.x, yy = covariance.y, xy = covariance.z;
  return sqrt(max(1.0 - FINE_BLUR * (xx + yy - FINE_BLUR) / (xx * yy - xy * xy), 0.0));
}
`;
