/** Shader code by which PlayCanvas reads the splats of a file while it fills its work buffer. */
import { pointGlsl, TEXTURE_WIDTH } from "@splatreel/renderer";

/**
 * The functions of a GSplatFormat. PlayCanvas calls getCenter first. It widens splats by 0.075 square pixels; the rest is added to their
 * scales here. uFocal: pixels; uClear: least depth of static points; depths are in units of the reel.
 */
export const readGlsl = `${pointGlsl}
uniform vec2 uFocal;
uniform vec3 uLight;
uniform float uNear, uClear, uOpacity;
uniform bool uAntialias;

const float ENGINE_BLUR = 0.075;
Point shown;
ivec2 place;

/** Position in the camera, x right, y down, z forward. */
vec3 inCamera(vec3 mean) {
  return (matrix_view * matrix_model * vec4(mean, 1.0)).xyz * vec3(1.0, -1.0, -1.0) / model_scale.x;
}

vec3 getCenter() {
  place = ivec2(splat.index % ${TEXTURE_WIDTH}u, splat.index / ${TEXTURE_WIDTH}u);
  shown = pointAt(place);
  return shown.mean;
}

vec4 getRotation() {
  return shown.quat;
}

vec3 getScale() {
  float pixel = max(inCamera(shown.mean).z, uNear) / uFocal.y;
  float blur = (uAntialias ? FINE_BLUR : BLUR) - ENGINE_BLUR;
  return sqrt(shown.scale * shown.scale + blur * pixel * pixel);
}

vec4 getColor() {
  float weight = weightOf(place);
  vec3 camera = inCamera(shown.mean);
  if (weight <= 0.0 || camera.z < (uMoving ? uNear : uClear)) return vec4(0.0);
  float opacity = faded(shown.opacity, weight) * uOpacity;
  // Rows of the rotation from the reel to the camera.
  mat3 view = transpose(mat3(matrix_view * matrix_model)) / model_scale.x;
  view[1] *= -1.0;
  view[2] *= -1.0;
  vec3 direction = normalize(camera.x * view[0] + camera.y * view[1] + camera.z * view[2]);
  if (uAntialias) opacity *= thinned(covarianceOf(shown, view, camera.xy / camera.z, uFocal / camera.z) + vec3(FINE_BLUR, FINE_BLUR, 0.0));
  return vec4(colorOf(shown, direction) * uLight, opacity);
}
`;
