// use: common, blending
// Blend the splats of each drawn tile, front to back. Other tiles show the static splats alone.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> static_splats: array<Splat>;
@group(0) @binding(3) var<storage, read> list: array<vec2u>;
@group(0) @binding(4) var<storage, read> tiles: array<vec4u>;
@group(0) @binding(5) var<storage, read> frozen: array<vec4f>;
@group(0) @binding(6) var<storage, read> status: array<u32>;
@group(0) @binding(7) var<storage, read_write> image: array<vec4f>;  // color, alpha
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    if (status[0] != 0u) { return; }
    let tile = tiles[group.y * draw.size.z + group.x];
    var through: array<f32, PIXELS>; var blended: array<vec3f, PIXELS>; var on: array<bool, PIXELS>;
    for (var p = 0u; p < PIXELS; p++) {
        let pixel = local + p * GROUP; let x = group.x * TILE + pixel % TILE; let y = group.y * TILE + pixel / TILE;
        through[p] = 1.0; blended[p] = vec3f(0.0);
        on[p] = x < draw.size.x && y < draw.size.y;
        if (on[p] && (tile.z & DRAWN) == 0u) { image[y * draw.size.x + x] = frozen[y * draw.size.x + x]; }
    }
    if ((tile.z & DRAWN) == 0u) { return; }
    for (var base = tile.x; base < tile.y; base += BATCH) {
        if (local == 0u) { atomicStore(&open, 0u); }
        workgroupBarrier();
        for (var p = 0u; p < PIXELS; p++) { if (on[p]) { atomicStore(&open, 1u); } }
        fetch(local, base, tile.y);
        workgroupBarrier();
        if (local == 0u) { any_open = atomicLoad(&open); }
        if (workgroupUniformLoad(&any_open) == 0u) { break; }
        let count = min(BATCH, tile.y - base);
        for (var p = 0u; p < PIXELS; p++) {
            let pixel = local + p * GROUP;
            let at = vec2f(f32(group.x * TILE + pixel % TILE), f32(group.y * TILE + pixel / TILE)) + 0.5;
            for (var k = 0u; k < count; k++) {
                if (!on[p]) { break; }
                let alpha = min(alpha_at(k, at - places[k].xy), MAX_ALPHA);
                if (alpha < MIN_ALPHA) { continue; }
                let weight = alpha * through[p]; let behind = through[p] - weight;
                if (behind <= MIN_TRANSMITTANCE) { on[p] = false; break; }
                blended[p] += weight * colors[k];
                through[p] = behind;
            }
        }
        workgroupBarrier();
    }
    for (var p = 0u; p < PIXELS; p++) {
        let pixel = local + p * GROUP; let x = group.x * TILE + pixel % TILE; let y = group.y * TILE + pixel / TILE;
        if (x < draw.size.x && y < draw.size.y) { image[y * draw.size.x + x] = vec4f(blended[p], 1.0 - through[p]); }
    }
}
