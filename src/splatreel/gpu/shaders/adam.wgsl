// One value's step of Adam (kernels/adam.py). step: rate, correction of the square, eps.
const DECAY = 0.9;
const SQUARE_DECAY = 0.999;
fn follow(e: u32, slope: f32, step: vec4f) -> f32 {
    let mean = means[e] + (slope - means[e]) * (1.0 - DECAY);
    let square = squares[e] * SQUARE_DECAY + slope * slope * (1.0 - SQUARE_DECAY);
    means[e] = mean;
    squares[e] = square;
    return step.x * mean / (sqrt(square) * step.y + step.z);
}
