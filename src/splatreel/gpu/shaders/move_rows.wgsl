// use: common
// Take over the rows of Adam's moments after points were added and removed. New points start at zero.
@group(0) @binding(0) var<uniform> length: vec4u;  // points now, points before, columns
@group(0) @binding(1) var<storage, read> origins: array<i32>;  // [points now]: row before; -1 if new
@group(0) @binding(2) var<storage, read> old_means: array<f32>;
@group(0) @binding(3) var<storage, read> old_squares: array<f32>;
@group(0) @binding(4) var<storage, read_write> means: array<f32>;  // [columns, points now]
@group(0) @binding(5) var<storage, read_write> squares: array<f32>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let e = linear(group, groups, local); let n = length.x;
    if (e >= n * length.z) { return; }
    let origin = origins[e % n]; var mean = 0.0; var square = 0.0;
    if (origin >= 0) {
        let old = e / n * length.y + u32(origin);
        mean = old_means[old]; square = old_squares[old];
    }
    means[e] = mean; squares[e] = square;
}
