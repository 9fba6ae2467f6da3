// use: common
// Sum the slots of every splat, and convert the moments of d(log alpha) to gradients.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> first: array<u32>;
@group(0) @binding(3) var<storage, read> slots: array<f32>;
@group(0) @binding(4) var<storage, read> status: array<u32>;
@group(0) @binding(5) var<storage, read_write> d_splats: array<vec4f>;  // [points, 3]: mean, conic | opacity, color | absolute mean
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local);
    if (i >= draw.counts.x || status[0] != 0u) { return; }
    let splat = splats[i];
    let a = 2.0 * splat.place.z / LOG2_E; let b = splat.place.w / LOG2_E; let c = 2.0 * splat.shape.x / LOG2_E;
    var sums: array<f32, 9>; var absolute = vec2f(0.0);
    for (var pair = first[i]; pair < first[i + 1u]; pair++) {
        for (var k = 0u; k < 9u; k++) { sums[k] += slots[pair * 9u + k]; }
        let x = slots[pair * 9u + 1u]; let y = slots[pair * 9u + 2u];
        absolute += abs(vec2f(a * x + b * y, b * x + c * y));
    }
    let mean = vec4f(a * sums[1] + b * sums[2], b * sums[1] + c * sums[2], -0.5 * sums[3], -sums[4]);
    let shape = vec4f(-0.5 * sums[5], select(0.0, sums[0] * exp2(-splat.shape.y), first[i] < first[i + 1u]), 0.0, 0.0);
    if (DEPTHS) {
        d_splats[3u * i] += mean;
        d_splats[3u * i + 1u] += shape;
    } else {
        d_splats[3u * i] = mean;
        d_splats[3u * i + 1u] = vec4f(shape.xy, sums[6], sums[7]);
        d_splats[3u * i + 2u] = vec4f(sums[8], absolute, 0.0);
    }
}
