// use: common, gains
// Gradients to the colors of the points from those to the tinted colors, and to the gain of the camera: one sum per workgroup.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> gains: array<f32>;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read_write> d_splats: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> slopes: array<f32>;  // [workgroups, 3]
var<workgroup> parts: array<vec3f, GROUP>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local); let gain = point_gain(); var sum = vec3f(0.0);
    if (i < draw.counts.x) {
        let slope = vec3f(d_splats[3u * i + 1u].zw, d_splats[3u * i + 2u].x);
        sum = slope * (splats[i].color.xyz + draw.background.xyz) / camera_gain();
        d_splats[3u * i + 1u].z = slope.x * gain.x;
        d_splats[3u * i + 1u].w = slope.y * gain.y;
        d_splats[3u * i + 2u].x = slope.z * gain.z;
    }
    parts[local] = sum;
    workgroupBarrier();
    for (var step = GROUP / 2u; step > 0u; step /= 2u) {
        if (local < step) { parts[local] += parts[local + step]; }
        workgroupBarrier();
    }
    if (local < 3u) { slopes[3u * (group.y * groups.x + group.x) + local] = parts[0][local]; }
}
