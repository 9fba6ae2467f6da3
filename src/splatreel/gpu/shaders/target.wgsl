// The training image. Unknown pixels repeat the drawing, so that they cause no loss.
fn drawn_color(pixel: u32) -> vec3f {
    return (image[pixel].xyz + draw.background.xyz) * drawing_gain();
}
fn target_color(pixel: u32) -> vec3f {
    let color = unpack4x8unorm(targets[draw.numbers.z + pixel]);
    if (color.w == 0.0) { return color.xyz; }
    return floor(clamp(drawn_color(pixel), vec3f(0.0), vec3f(1.0)) * 255.0 + 0.5) / 255.0;
}
