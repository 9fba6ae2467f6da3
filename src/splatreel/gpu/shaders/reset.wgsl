// use: common
// Clear the counters of the tiles.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read_write> tile_counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> cursors: array<u32>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local);
    if (i <= draw.size.z * draw.size.w) { tile_counts[i] = 0u; cursors[i] = 0u; }
}
