// use: common, harmonics, adam
// Take a step of Adam for every parameter of the points, and add the result to the running mean.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> gradients: array<f32>;
@group(0) @binding(2) var<storage, read> distances: array<f32>;  // [points]: factors for the steps of positions
@group(0) @binding(3) var<storage, read> status: array<u32>;
@group(0) @binding(4) var<storage, read_write> params: array<f32>;  // [columns, points]
@group(0) @binding(5) var<storage, read_write> means: array<f32>;
@group(0) @binding(6) var<storage, read_write> squares: array<f32>;
@group(0) @binding(7) var<storage, read_write> averages: array<f32>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let e = linear(group, groups, local); let n = draw.counts.x;
    if (e >= n * (14u + 3u * draw.counts.y) || status[0] != 0u) { return; }
    let column = e / n; var kind = 5u;  // means, quats, log scales, logits, base, higher bands
    if (column < 3u) { kind = 0u; } else if (column < 7u) { kind = 1u; } else if (column < 10u) { kind = 2u; }
    else if (column < 11u) { kind = 3u; } else if (column < 14u) { kind = 4u; }
    let before = params[e]; var after = before - follow(e, gradients[e], draw.adam[kind]);
    if (kind == 0u && (draw.numbers.x & SCALED_STEPS) != 0u) { after = before + distances[e % n] * (after - before); }
    if (kind == 4u && (draw.numbers.x & BOUNDED) != 0u) { after = clamp(after, -0.5 / C0, 0.5 / C0); }
    params[e] = after;
    if (draw.meters.x > 0.0) { averages[e] += draw.meters.x * (after - averages[e]); }
}
