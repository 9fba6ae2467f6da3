// use: common
// Gradient of L_temp to the offsets at two frames (moments 1 and 2) and between them (moment 3).
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> offsets: array<f32>;
@group(0) @binding(2) var<storage, read_write> d_offsets: array<f32>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let e = linear(group, groups, local); let n = draw.counts.x; let plane = 7u * n;
    if (e >= plane) { return; }
    let delta = draw.motion.w; var weight = draw.motion.z / f32(n);
    if (e < 3u * n) { weight /= draw.motion.x; }
    let slope = weight * sign((1.0 - delta) * offsets[plane + e] + delta * offsets[2u * plane + e] - offsets[3u * plane + e]);
    d_offsets[plane + e] = (1.0 - delta) * slope;
    d_offsets[2u * plane + e] = delta * slope;
    d_offsets[3u * plane + e] = -slope;
}
