// use: common, gains
// Multiply the colors of the splats by the gain of the points.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> gains: array<f32>;
@group(0) @binding(2) var<storage, read_write> splats: array<Splat>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local);
    if (i >= draw.counts.x) { return; }
    let back = draw.background.xyz; let color = splats[i].color;
    splats[i].color = vec4f((color.xyz + back) * point_gain() - back, color.w);
}
