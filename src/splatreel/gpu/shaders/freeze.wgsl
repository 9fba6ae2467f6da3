// use: common
// Copy sorted pairs into the form in which static splats are merged.
@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var<storage, read> first: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<vec2u>;
@group(0) @binding(3) var<storage, read> owners: array<u32>;
@group(0) @binding(4) var<storage, read_write> static_pairs: array<vec4u>;
@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) local: u32) {
    let k = linear(group, groups, local);
    if (k < min(first[draw.counts.x], draw.counts.w)) {
        let key = keys[k];
        static_pairs[k] = vec4u(key, owners[key.y], 0u);
    }
}
