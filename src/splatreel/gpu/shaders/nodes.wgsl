// use: common
// Gradient to the splines of a node at one moment: the sum over the points that move with it.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> d_offsets: array<f32>;
@group(0) @binding(2) var<storage, read> starts: array<u32>;   // [nodes + 1]
@group(0) @binding(3) var<storage, read> links: array<vec2u>;  // point, bits of its share
@group(0) @binding(4) var<storage, read_write> d_nodes: array<f32>;  // [moments, 7, nodes]
var<workgroup> parts: array<f32, 7u * GROUP>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let node = group.x; let moment = group.z; let n = draw.counts.x;
    var sums: array<f32, 7>;
    for (var k = starts[node] + local; k < starts[node + 1u]; k += GROUP) {
        let link = links[k];
        for (var d = 0u; d < 7u; d++) { sums[d] += bitcast<f32>(link.y) * d_offsets[(7u * moment + d) * n + link.x]; }
    }
    for (var d = 0u; d < 7u; d++) { parts[d * GROUP + local] = sums[d]; }
    workgroupBarrier();
    if (local < 7u) {
        var sum = 0.0;
        for (var k = 0u; k < GROUP; k++) { sum += parts[local * GROUP + k]; }
        if (local < 3u) { sum *= draw.motion.x; }
        d_nodes[(7u * moment + local) * draw.rows.x + node] = sum;
    }
}
