// use: common
// Sort the pairs of each tile by depth, then by pair: a bitonic network whose comparisons all ascend, so that missing elements never
// move. Comparisons within a block run in shared memory. Only those of tiles with more pairs than a block reach across blocks.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> tile_offsets: array<u32>;
@group(0) @binding(2) var<storage, read> status: array<u32>;
@group(0) @binding(3) var<storage, read_write> keys: array<vec2u>;
const BLOCK = 1024u;
var<workgroup> held: array<vec2u, BLOCK>;
fn is_less(a: vec2u, b: vec2u) -> bool { return a.x < b.x || (a.x == b.x && a.y < b.y); }
// The q-th comparison of a step: elements j apart, or in the first step of a merge mirrored.
fn pair_of(q: u32, j: u32, mirrors: bool) -> vec2u {
    let low = q / j * 2u * j; let r = q % j;
    return vec2u(low + r, select(low + r + j, low + 2u * j - 1u - r, mirrors));
}
// Merge from `first` elements apart down to neighbors.
fn merge_held(local: u32, first: u32, mirrors: bool, size: u32, count: u32) {
    for (var j = first; j > 0u; j /= 2u) {
        for (var q = local; q < size / 2u; q += GROUP) {
            let pair = pair_of(q, j, mirrors && j == first);
            if (pair.y < count) {
                let x = held[pair.x]; let y = held[pair.y];
                if (is_less(y, x)) { held[pair.x] = y; held[pair.y] = x; }
            }
        }
        workgroupBarrier();
    }
}
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    if (status[0] != 0u) { return; }
    let tile = group.y * draw.size.z + group.x;
    let start = tile_offsets[tile]; let count = tile_offsets[tile + 1u] - start;
    if (count < 2u) { return; }
    var size = 1u;
    while (size < count) { size *= 2u; }
    let inner = min(size, BLOCK);
    for (var k = inner; k <= size; k *= 2u) {  // sort the blocks, then merge them
        for (var j = k / 2u; j >= BLOCK; j /= 2u) {
            for (var q = local; q < size / 2u; q += GROUP) {
                let pair = pair_of(q, j, j == k / 2u);
                if (pair.y < count) {
                    let x = keys[start + pair.x]; let y = keys[start + pair.y];
                    if (is_less(y, x)) { keys[start + pair.x] = y; keys[start + pair.y] = x; }
                }
            }
            storageBarrier();
        }
        for (var base = 0u; base < count; base += BLOCK) {
            let here = min(BLOCK, count - base);
            for (var i = local; i < here; i += GROUP) { held[i] = keys[start + base + i]; }
            workgroupBarrier();
            if (k == inner) {
                for (var half = 1u; half < inner; half *= 2u) { merge_held(local, half, true, inner, here); }
            } else {
                merge_held(local, BLOCK / 2u, false, BLOCK, here);
            }
            for (var i = local; i < here; i += GROUP) { keys[start + base + i] = held[i]; }
            workgroupBarrier();
        }
        storageBarrier();
    }
}
