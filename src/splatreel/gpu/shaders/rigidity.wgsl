// use: common, gaussians
// Add the gradient of L_arap to the offsets of every point, with one neighbor of each (kernels/motion.py). A point collects its part
// of the pairs that other points form with it from a list of these points.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> params: array<f32>;
@group(0) @binding(2) var<storage, read> offsets: array<f32>;
@group(0) @binding(3) var<storage, read> neighbors: array<vec2u>;  // [ranks, points]: point, bits of the closeness
@group(0) @binding(4) var<storage, read> starts: array<u32>;       // [ranks, points + 1]
@group(0) @binding(5) var<storage, read> sources: array<u32>;      // [ranks, points]: points by their neighbor
@group(0) @binding(6) var<storage, read_write> d_offsets: array<f32>;
struct Body { mean: vec3f, dx: vec3f, turn: vec4f, inverse: f32 }
struct Pull { dx: vec3f, turn: vec4f }
fn body(i: u32) -> Body {
    let n = draw.counts.x; var b: Body;
    b.mean = vec3f(params[i], params[n + i], params[2u * n + i]);
    b.dx = vec3f(offsets[i], offsets[n + i], offsets[2u * n + i]);
    let turn = vec4f(offsets[3u * n + i], offsets[4u * n + i], offsets[5u * n + i], offsets[6u * n + i]);
    b.inverse = inverse_norm(turn); b.turn = turn * b.inverse;
    return b;
}
fn rotate(q: vec4f, v: vec3f) -> vec3f {
    let c = cross(q.yzw, v);
    return v + 2.0 * (q.x * c + cross(q.yzw, c));
}
// Gradient of dot(g, rotate(q, v)) to q.
fn rotate_gradient(q: vec4f, v: vec3f, g: vec3f) -> vec4f {
    let u = q.yzw;
    let along = 2.0 * (q.x * cross(v, g) + g * dot(u, v) + v * dot(u, g)) - 4.0 * u * dot(v, g);
    return vec4f(2.0 * dot(g, cross(u, v)), along);
}
// Gradient of the pair of point i and its neighbor j, to i, or to j if `far`.
fn pull(i: Body, j: Body, weight: f32, far: bool) -> Pull {
    let scale = weight / draw.motion.x;
    let half = 0.5 * (i.mean - j.mean); let apart = 2.0 * half + i.dx - j.dx;
    let g = scale * sign(apart - rotate(i.turn, half) - rotate(j.turn, half));
    let length_ = sqrt(dot(apart, apart) + 1e-12);
    let along = -scale * sign(2.0 * length(half) - length_) / length_;
    var found: Pull;
    found.dx = g + along * apart;
    let turned = weight * sign(i.turn - j.turn);
    if (far) {
        found.dx = -found.dx;
        found.turn = rotate_gradient(j.turn, half, -g) - turned;
    } else {
        found.turn = rotate_gradient(i.turn, half, -g) + turned;
    }
    return found;
}
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local); let n = draw.counts.x; let rank = draw.links.x;
    if (i >= n) { return; }
    let share = draw.motion.y / f32(n); let here = body(i); let link = neighbors[rank * n + i];
    var total = pull(here, body(link.x), share * bitcast<f32>(link.y), false);
    let row = rank * (n + 1u) + i;
    for (var k = starts[row]; k < starts[row + 1u]; k++) {
        let source = sources[rank * n + k];
        let more = pull(body(source), here, share * bitcast<f32>(neighbors[rank * n + source].y), true);
        total.dx += more.dx; total.turn += more.turn;
    }
    let d_turn = unit_gradient(here.turn, here.inverse, total.turn);
    for (var c = 0u; c < 3u; c++) { d_offsets[c * n + i] += total.dx[c]; }
    for (var c = 0u; c < 4u; c++) { d_offsets[(3u + c) * n + i] += d_turn[c]; }
}
