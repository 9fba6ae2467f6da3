// use: common
// Add the screen-space gradients of static splats to their meter.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> static_splats: array<Splat>;
@group(0) @binding(2) var<storage, read> static_first: array<u32>;
@group(0) @binding(3) var<storage, read> slots: array<f32>;
@group(0) @binding(4) var<storage, read> status: array<u32>;
@group(0) @binding(5) var<storage, read_write> static_meter: array<f32>;  // [2, static points]
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = linear(group, groups, local); let n = draw.counts.z;
    if (i >= n || status[0] != 0u) { return; }
    var sum = vec2f(0.0);
    for (var pair = static_first[i]; pair < static_first[i + 1u]; pair++) {
        let slot = 9u * (draw.counts.w + pair);
        sum += vec2f(slots[slot + 1u], slots[slot + 2u]);
    }
    let splat = static_splats[i];
    let a = 2.0 * splat.place.z / LOG2_E; let b = splat.place.w / LOG2_E; let c = 2.0 * splat.shape.x / LOG2_E;
    let size = length(vec2f(a * sum.x + b * sum.y, b * sum.x + c * sum.y) * 0.5 * vec2f(draw.size.xy));
    static_meter[i] += size;
    static_meter[n + i] += f32(size > 0.0);
}
