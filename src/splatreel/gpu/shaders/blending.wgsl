// Splats of a tile in shared memory, and their alpha (kernels/blending.py).
const MAX_ALPHA = 0.999;
const MIN_ALPHA = 1.0 / 255.0;
const MIN_TRANSMITTANCE = 1e-4;
const PIXELS = TILE_PIXELS / GROUP;  // of each thread
const BATCH = 32u;
var<workgroup> places: array<vec4f, BATCH>;
var<workgroup> shapes: array<vec4f, BATCH>;
var<workgroup> colors: array<vec3f, BATCH>;
var<workgroup> open: atomic<u32>;
var<workgroup> any_open: u32;
fn fetch(local: u32, base: u32, end: u32) {
    if (local < BATCH && base + local < end) {
        let id = list[base + local].x;
        var splat: Splat;
        if ((id & STATIC) != 0u) { splat = static_splats[id & ~STATIC]; } else { splat = splats[id]; }
        places[local] = splat.place;
        shapes[local] = splat.shape;
        colors[local] = shown(splat);
    }
}
// Colors, or the first three powers of the log of the depth over the near plane.
fn shown(splat: Splat) -> vec3f {
    if (!DEPTHS) { return splat.color.xyz; }
    let depth = log(max(splat.shape.z, draw.surfaces.z) / draw.surfaces.z);
    return vec3f(depth, depth * depth, depth * depth * depth);
}
fn alpha_at(k: u32, offset: vec2f) -> f32 {
    let place = places[k]; let shape = shapes[k];
    return exp2(shape.y - (offset.x * (place.z * offset.x + place.w * offset.y) + shape.x * offset.y * offset.y));
}
