// use: common
// Make the static splats of points that are no longer static transparent. Their pairs stay in the lists of a view.
@group(0) @binding(0) var<uniform> length: vec4u;
@group(0) @binding(1) var<storage, read> alive: array<u32>;
@group(0) @binding(2) var<storage, read_write> static_splats: array<Splat>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local);
    if (i < length.x && alive[i] == 0u) { static_splats[i].shape.y = -1e9; }
}
