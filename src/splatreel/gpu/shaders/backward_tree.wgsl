// Sums over the pixels of a tile in shared memory.
const STRIDE = 16u;
const SHARES = GROUP / STRIDE;
var<workgroup> addends: array<f32, PARTS * GROUP>;
var<workgroup> shares: array<f32, PARTS * SHARES>;
fn add_up(local: u32, slot: u32, sum0: vec3f, sum1: vec3f, sum2: vec3f) {
    for (var c = 0u; c < 3u; c++) {
        addends[c * GROUP + local] = sum0[c];
        addends[(3u + c) * GROUP + local] = sum1[c];
        addends[(6u + c) * GROUP + local] = sum2[c];
    }
    workgroupBarrier();
    for (var task = local; task < PARTS * SHARES; task += GROUP) {
        var sum = 0.0;
        for (var k = 0u; k < STRIDE; k++) { sum += addends[task * STRIDE + k]; }
        shares[task] = sum;
    }
    workgroupBarrier();
    if (local < PARTS) {
        var sum = 0.0;
        for (var k = 0u; k < SHARES; k++) { sum += shares[local * SHARES + k]; }
        slots[slot * PARTS + local] = sum;
    }
}
