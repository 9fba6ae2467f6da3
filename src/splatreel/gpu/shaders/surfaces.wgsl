// use: common, gains, target
// Gradient of the losses of surfaces to the blended powers of log depth and to alpha (method/train/terms/surfaces.py).
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> image: array<vec4f>;
@group(0) @binding(2) var<storage, read> targets: array<u32>;
@group(0) @binding(3) var<storage, read> gains: array<f32>;
@group(0) @binding(4) var<storage, read> depths: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> d_depths: array<vec4f>;
const LEAST_ALPHA = 1e-3; const LEAST_VARIANCE = 1e-5; const MOST_APART = 0.45; const EDGE_CONTRAST = 0.05;
fn moments(pixel: u32) -> vec3f { return depths[pixel].xyz / max(depths[pixel].w, LEAST_ALPHA); }
fn inverse_depth(pixel: u32) -> f32 { return draw.surfaces.w * exp(-moments(pixel).x); }
// Slope of the cost of the bend at a pixel, whose neighbors are `step` before and after.
fn bend(pixel: u32, step: u32) -> f32 {
    let contrast = abs(target_color(pixel + step) - target_color(pixel - step));
    let plain = exp(-max(contrast.x, max(contrast.y, contrast.z)) / EDGE_CONTRAST);
    return plain * sign(inverse_depth(pixel - step) - 2.0 * inverse_depth(pixel) + inverse_depth(pixel + step));
}
fn bends(pixel: u32, place: u32, length: u32, step: u32) -> f32 {
    var slope = 0.0;
    if (place >= 2u) { slope += bend(pixel - step, step); }
    if (place >= 1u && place + 1u < length) { slope -= 2.0 * bend(pixel, step); }
    if (place + 2u < length) { slope += bend(pixel + step, step); }
    return slope;
}
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let pixel = linear(group, groups, local); let width = draw.size.x; let height = draw.size.y;
    if (pixel >= width * height) { return; }
    let m = moments(pixel); let alpha = depths[pixel].w;
    // the spread: points in front of the far layer of the pixel
    let variance = max(m.y - m.x * m.x, LEAST_VARIANCE);
    let skewness = (m.z - 3.0 * m.x * variance - m.x * m.x * m.x) / (variance * sqrt(variance));
    let root = sqrt(skewness * skewness + 4.0);
    let far = m.x + sqrt(variance) * (skewness + root) / 2.0;
    let share = (root - skewness) / (2.0 * root);
    let weight = draw.surfaces.x * alpha * share * share * min(MOST_APART * MOST_APART / (variance * root * root), 1.0)
        / f32(width * height);
    var slope = vec2f(-2.0 * far * weight, weight);
    // the bends of inverse depth along rows and columns
    var d_inverse = 0.0;
    if (width > 2u) { d_inverse += bends(pixel, pixel % width, width, 1u) / f32(height * (width - 2u)); }
    if (height > 2u) { d_inverse += bends(pixel, pixel / width, height, width) / f32(width * (height - 2u)); }
    slope.x -= draw.surfaces.y * inverse_depth(pixel) * d_inverse;
    let held = max(alpha, LEAST_ALPHA);
    let d_alpha = select(0.0, -dot(slope, m.xy) / held, alpha > LEAST_ALPHA);
    d_depths[pixel] = vec4f(slope / held, 0.0, d_alpha);
}
