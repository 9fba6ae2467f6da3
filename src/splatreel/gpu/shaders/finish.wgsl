// use: common, adam
// Sum the loss, learn the gains of the cameras, and write the results of the draw, by one workgroup.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> sums: array<f32>;    // [tiles, 5]
@group(0) @binding(2) var<storage, read> slopes: array<f32>;  // of the time, or [workgroups, 3] of the gain if TINTED
@group(0) @binding(3) var<storage, read> status: array<u32>;
@group(0) @binding(4) var<storage, read_write> gains: array<f32>;  // [cameras, 3]
@group(0) @binding(5) var<storage, read_write> means: array<f32>;
@group(0) @binding(6) var<storage, read_write> squares: array<f32>;
@group(0) @binding(7) var<storage, read_write> results: array<vec4f>;  // [draws]: loss, slope of the time, 1 if done, 1 if not finite
var<workgroup> parts: array<array<f32, GROUP>, 6>;
@compute @workgroup_size(GROUP)
fn main(@builtin(local_invocation_index) local: u32) {
    if (status[0] != 0u) {
        if (local == 0u) { results[draw.numbers.w] = vec4f(0.0); }
        return;
    }
    var total: array<f32, 6>;
    for (var tile = local; tile < draw.size.z * draw.size.w; tile += GROUP) {
        for (var k = 0u; k < 5u; k++) { total[k] += sums[5u * tile + k]; }
    }
    let blocks = (draw.counts.x + GROUP - 1u) / GROUP;
    if ((draw.numbers.x & TINTED) != 0u) {
        for (var c = 0u; c < 3u; c++) {
            total[2u + c] = 0.0;
            for (var k = local; k < blocks; k += GROUP) { total[2u + c] += slopes[3u * k + c]; }
        }
    } else if (draw.meters.y != 0.0) {
        for (var k = local; k < blocks; k += GROUP) { total[5] += slopes[k]; }
    }
    for (var k = 0u; k < 6u; k++) { parts[k][local] = total[k]; }
    workgroupBarrier();
    for (var step = GROUP / 2u; step > 0u; step /= 2u) {
        if (local < step) { for (var k = 0u; k < 6u; k++) { parts[k][local] += parts[k][local + step]; } }
        workgroupBarrier();
    }
    if ((draw.numbers.x & LEARNS_GAINS) != 0u && local < 3u) {
        var mean = 0.0;
        for (var camera = 0u; camera < draw.links.w; camera++) {
            let slope = select(0.0, parts[2u + local][0], camera == draw.numbers.y);
            let e = 3u * camera + local;
            gains[e] -= follow(e, slope, draw.adam[9]);
            mean += gains[e];
        }
        mean /= f32(draw.links.w);
        for (var camera = 0u; camera < draw.links.w; camera++) { gains[3u * camera + local] /= mean; }
    }
    if (local == 0u) {
        let loss = draw.loss.x * parts[1][0] + draw.meters.z - draw.loss.y * parts[0][0];
        results[draw.numbers.w] = vec4f(loss, parts[5][0] * draw.meters.y, 1.0, f32(status[1]));
    }
}
