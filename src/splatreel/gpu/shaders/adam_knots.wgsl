// use: common, adam
// Take a step of Adam for the control values of splines. A moment has a gradient for four knots; other knots follow their momentum.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> gradients: array<f32>;
@group(0) @binding(2) var<storage, read> offsets: array<f32>;
@group(0) @binding(3) var<storage, read> moves: array<f32>;  // [points]: 0 for fixed points
@group(0) @binding(4) var<storage, read> status: array<u32>;
@group(0) @binding(5) var<storage, read_write> controls: array<f32>;
@group(0) @binding(6) var<storage, read_write> means: array<f32>;
@group(0) @binding(7) var<storage, read_write> squares: array<f32>;
fn knot_weight(moment: u32, knot: u32) -> f32 {
    let first = draw.knots[moment].x;
    if (knot < first || knot > first + 3u) { return 0.0; }
    return draw.weights[moment][knot - first];
}
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let e = linear(group, groups, local);
    // KIND: 0 the motion of points, 1 that of nodes, 2 the appearance
    let count = select(draw.counts.x, draw.rows.x, KIND == 1u); let columns = select(7u, 4u, KIND == 2u);
    let end = select(draw.links.z, draw.rows.w, KIND == 2u);
    if (e >= end * columns * count || status[0] != 0u) { return; }
    let knot = e / (columns * count); let row = e % (columns * count); let column = row / count; let i = row % count;
    var slope = 0.0;
    if (KIND == 2u) {
        let weight = knot_weight(7u, knot);
        if (weight != 0.0) {
            let price = draw.shade_price[column] / f32(4u * count);
            slope = weight * draw.shade_rates[column] * (gradients[28u * count + row] + price * sign(offsets[42u * count + row]));
        }
    } else {
        for (var moment = 0u; moment < draw.links.y; moment++) {
            let weight = knot_weight(moment, knot);
            if (weight != 0.0) { slope += weight * gradients[moment * 7u * count + row]; }
        }
        if (KIND == 0u) { slope *= moves[i] * select(1.0, draw.motion.x, column < 3u); }
    }
    controls[e] -= follow(e, slope, draw.adam[6u + KIND]);
}
