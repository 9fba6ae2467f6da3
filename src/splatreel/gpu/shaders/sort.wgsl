// use: common
// Sort the pairs of each tile by depth, then by pair: a bitonic network whose comparisons all ascend, so that missing elements never
// move. Tiles with few pairs are sorted in shared memory, others in place.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> tile_offsets: array<u32>;
@group(0) @binding(2) var<storage, read> status: array<u32>;
@group(0) @binding(3) var<storage, read_write> keys: array<vec2u>;
const SHARED = 1024u;
var<workgroup> held: array<vec2u, SHARED>;
fn is_less(a: vec2u, b: vec2u) -> bool { return a.x < b.x || (a.x == b.x && a.y < b.y); }
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    if (status[0] != 0u) { return; }
    let tile = group.y * draw.size.z + group.x;
    let start = tile_offsets[tile]; let count = tile_offsets[tile + 1u] - start;
    if (count < 2u) { return; }
    var size = 1u;
    while (size < count) { size *= 2u; }
    let fits = size <= SHARED;
    if (fits) { for (var i = local; i < count; i += GROUP) { held[i] = keys[start + i]; } }
    workgroupBarrier();
    for (var k = 2u; k <= size; k *= 2u) {
        for (var j = k / 2u; j > 0u; j /= 2u) {
            for (var q = local; q < size / 2u; q += GROUP) {
                // in the first step of a merge b mirrors a
                let low = q / j * 2u * j; let r = q % j; let a = low + r;
                let b = select(a + j, low + 2u * j - 1u - r, j == k / 2u);
                if (b < count) {
                    if (fits) {
                        let x = held[a]; let y = held[b];
                        if (is_less(y, x)) { held[a] = y; held[b] = x; }
                    } else {
                        let x = keys[start + a]; let y = keys[start + b];
                        if (is_less(y, x)) { keys[start + a] = y; keys[start + b] = x; }
                    }
                }
            }
            workgroupBarrier();
            storageBarrier();
        }
    }
    if (fits) { for (var i = local; i < count; i += GROUP) { keys[start + i] = held[i]; } }
}
