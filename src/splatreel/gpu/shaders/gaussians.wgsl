// Quaternions, rotations and the projection of a Gaussian (kernels/project.py, motion.py, deform.py).
const MEANS = 0u; const QUATS = 3u; const SCALES = 7u; const LOGIT = 10u; const BASE = 11u; const REST = 14u;
const EXTENT = 3.33;
const LEAST_AREA = 1e-6;
const FINE_BLUR = 0.1;

fn inverse_norm(q: vec4f) -> f32 { return 1.0 / max(sqrt(dot(q, q)), 1e-12); }
fn product(a: vec4f, b: vec4f) -> vec4f {
    return vec4f(
        a.x * b.x - a.y * b.y - a.z * b.z - a.w * b.w,
        a.x * b.y + a.y * b.x + a.z * b.w - a.w * b.z,
        a.x * b.z - a.y * b.w + a.z * b.x + a.w * b.y,
        a.x * b.w + a.y * b.z - a.z * b.y + a.w * b.x,
    );
}
fn conjugate(q: vec4f) -> vec4f { return vec4f(q.x, -q.y, -q.z, -q.w); }
fn unit_gradient(unit: vec4f, inverse: f32, g: vec4f) -> vec4f { return (g - dot(g, unit) * unit) * inverse; }
// Columns of the rotation matrix of a unit quaternion wxyz.
fn rotation(q: vec4f) -> mat3x3f {
    let w = q.x; let x = q.y; let y = q.z; let z = q.w;
    return mat3x3f(
        vec3f(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        vec3f(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        vec3f(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
}
struct Posed { point: vec3f, ahead: bool, slope: vec2f, clamped: vec2f, focal: vec2f, j: vec3f, k: vec3f }
// j and k are the rows of the Jacobian of the projection times the rotation of the camera.
fn pose(mean: vec3f) -> Posed {
    var p: Posed;
    let at = vec4f(mean, 1.0);
    p.point = vec3f(dot(draw.row0, at), dot(draw.row1, at), dot(draw.row2, at));
    p.ahead = draw.center.w <= p.point.z;
    if (!p.ahead) { p.point = vec3f(0.0, 0.0, 1.0); }
    p.focal = draw.lens.xy / p.point.z;
    p.slope = p.point.xy / p.point.z;
    p.clamped = clamp(p.slope, draw.bounds.xz, draw.bounds.yw);
    p.j = p.focal.x * (draw.row0.xyz - p.clamped.x * draw.row2.xyz);
    p.k = p.focal.y * (draw.row1.xyz - p.clamped.y * draw.row2.xyz);
    return p;
}
fn kept_area(conic: vec3f) -> f32 {
    return max(1.0 - FINE_BLUR * (conic.x + conic.z) + FINE_BLUR * FINE_BLUR * (conic.x * conic.z - conic.y * conic.y), LEAST_AREA);
}
