// use: common, gains, target, windows
// SSIM of the channels FIRST to END of each compared tile, and its gradients to the blurred maps of x, x^2 + y^2 and x y.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> image: array<vec4f>;
@group(0) @binding(2) var<storage, read> targets: array<u32>;
@group(0) @binding(3) var<storage, read> gains: array<f32>;
@group(0) @binding(4) var<storage, read> tiles: array<vec4u>;
@group(0) @binding(5) var<storage, read> status: array<u32>;
@group(0) @binding(6) var<storage, read_write> maps: array<f32>;  // [3 maps, channels, pixels]
@group(0) @binding(7) var<storage, read_write> sums: array<f32>;  // [tiles, 5]: SSIM, absolute differences, gradient to the gain
var<workgroup> xs: array<f32, AREA>;
var<workgroup> ys: array<f32, AREA>;
var<workgroup> across: array<vec4f, WIDE * TILE>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    if (status[0] != 0u) { return; }
    let tile = group.y * draw.size.z + group.x; let pixels = draw.size.x * draw.size.y;
    if (!block_near(group, 1)) {
        if (local == 0u) { sums[5u * tile] = 0.0; }
        return;
    }
    var total = 0.0;
    for (var c = FIRST; c < END; c++) {
        for (var k = local; k < AREA; k += GROUP) {
            let x = i32(group.x * TILE + k % WIDE) - 5; let y = i32(group.y * TILE + k / WIDE) - 5;
            xs[k] = 0.0; ys[k] = 0.0;
            if (x >= 0 && y >= 0 && x < i32(draw.size.x) && y < i32(draw.size.y)) {
                let pixel = u32(y) * draw.size.x + u32(x);
                xs[k] = drawn_color(pixel)[c]; ys[k] = target_color(pixel)[c];
            }
        }
        workgroupBarrier();
        for (var k = local; k < WIDE * TILE; k += GROUP) {
            let start = k / TILE * WIDE + k % TILE; var sum = vec4f(0.0);
            for (var j = 0u; j < 11u; j++) {
                let a = xs[start + j]; let b = ys[start + j];
                sum += WINDOW[j] * vec4f(a, b, a * a + b * b, a * b);
            }
            across[k] = sum;
        }
        workgroupBarrier();
        for (var k = local; k < TILE_PIXELS; k += GROUP) {
            let x = group.x * TILE + k % TILE; let y = group.y * TILE + k / TILE;
            if (x >= draw.size.x || y >= draw.size.y) { continue; }
            var s = vec4f(0.0);
            for (var j = 0u; j < 11u; j++) { s += WINDOW[j] * across[k + TILE * j]; }
            let a = 2.0 * s.x * s.y + 1e-4; let b = 2.0 * (s.w - s.x * s.y) + 9e-4;
            let c_ = s.x * s.x + s.y * s.y + 1e-4; let d = s.z - s.x * s.x - s.y * s.y + 9e-4;
            let scale = 1.0 / (c_ * d); let ssim = a * b * scale;
            let d_squares = -ssim * scale * c_; let d_product = 2.0 * a * scale;
            total += ssim;
            let at = (c - FIRST) * pixels + y * draw.size.x + x; let plane = (END - FIRST) * pixels;
            maps[at] = 2.0 * s.y * b * scale - 2.0 * s.x * (ssim * scale * d + d_squares) - s.y * d_product;
            maps[at + plane] = d_squares;
            maps[at + 2u * plane] = d_product;
        }
        workgroupBarrier();
    }
    xs[local] = total;
    workgroupBarrier();
    if (local == 0u) {
        var sum = 0.0;
        for (var k = 0u; k < GROUP; k++) { sum += xs[k]; }
        if (FIRST > 0u) { sum += sums[5u * tile]; }
        sums[5u * tile] = sum;
    }
}
