// use: common, blending
// Gradients of every (splat, tile) pair, front to back, summed over the pixels of the tile into the slot of the pair: six moments of
// d(log alpha), and the gradient to the color. There are no float atomics, and the bits do not depend on timing.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> static_splats: array<Splat>;
@group(0) @binding(3) var<storage, read> list: array<vec2u>;
@group(0) @binding(4) var<storage, read> tiles: array<vec4u>;
@group(0) @binding(5) var<storage, read> image: array<vec4f>;
@group(0) @binding(6) var<storage, read> d_image: array<vec4f>;
@group(0) @binding(7) var<storage, read> status: array<u32>;
@group(0) @binding(8) var<storage, read_write> slots: array<f32>;  // [pairs, 9]
const PARTS = 9u;
SUMS
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) localSUBGROUP_ARGUMENTS) {
    if (status[0] != 0u) { return; }
    let tile = tiles[group.y * draw.size.z + group.x];
    if ((tile.z & DRAWN) == 0u) { return; }
    let also_static = (draw.numbers.x & METERED_STATIC) != 0u;
    var through: array<f32, PIXELS>; var rest: array<f32, PIXELS>; var slope: array<vec4f, PIXELS>; var on: array<bool, PIXELS>;
    for (var p = 0u; p < PIXELS; p++) {
        let pixel = local + p * GROUP; let x = group.x * TILE + pixel % TILE; let y = group.y * TILE + pixel / TILE;
        on[p] = x < draw.size.x && y < draw.size.y;
        through[p] = 1.0; rest[p] = 0.0; slope[p] = vec4f(0.0);
        if (on[p]) { slope[p] = d_image[y * draw.size.x + x]; rest[p] = dot(slope[p], image[y * draw.size.x + x]); }
    }
    var turn = 0u;  // half of `shares` that the next sum uses; a splat without gradient uses none
    var base = tile.x;
    for (; base < tile.y; base += BATCH) {
        if (local == 0u) { atomicStore(&open, 0u); }
        workgroupBarrier();
        for (var p = 0u; p < PIXELS; p++) { if (on[p]) { atomicStore(&open, 1u); } }
        fetch(local, base, tile.y);
        workgroupBarrier();
        if (local == 0u) { any_open = atomicLoad(&open); }
        if (workgroupUniformLoad(&any_open) == 0u) { break; }
        let count = min(BATCH, tile.y - base);
        for (var k = 0u; k < count; k++) {
            let entry = list[base + k];
            let wanted = (entry.x & STATIC) == 0u || also_static;
            var sum0 = vec3f(0.0); var sum1 = vec3f(0.0); var sum2 = vec3f(0.0);
            for (var p = 0u; p < PIXELS; p++) {
                if (!on[p]) { continue; }
                let pixel = local + p * GROUP;
                let at = vec2f(f32(group.x * TILE + pixel % TILE), f32(group.y * TILE + pixel / TILE)) + 0.5;
                let offset = at - places[k].xy; let opacity = alpha_at(k, offset); let alpha = min(opacity, MAX_ALPHA);
                if (alpha < MIN_ALPHA) { continue; }
                let weight = alpha * through[p]; let behind = through[p] - weight;
                if (behind <= MIN_TRANSMITTANCE) { on[p] = false; continue; }
                let value = slope[p].w + dot(slope[p].xyz, colors[k]);
                rest[p] -= weight * value;
                if (wanted) {
                    var moment = 0.0;  // no gradient through the clamp
                    if (opacity <= MAX_ALPHA) { moment = opacity * (through[p] * value - rest[p] / (1.0 - alpha)); }
                    sum0 += moment * vec3f(1.0, offset);
                    sum1 += moment * vec3f(offset.x * offset.x, offset.x * offset.y, offset.y * offset.y);
                    sum2 += weight * slope[p].xyz;
                }
                through[p] = behind;
            }
            if (wanted) { REDUCE }
        }
    }
    for (; base < tile.y; base += BATCH) {  // splats behind the last one that shows
        let k = base + local;
        if (local < BATCH && k < tile.y && ((list[k].x & STATIC) == 0u || also_static)) {
            for (var c = 0u; c < PARTS; c++) { slots[list[k].y * PARTS + c] = 0.0; }
        }
    }
}
