// Sums over the pixels of a tile by subgroups of any size. `turn` alternates between two halves with each sum, so that one barrier is
// enough: a thread that writes a half again has passed the barrier of the sum between, after which all have read that half.
var<workgroup> shares: array<f32, 2u * PARTS * MOST_SUBGROUPS>;
const MOST_SUBGROUPS = GROUP / 4u;  // the smallest subgroups have four threads
fn add_up(local: u32, slot: u32, sum0: vec3f, sum1: vec3f, sum2: vec3f, lane: u32, number: u32, subgroups: u32, turn: u32) {
    let total0 = subgroupAdd(sum0); let total1 = subgroupAdd(sum1); let total2 = subgroupAdd(sum2);
    let half = turn * PARTS * MOST_SUBGROUPS;
    if (lane == 0u) {
        for (var c = 0u; c < 3u; c++) {
            shares[half + c * MOST_SUBGROUPS + number] = total0[c];
            shares[half + (3u + c) * MOST_SUBGROUPS + number] = total1[c];
            shares[half + (6u + c) * MOST_SUBGROUPS + number] = total2[c];
        }
    }
    workgroupBarrier();
    if (local < PARTS) {
        var sum = 0.0;
        for (var k = 0u; k < subgroups; k++) { sum += shares[half + local * MOST_SUBGROUPS + k]; }
        slots[slot * PARTS + local] = sum;
    }
}
