// use: common
// Exclusive sums within blocks of 4 GROUP values, in place, and the sum of each block.
@group(0) @binding(0) var<uniform> length: vec4u;
@group(0) @binding(1) var<storage, read_write> values: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;
var<workgroup> totals: array<u32, GROUP>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let block = group.y * groups.x + group.x; let start = (block * GROUP + local) * 4u;
    var before = vec4u(0u); var total = 0u;
    for (var k = 0u; k < 4u; k++) {
        before[k] = total;
        if (start + k < length.x) { total += values[start + k]; }
    }
    totals[local] = total;
    workgroupBarrier();
    for (var step = 1u; step < GROUP; step *= 2u) {
        var other = 0u;
        if (local >= step) { other = totals[local - step]; }
        workgroupBarrier();
        totals[local] += other;
        workgroupBarrier();
    }
    let base = totals[local] - total;
    for (var k = 0u; k < 4u; k++) { if (start + k < length.x) { values[start + k] = base + before[k]; } }
    if (local == GROUP - 1u && block < length.y) { sums[block] = totals[local]; }
}
