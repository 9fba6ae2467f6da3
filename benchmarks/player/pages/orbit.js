// What all players share: a canvas of the asked size, an orbit of poses, and the time between finished pictures while it goes round.
const parameters = new URLSearchParams(location.search);
export const [width, height] = [Number(parameters.get("width")), Number(parameters.get("height"))];
export const scene = await (await fetch("scene.json")).json();

/** Vertical field of view, degrees. */
export const fov = (2 * Math.atan(height / 2 / scene.focal) * 180) / Math.PI;

/** Camera to world, column by column, OpenGL axes (x right, y up, z back), from world to camera in OpenCV's. */
export function worldOf(m) {
  const column = (r, sign) => [sign * m[4 * r], sign * m[4 * r + 1], sign * m[4 * r + 2], 0];
  const eye = [0, 1, 2].map((i) => -(m[i] * m[3] + m[4 + i] * m[7] + m[8 + i] * m[11]));
  return [...column(0, 1), ...column(1, -1), ...column(2, -1), ...eye, 1];
}

const nextPicture = () => new Promise(requestAnimationFrame);

const afterPicture = () => new Promise((done) => setTimeout(done));

/** Wait until the device has drawn all it was given, by reading a pixel: a page may run many pictures ahead of it. */
function finish(gl) {
  const [target, buffer] = [gl.getParameter(gl.READ_FRAMEBUFFER_BINDING), gl.getParameter(gl.PIXEL_PACK_BUFFER_BINDING)];
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
  gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, target);
  gl.bindBuffer(gl.PIXEL_PACK_BUFFER, buffer);
}

/** Go round; `pose` takes a world-to-camera matrix and has it drawn in the next picture. Milliseconds between finished pictures. */
export async function measure(pose, canvas) {
  const gl = canvas.getContext("webgl2");
  const times = [];
  let last = 0;
  for (const viewmat of scene.poses) {
    pose(viewmat);
    await nextPicture();
    await afterPicture();
    finish(gl);
    const now = performance.now();
    if (last > 0) times.push(now - last);
    last = now;
  }
  return times;
}

/** Stay at a pose until sorts have settled. */
export async function settle(pose, viewmat, pictures = 12) {
  for (let i = 0; i < pictures; i++) {
    pose(viewmat);
    await nextPicture();
  }
}
