// use: common
// Exclusive sums of the sums of the blocks, any number of them, in place, by one workgroup.
@group(0) @binding(0) var<uniform> length: vec4u;
@group(0) @binding(1) var<storage, read_write> sums: array<u32>;
var<workgroup> totals: array<u32, GROUP>;
@compute @workgroup_size(GROUP)
fn main(@builtin(local_invocation_index) local: u32) {
    var carried = 0u;
    for (var start = 0u; start < length.y; start += GROUP) {
        var value = 0u;
        if (start + local < length.y) { value = sums[start + local]; }
        totals[local] = value;
        workgroupBarrier();
        for (var step = 1u; step < GROUP; step *= 2u) {
            var other = 0u;
            if (local >= step) { other = totals[local - step]; }
            workgroupBarrier();
            totals[local] += other;
            workgroupBarrier();
        }
        if (start + local < length.y) { sums[start + local] = carried + totals[local] - value; }
        carried += totals[GROUP - 1u];
        workgroupBarrier();
    }
}
