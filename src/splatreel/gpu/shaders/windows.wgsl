// The window of SSIM, and which tiles are compared: blocks of five tiles side by side, as on the CPU (kernels/photometric.py), so
// that the loss is the same.
const WINDOW = array<f32, 11>(0.00102838012, 0.00759875821, 0.0360007733, 0.109360687, 0.213005543, 0.266011715,
                              0.213005543, 0.109360687, 0.0360007733, 0.00759875821, 0.00102838012);
const WIDE = 26u;           // a tile and five pixels around it
const AREA = WIDE * WIDE;
const BLOCK = 5u;
fn is_drawn(column: i32, row: i32) -> bool {
    if (column < 0 || row < 0 || column >= i32(draw.size.z) || row >= i32(draw.size.w)) { return false; }
    return (tiles[u32(row) * draw.size.z + u32(column)].z & DRAWN) != 0u;
}
fn block_near(group: vec3u, around: i32) -> bool {
    let first = i32(group.x / BLOCK * BLOCK); var found = false;
    for (var row = i32(group.y) - around; row <= i32(group.y) + around; row++) {
        for (var column = first - around; column < first + i32(BLOCK) + around; column++) { found = found || is_drawn(column, row); }
    }
    return found;
}
