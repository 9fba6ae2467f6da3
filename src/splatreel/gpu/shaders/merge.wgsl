// use: common
// Merge the sorted pairs of moving and static splats of each tile, and decide whether the tile is drawn.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> tile_offsets: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<vec2u>;
@group(0) @binding(3) var<storage, read> owners: array<u32>;
@group(0) @binding(4) var<storage, read> static_pairs: array<vec4u>;  // bits of the depth, pair, splat
@group(0) @binding(5) var<storage, read> static_offsets: array<u32>;
@group(0) @binding(6) var<storage, read> chosen: array<u32>;          // per static point: 1 if its gradient is measured
@group(0) @binding(7) var<storage, read_write> list: array<vec2u>;    // splat, slot of the gradient
@group(0) @binding(8) var<storage, read_write> tiles: array<vec4u>;   // range of the list, flags
var<workgroup> wanted: atomic<u32>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    if (tile_offsets[draw.size.z * draw.size.w] > draw.counts.w) { return; }  // pairs that do not fit: `emit` has told the host
    let tile = group.y * draw.size.z + group.x;
    let start = tile_offsets[tile]; let count = tile_offsets[tile + 1u] - start;
    let begin = static_offsets[tile]; let held = static_offsets[tile + 1u] - begin;
    let flags = draw.numbers.x;
    if (local == 0u) { atomicStore(&wanted, u32(count > 0u || (flags & WHOLE) != 0u)); }
    workgroupBarrier();
    if ((flags & METERED_STATIC) != 0u) {
        for (var k = local; k < held; k += GROUP) {
            if (chosen[static_pairs[begin + k].z] != 0u) { atomicStore(&wanted, 1u); }
        }
    }
    workgroupBarrier();
    let base = start + begin; let drawn = atomicLoad(&wanted);
    if (local == 0u) { tiles[tile] = vec4u(base, base + count + held, drawn, 0u); }
    if (drawn == 0u) { return; }
    for (var k = local; k < count; k += GROUP) {
        let key = keys[start + k];
        var low = 0u; var high = held;  // the static splats nearer than this one
        while (low < high) {
            let middle = (low + high) / 2u;
            if (static_pairs[begin + middle].x < key.x) { low = middle + 1u; } else { high = middle; }
        }
        list[base + k + low] = vec2u(owners[key.y], key.y);
    }
    for (var k = local; k < held; k += GROUP) {
        let pair = static_pairs[begin + k];
        var low = 0u; var high = count;  // the moving splats that are not farther
        while (low < high) {
            let middle = (low + high) / 2u;
            if (keys[start + middle].x <= pair.x) { low = middle + 1u; } else { high = middle; }
        }
        list[base + k + low] = vec2u(pair.z | STATIC, draw.counts.w + pair.y);
    }
}
