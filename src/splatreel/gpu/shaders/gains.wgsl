// Color gain of the camera. If TINTED, the drawing has the gain of its background, and the colors of the points have the rest.
fn camera_gain() -> vec3f {
    let camera = 3u * draw.numbers.y;
    return vec3f(gains[camera], gains[camera + 1u], gains[camera + 2u]);
}
fn drawing_gain() -> vec3f {
    if ((draw.numbers.x & TINTED) != 0u) { return draw.behind.xyz; }
    return camera_gain();
}
fn point_gain() -> vec3f { return camera_gain() / draw.behind.xyz; }
