// use: common, gains, target, windows
// Absolute differences of the channels FIRST to END of each changed tile, and the gradient of the whole photometric loss to its pixels
// and to the gain.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> image: array<vec4f>;
@group(0) @binding(2) var<storage, read> targets: array<u32>;
@group(0) @binding(3) var<storage, read> gains: array<f32>;
@group(0) @binding(4) var<storage, read> tiles: array<vec4u>;
@group(0) @binding(5) var<storage, read> maps: array<f32>;
@group(0) @binding(6) var<storage, read_write> sums: array<f32>;
@group(0) @binding(7) var<storage, read_write> d_image: array<vec4f>;
var<workgroup> planes: array<array<f32, AREA>, 3>;
var<workgroup> across: array<vec3f, WIDE * TILE>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let tile = group.y * draw.size.z + group.x; let pixels = draw.size.x * draw.size.y;
    if (!block_near(group, 0)) {
        if (local == 0u) { for (var k = 1u; k < 5u; k++) { sums[5u * tile + k] = 0.0; } }
        return;
    }
    let gain = drawing_gain();
    var total = vec4f(0.0);  // absolute differences, gradient to the gain
    for (var c = FIRST; c < END; c++) {
        for (var k = local; k < AREA; k += GROUP) {
            let x = i32(group.x * TILE + k % WIDE) - 5; let y = i32(group.y * TILE + k / WIDE) - 5;
            let inside = x >= 0 && y >= 0 && x < i32(draw.size.x) && y < i32(draw.size.y);
            for (var m = 0u; m < 3u; m++) {
                planes[m][k] = 0.0;
                if (inside) { planes[m][k] = maps[((END - FIRST) * m + c - FIRST) * pixels + u32(y) * draw.size.x + u32(x)]; }
            }
        }
        workgroupBarrier();
        for (var k = local; k < WIDE * TILE; k += GROUP) {
            let start = k / TILE * WIDE + k % TILE; var sum = vec3f(0.0);
            for (var j = 0u; j < 11u; j++) { sum += WINDOW[j] * vec3f(planes[0][start + j], planes[1][start + j], planes[2][start + j]); }
            across[k] = sum;
        }
        workgroupBarrier();
        for (var k = local; k < TILE_PIXELS; k += GROUP) {
            let x = group.x * TILE + k % TILE; let y = group.y * TILE + k / TILE; let pixel = y * draw.size.x + x;
            if (x >= draw.size.x || y >= draw.size.y) { continue; }
            var s = vec3f(0.0);
            for (var j = 0u; j < 11u; j++) { s += WINDOW[j] * across[k + TILE * j]; }
            let plain = image[pixel][c] + draw.background[c];
            let seen = plain * gain[c]; let wanted = target_color(pixel)[c];
            let slope = draw.loss.x * sign(seen - wanted) - draw.loss.y * (s.x + 2.0 * seen * s.y + wanted * s.z);
            total.x += abs(seen - wanted);
            total[c + 1u] += slope * plain;
            d_image[pixel][c] = slope * gain[c];
            if (c == 2u) { d_image[pixel].w = 0.0; }
        }
        workgroupBarrier();
    }
    across[local] = total.xyz;
    planes[0][local] = total.w;
    workgroupBarrier();
    if (local == 0u) {
        var sum = vec4f(0.0);
        for (var k = 0u; k < GROUP; k++) { sum += vec4f(across[k], planes[0][k]); }
        for (var k = 0u; k < 4u; k++) {
            if (FIRST > 0u) { sum[k] += sums[5u * tile + 1u + k]; }
            sums[5u * tile + 1u + k] = sum[k];
        }
    }
}
