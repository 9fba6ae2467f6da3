// Shared by all kernels: what varies from draw to draw, and how threads are numbered. `drawing.py` writes the same layout.
struct Draw {
    row0: vec4f, row1: vec4f, row2: vec4f,  // world to camera
    lens: vec4f,                            // fx, fy, cx, cy
    bounds: vec4f,                          // ranges of x/z and y/z for the Jacobian
    center: vec4f,                          // camera position; near plane
    background: vec4f,                      // color; blur of the 2D covariance
    behind: vec4f,                          // gain that the background is divided by, if TINTED
    loss: vec4f,                            // weights of absolute differences, SSIM, opacity and higher SH bands
    surfaces: vec4f,                        // weights of spread and roughness; near plane; viewing distance over the near plane
    motion: vec4f,                          // unit; weight of rigidity, of smoothness; position between two frames
    shade_rates: vec4f,
    shade_price: vec4f,
    size: vec4u,                            // width, height, columns and rows of tiles
    counts: vec4u,                          // points, higher SH bands, static points, pairs that fit
    rows: vec4u,                            // nodes, nodes of a point, knots of the motion, knots of the appearance
    numbers: vec4u,                         // flags, camera, first pixel of the target, draw of the batch
    links: vec4u,                           // rank of the neighbor, moments of the gradient, end of the trained knots, cameras
    meters: vec4f,                          // weight of a sample of the mean; 1 / seconds of the time slope; unused
    knots: array<vec4u, 8>,                 // first knot of each moment
    weights: array<vec4f, 8>,               // weights of its four knots
    adam: array<vec4f, 10>,                 // rate, correction of the square, eps; 1 if there is a step
}
struct Splat {
    place: vec4f,  // x, y, and a, b of the conic
    shape: vec4f,  // c of the conic, log2 of the opacity, depth, 4 a c - b^2 (negative: not drawn)
    color: vec4f,  // color relative to the background; mask of the channels above 0
}
const MOVED = 1u; const SHADED = 2u; const METERED = 4u; const METERED_STATIC = 8u; const WHOLE = 16u; const FINE = 32u;
const ABSOLUTE = 64u; const LEARNS_GAINS = 128u; const SCALED_STEPS = 256u; const RIGID = 512u;
const TINTED = 1024u; const BOUNDED = 2048u;
const TILE = 16u;
const TILE_PIXELS = 256u;
const STATIC = 0x80000000u;
const DRAWN = 1u;
const LOG2_E = 1.4426950408889634;

fn linear(group: vec3u, groups: vec3u, local: u32) -> u32 {
    return (group.y * groups.x + group.x) * GROUP + local;
}
fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}
