// use: common
// Change of the loss between two moments (4 and 5), to first order: one sum per workgroup.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> offsets: array<f32>;
@group(0) @binding(2) var<storage, read> d_offsets: array<f32>;
@group(0) @binding(3) var<storage, read> moves: array<f32>;
@group(0) @binding(4) var<storage, read_write> slopes: array<f32>;
var<workgroup> parts: array<f32, GROUP>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local); let n = draw.counts.x; var sum = 0.0;
    if (i < n) {
        for (var d = 0u; d < 7u; d++) { sum += d_offsets[d * n + i] * (offsets[(35u + d) * n + i] - offsets[(28u + d) * n + i]); }
        sum *= moves[i];
    }
    parts[local] = sum;
    workgroupBarrier();
    for (var step = GROUP / 2u; step > 0u; step /= 2u) {
        if (local < step) { parts[local] += parts[local + step]; }
        workgroupBarrier();
    }
    if (local == 0u) { slopes[group.y * groups.x + group.x] = parts[0]; }
}
