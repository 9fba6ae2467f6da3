// use: common, gaussians, harmonics, extents
// Deform and project every point, compute its color, and count the tiles that it touches.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> params: array<f32>;   // [columns, points]
@group(0) @binding(2) var<storage, read> offsets: array<f32>;
@group(0) @binding(3) var<storage, read_write> splats: array<Splat>;
@group(0) @binding(4) var<storage, read_write> first: array<u32>;  // pairs of each point; 0 at the end
@group(0) @binding(5) var<storage, read_write> tile_counts: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> status: array<atomic<u32>>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local); let n = draw.counts.x;
    if (i == n) { first[n] = 0u; }
    if (i >= n) { return; }
    var mean = vec3f(params[i], params[n + i], params[2u * n + i]);
    var quat = vec4f(params[3u * n + i], params[4u * n + i], params[5u * n + i], params[6u * n + i]);
    let log_scale = vec3f(params[7u * n + i], params[8u * n + i], params[9u * n + i]);
    var logit = params[10u * n + i];
    var color = vec3f(params[11u * n + i], params[12u * n + i], params[13u * n + i]);
    if ((draw.numbers.x & MOVED) != 0u) {
        mean += vec3f(offsets[i], offsets[n + i], offsets[2u * n + i]);
        let turn = vec4f(offsets[3u * n + i], offsets[4u * n + i], offsets[5u * n + i], offsets[6u * n + i]);
        quat = product(quat, turn * inverse_norm(turn));
    }
    if ((draw.numbers.x & SHADED) != 0u) {
        color += vec3f(offsets[42u * n + i], offsets[43u * n + i], offsets[44u * n + i]);
        logit += offsets[45u * n + i];
    }
    var finite = is_finite(dot(mean, vec3f(1.0))) && is_finite(dot(quat, quat)) && is_finite(dot(log_scale, vec3f(1.0)));
    let toward = mean - draw.center.xyz;
    let direction = toward / max(length(toward), 1e-12);
    color = 0.5 + C0 * color;
    for (var band = 0u; band < draw.counts.y; band++) {
        let column = (REST + 3u * band) * n + i;
        color += basis(band + 1u, direction) * vec3f(params[column], params[column + n], params[column + 2u * n]);
    }
    finite = finite && is_finite(logit) && is_finite(dot(color, vec3f(1.0)));
    if (!finite) { atomicStore(&status[1], 1u); }
    let opaque = 1.0 / (1.0 + exp(min(-logit, 80.0)));

    let p = pose(mean);
    let turned = rotation(quat * inverse_norm(quat)); let scale = exp(log_scale);
    let a = (p.j * turned) * scale; let b = (p.k * turned) * scale;
    let xx = dot(a, a) + draw.background.w; let yy = dot(b, b) + draw.background.w; let xy = dot(a, b);
    let determinant = xx * yy - xy * xy;
    let place = p.focal * p.point.xy + draw.lens.zw;
    let r = ceil(EXTENT * sqrt(vec2f(xx, yy)));
    let inside = all(place + r > vec2f(0.0)) && all(place - r < vec2f(draw.size.xy));
    let seen = finite && p.ahead && determinant > 0.0 && inside;
    let conic = vec3f(yy, -xy, xx) / select(1.0, determinant, determinant > 0.0);
    let opacity = opaque * select(1.0, sqrt(kept_area(conic)), (draw.numbers.x & FINE) != 0u);

    var splat: Splat;
    let half = LOG2_E * vec3f(0.5, 1.0, 0.5) * conic;
    // 4 a c - b^2 cancels for thin splats: the rounding errors of both products are added back.
    let square = half.y * half.y; let lost = fma(half.y, half.y, -square);
    let difference = fma(4.0 * half.x, half.z, -square) - lost;
    splat.place = vec4f(place, half.x, half.y);
    splat.shape = vec4f(half.z, log2(max(opacity, 1.0 / 255.0)), p.point.z, difference);
    if (!seen || opacity < 1.0 / 255.0) { splat.shape.w = -1.0; }
    let positive = color > vec3f(0.0);
    splat.color = vec4f(max(color, vec3f(0.0)) - draw.background.xyz, dot(vec3f(1.0, 2.0, 4.0), select(vec3f(0.0), vec3f(1.0), positive)));
    splats[i] = splat;

    var pairs = 0u; let bounds = box(splat);
    if (bounds.x <= bounds.y && bounds.z <= bounds.w) {
        for (var column = bounds.x / 16; column <= bounds.y / 16; column++) {
            let rows = strip(splat, bounds.z, bounds.w, column);
            if (rows.y < rows.x) { continue; }
            for (var row = rows.x / 16; row <= rows.y / 16; row++) {
                atomicAdd(&tile_counts[u32(row) * draw.size.z + u32(column)], 1u);
                pairs++;
            }
        }
    }
    first[i] = pairs;
}
