// use: common
// Offsets of every point at some moments, and its change of appearance at the last one: cubic splines of points and nodes.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> points: array<f32>;       // [knots, 7, points]
@group(0) @binding(2) var<storage, read> nodes: array<f32>;        // [knots, 7, nodes]
@group(0) @binding(3) var<storage, read> skin: array<vec2u>;       // [nodes of a point, points]: node, bits of its share
@group(0) @binding(4) var<storage, read> appearance: array<f32>;   // [knots, 4, points]
@group(0) @binding(5) var<storage, read_write> offsets: array<f32>;  // [6 moments, 7, points]: dx, dq; then [4, points]: change of appearance
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local); let n = draw.counts.x; let moment = group.z;
    if (i >= n) { return; }
    let w = draw.weights[moment]; let knot = draw.knots[moment].x;
    for (var d = 0u; d < 7u; d++) {
        var value = 0.0;
        for (var k = 0u; k < 4u; k++) { value += w[k] * points[((knot + k) * 7u + d) * n + i]; }
        for (var j = 0u; j < draw.rows.y; j++) {
            let link = skin[j * n + i]; var node = 0.0;
            for (var k = 0u; k < 4u; k++) { node += w[k] * nodes[((knot + k) * 7u + d) * draw.rows.x + link.x]; }
            value += bitcast<f32>(link.y) * node;
        }
        if (d < 3u) { value *= draw.motion.x; } else if (d == 3u) { value += 1.0; }
        offsets[(moment * 7u + d) * n + i] = value;
    }
    if (moment == 0u && (draw.numbers.x & SHADED) != 0u) {
        let v = draw.weights[7]; let begin = draw.knots[7].x;
        for (var c = 0u; c < 4u; c++) {
            var value = 0.0;
            for (var k = 0u; k < 4u; k++) { value += v[k] * appearance[((begin + k) * 4u + c) * n + i]; }
            offsets[(42u + c) * n + i] = value * draw.shade_rates[c];
        }
    }
}
