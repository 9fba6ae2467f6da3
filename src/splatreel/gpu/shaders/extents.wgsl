// Tiles that a splat touches: the ellipse of alpha 1/255, cut into columns of tiles (kernels/binning.py).
const ROOM = 2e-3;
const LOG2_255 = 7.994353436858858;
fn floor_within(value: f32, low: i32, high: i32) -> i32 { return i32(clamp(value, f32(low), f32(high)) + 1.0) - 1; }
// First and last column, first and last row of pixels; last < first if there are none.
fn box(splat: Splat) -> vec4i {
    let reach = splat.shape.y + LOG2_255;
    if (!(splat.shape.w > 0.0) || reach < 0.0) { return vec4i(0, -1, 0, -1); }
    let width = i32(draw.size.x); let height = i32(draw.size.y);
    let scale = 4.0 * reach / splat.shape.w;
    let r = sqrt(scale * vec2f(splat.shape.x, splat.place.z)) + ROOM;
    let low = splat.place.xy - r - 0.5; let high = splat.place.xy + r - 0.5;
    return vec4i(
        floor_within(low.x, -1, width) + 1, floor_within(high.x, -1, width - 1),
        floor_within(low.y, -1, height) + 1, floor_within(high.y, -1, height - 1),
    );
}
// First and last row of pixels of the ellipse within a column of tiles.
fn strip(splat: Splat, top: i32, bottom: i32, column: i32) -> vec2i {
    let a = splat.place.z; let b = splat.place.w; let c = splat.shape.x;
    let reach = splat.shape.y + LOG2_255; let determinant = splat.shape.w;
    let left = f32(column * 16) + 0.5 - ROOM - splat.place.x; let right = left + 15.0 + 2.0 * ROOM;
    let extent = sqrt(4.0 * a * reach / determinant); let lean = b * extent / (2.0 * a);
    var high = 1e9; var low = -1e9;
    if (left <= lean && lean <= right) { high = -extent; }
    if (left <= -lean && -lean <= right) { low = extent; }
    for (var side = 0u; side < 2u; side++) {
        let dx = select(left, right, side == 1u);
        let square = 4.0 * c * reach - determinant * dx * dx;
        if (square >= 0.0) {
            let root = sqrt(square);
            high = min(high, (-b * dx - root) / (2.0 * c));
            low = max(low, (root - b * dx) / (2.0 * c));
        }
    }
    return vec2i(floor_within(splat.place.y + high - 0.5 - ROOM, top - 1, bottom) + 1,
                 floor_within(splat.place.y + low - 0.5 + ROOM, top - 1, bottom));
}
