// use: common, gaussians, harmonics
// Gradients of the points and of their offsets from those of their splats, and the meter of screen-space gradients.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> params: array<f32>;
@group(0) @binding(2) var<storage, read> offsets: array<f32>;
@group(0) @binding(3) var<storage, read> status: array<u32>;
@group(0) @binding(4) var<storage, read> splats: array<Splat>;
@group(0) @binding(5) var<storage, read> d_splats: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> gradients: array<f32>;  // [columns, points]
@group(0) @binding(7) var<storage, read_write> d_offsets: array<f32>;  // [4 moments, 7, points], then [4, points]: change of appearance
@group(0) @binding(8) var<storage, read_write> meter: array<f32>;      // [2, points]: sum of lengths, number of views
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local); let n = draw.counts.x; let flags = draw.numbers.x;
    if (i >= n || status[0] != 0u) { return; }
    var mean = vec3f(params[i], params[n + i], params[2u * n + i]);
    let canonical = vec4f(params[3u * n + i], params[4u * n + i], params[5u * n + i], params[6u * n + i]);
    var quat = canonical; var turn = vec4f(1.0, 0.0, 0.0, 0.0); var turn_inverse = 1.0;
    let scale = exp(vec3f(params[7u * n + i], params[8u * n + i], params[9u * n + i]));
    var logit = params[10u * n + i];
    if ((flags & MOVED) != 0u) {
        mean += vec3f(offsets[i], offsets[n + i], offsets[2u * n + i]);
        turn = vec4f(offsets[3u * n + i], offsets[4u * n + i], offsets[5u * n + i], offsets[6u * n + i]);
        turn_inverse = inverse_norm(turn); turn *= turn_inverse;
        quat = product(canonical, turn);
    }
    if ((flags & SHADED) != 0u) { logit += offsets[45u * n + i]; }
    let opaque = 1.0 / (1.0 + exp(min(-logit, 80.0)));
    let splat = splats[i]; let d0 = d_splats[3u * i]; let d1 = d_splats[3u * i + 1u]; let d2 = d_splats[3u * i + 2u];
    let conic = vec3f(2.0 * splat.place.z, splat.place.w, 2.0 * splat.shape.x) / LOG2_E;
    let seen = splat.shape.w > 0.0;
    let d_mean2d = d0.xy; var d_conic = vec3f(d0.zw, d1.x); var d_opaque = d1.y;
    if ((flags & FINE) != 0u) {
        let area = kept_area(conic); let root = sqrt(area);
        let slope = select(0.0, d_opaque * opaque * 0.5 / root, area > LEAST_AREA);
        d_conic += slope * FINE_BLUR * vec3f(FINE_BLUR * conic.z - 1.0, -2.0 * FINE_BLUR * conic.y, FINE_BLUR * conic.x - 1.0);
        d_opaque *= root;
    }
    var d_mean = vec3f(0.0); var d_quat = vec4f(0.0); var d_scale = vec3f(0.0);
    if (seen) {
        let p = pose(mean);
        let norm = inverse_norm(quat); let unit = quat * norm; let turned = rotation(unit);
        let a = (p.j * turned) * scale; let b = (p.k * turned) * scale;
        // -C dC C of the inverse covariance C
        let inverse = mat2x2f(conic.x, conic.y, conic.y, conic.z);
        let d_inverse = mat2x2f(d_conic.x, 0.5 * d_conic.y, 0.5 * d_conic.y, d_conic.z);
        let d_covariance = inverse * d_inverse * inverse;
        let dxx = -d_covariance[0][0]; let dxy = -2.0 * d_covariance[0][1]; let dyy = -d_covariance[1][1];
        let d_a = 2.0 * dxx * a + dxy * b; let d_b = 2.0 * dyy * b + dxy * a;
        let dj = turned * (scale * d_a); let dk = turned * (scale * d_b);
        let j_along = dot(draw.row2.xyz, dj); let k_along = dot(draw.row2.xyz, dk);
        let d_focal = vec2f(dot(draw.row0.xyz, dj) - p.clamped.x * j_along + p.point.x * d_mean2d.x,
                            dot(draw.row1.xyz, dk) - p.clamped.y * k_along + p.point.y * d_mean2d.y);
        let inner = (draw.bounds.xz <= p.slope) & (p.slope <= draw.bounds.yw);
        let d_slope = select(vec2f(0.0), -p.focal * vec2f(j_along, k_along), inner);
        let d_xy = p.focal * d_mean2d + d_slope / p.point.z;
        let d_z = -(dot(p.focal, d_focal) + dot(d_slope, p.slope)) / p.point.z;
        d_mean = draw.row0.xyz * d_xy.x + draw.row1.xyz * d_xy.y + draw.row2.xyz * d_z;
        // gradient n to rotation times scale: column m is (j d_a[m] + k d_b[m])
        var m: mat3x3f;
        for (var c = 0u; c < 3u; c++) {
            let column = p.j * d_a[c] + p.k * d_b[c];
            d_scale[c] = dot(turned[c], column);
            m[c] = column * scale[c];
        }
        let w = unit.x; let x = unit.y; let y = unit.z; let z = unit.w;  // m[column][row]
        let g = 2.0 * vec4f(
            x * (m[1][2] - m[2][1]) + y * (m[2][0] - m[0][2]) + z * (m[0][1] - m[1][0]),
            -2.0 * x * (m[1][1] + m[2][2]) + y * (m[0][1] + m[1][0]) + z * (m[0][2] + m[2][0]) + w * (m[1][2] - m[2][1]),
            x * (m[0][1] + m[1][0]) - 2.0 * y * (m[0][0] + m[2][2]) + z * (m[1][2] + m[2][1]) + w * (m[2][0] - m[0][2]),
            x * (m[0][2] + m[2][0]) + y * (m[1][2] + m[2][1]) - 2.0 * z * (m[0][0] + m[1][1]) + w * (m[0][1] - m[1][0]),
        );
        d_quat = unit_gradient(unit, norm, g);
    }
    let mask = u32(splat.color.w); var d_color = vec3f(d1.zw, d2.x);
    d_color = select(vec3f(0.0), d_color, (vec3u(mask) & vec3u(1u, 2u, 4u)) != vec3u(0u));
    let d_logit = d_opaque * opaque * (1.0 - opaque);
    if ((flags & MOVED) != 0u) {
        let d_turn = unit_gradient(turn, turn_inverse, product(conjugate(canonical), d_quat));
        for (var c = 0u; c < 3u; c++) { d_offsets[c * n + i] = d_mean[c]; }
        for (var c = 0u; c < 4u; c++) { d_offsets[(3u + c) * n + i] = d_turn[c]; }
        d_quat = product(d_quat, conjugate(turn));
    }
    let d_base = C0 * d_color;
    if ((flags & SHADED) != 0u) {
        for (var c = 0u; c < 3u; c++) { d_offsets[(28u + c) * n + i] = d_base[c]; }
        d_offsets[31u * n + i] = d_logit;
    }
    for (var c = 0u; c < 3u; c++) {
        gradients[c * n + i] = d_mean[c];
        gradients[(SCALES + c) * n + i] = d_scale[c] * scale[c];
        gradients[(BASE + c) * n + i] = d_base[c];
    }
    for (var c = 0u; c < 4u; c++) { gradients[(QUATS + c) * n + i] = d_quat[c]; }
    gradients[LOGIT * n + i] = d_logit + draw.loss.z * opaque * (1.0 - opaque);
    let toward = mean - draw.center.xyz; let direction = toward / max(length(toward), 1e-12);
    for (var band = 0u; band < draw.counts.y; band++) {
        let weight = basis(band + 1u, direction);
        for (var c = 0u; c < 3u; c++) {
            let column = (REST + 3u * band + c) * n + i;
            gradients[column] = weight * d_color[c] + draw.loss.w * sign(params[column]);
        }
    }
    if ((flags & METERED) != 0u) {
        let pull = select(d_mean2d, d2.yz, (flags & ABSOLUTE) != 0u);
        let size = length(pull * 0.5 * vec2f(draw.size.xy));
        meter[i] += size;
        meter[n + i] += f32(size > 0.0);
    }
}
