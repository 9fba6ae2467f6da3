// use: common, extents
// Write the key of every (splat, tile) pair into its tile. Too many pairs raise status[0] to the number needed.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> first: array<u32>;
@group(0) @binding(3) var<storage, read> tile_offsets: array<u32>;
@group(0) @binding(4) var<storage, read_write> cursors: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> keys: array<vec2u>;  // bits of the depth, pair
@group(0) @binding(6) var<storage, read_write> owners: array<u32>;  // splat of each pair
@group(0) @binding(7) var<storage, read_write> status: array<atomic<u32>>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local); let n = draw.counts.x; let needed = first[n];
    if (needed > draw.counts.w) {
        if (i == 0u) { atomicMax(&status[0], needed); }
        return;
    }
    if (i >= n || first[i] == first[i + 1u]) { return; }
    let splat = splats[i]; let bounds = box(splat); var pair = first[i];
    for (var column = bounds.x / 16; column <= bounds.y / 16; column++) {
        let rows = strip(splat, bounds.z, bounds.w, column);
        if (rows.y < rows.x) { continue; }
        for (var row = rows.x / 16; row <= rows.y / 16; row++) {
            let tile = u32(row) * draw.size.z + u32(column);
            keys[tile_offsets[tile] + atomicAdd(&cursors[tile], 1u)] = vec2u(bitcast<u32>(splat.shape.z), pair);
            owners[pair] = i;
            pair++;
        }
    }
}
