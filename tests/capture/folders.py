"""Tiny captures of every format with known content."""

import json
from pathlib import Path

import av
import numpy as np
from PIL import Image

from splatreel.scene.camera import Camera

WIDTH, HEIGHT, FRAMES = 32, 24, 12


def cameras(count: int = 4) -> list[Camera]:
    """Return cameras on an arc around the origin, each also rotated about its own axis."""
    made = []
    for c in range(count):
        angle, roll = 0.3 * (c - count / 2), 0.1 * c
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        lean = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
        viewmat = np.eye(4)
        viewmat[:3, :3] = lean @ turn
        viewmat[:3, 3] = [0.1 * c, -0.05, 4.0]
        K = np.array([[40.0, 0, WIDTH / 2], [0, 40.0, HEIGHT / 2], [0, 0, 1]])
        made.append(Camera(f"cam{c:02d}", viewmat, K, WIDTH, HEIGHT))
    return made


def frame(camera: int, number: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """Return a flat image whose color encodes camera and frame, uint8 [height, width, 3]."""
    return np.full((height, width, 3), (20 + 15 * number, 40 + 40 * camera, 128), np.uint8)


def which(image: np.ndarray) -> tuple[int, int]:
    """Return the camera and frame that the color of an image of `frame` encodes."""
    red, green, _ = image.reshape(-1, 3).mean(0)
    return round((green - 40) / 40), round((red - 20) / 15)


def write_video(path: Path, images: list[np.ndarray], options: dict[str, str] | None = None) -> None:
    """Write H.264 with B-frames and a keyframe every five frames."""
    with av.open(str(path), "w", options=options or {}) as container:
        stream = container.add_stream("libx264", rate=30)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv444p"
        stream.codec_context.options = {"crf": "1", "g": "5", "bf": "2", "preset": "ultrafast", "b-adapt": "0"}
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))


def llff(cameras: list[Camera]) -> np.ndarray:
    """Return poses_bounds rows [C, 17] by the format's definition, from camera-to-world matrices."""
    rows = []
    for camera in cameras:
        world = np.linalg.inv(camera.viewmat.astype(np.float64))
        right, down, forward, center = world[:3].T
        matrix = np.stack([down, right, -forward, center, [camera.height, camera.width, camera.K[0, 0]]], 1)
        rows.append([*matrix.ravel(), 1.5, 9.0])
    return np.array(rows)


def neu3dv(folder: Path, count: int = 4, frames: int = FRAMES) -> Path:
    folder.mkdir()
    for c, camera in enumerate(cameras(count)):
        write_video(folder / f"{camera.name}.mp4", [frame(c, t) for t in range(frames)])
    np.save(folder / "poses_bounds.npy", llff(cameras(count)))
    return folder


def panoptic(folder: Path, frames: int = 5) -> Path:
    """Write training cameras 1, 2, 12 and test camera 10."""
    views = cameras()
    for file, members in (("train_meta.json", {1: 0, 2: 1, 12: 2}), ("test_meta.json", {10: 3})):
        meta = {
            "w": WIDTH,
            "h": HEIGHT,
            "k": [[views[c].K.tolist() for c in members.values()]] * frames,
            "w2c": [[views[c].viewmat.tolist() for c in members.values()]] * frames,
            "fn": [[f"{name}/{t:06d}.png" for name in members] for t in range(frames)],
            "cam_id": [list(members)] * frames,
        }
        folder.mkdir(exist_ok=True)
        (folder / file).write_text(json.dumps(meta))
        for name, c in members.items():
            (folder / "ims" / str(name)).mkdir(parents=True)
            for t in range(frames):
                Image.fromarray(frame(c, t)).save(folder / "ims" / str(name) / f"{t:06d}.png")
    return folder


def colmap(folder: Path, model: str = "PINHOLE", params: str = "80 80 32 24", images: str = "images_2") -> Path:
    """Write a text model for 64x48 whose images are 32x24 and have another extension."""
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    (sparse / "cameras.txt").write_text(f"1 {model} 64 48 {params}\n")
    lines = []
    (folder / images).mkdir()
    for c, camera in enumerate(cameras()):
        translation = " ".join(str(x) for x in camera.viewmat[:3, 3])
        w, x, y, z = _quaternion(camera.viewmat[:3, :3])
        lines += [f"{c + 1} {w} {x} {y} {z} {translation} 1 view/{camera.name}.png", ""]
        (folder / images / "view").mkdir(exist_ok=True)
        Image.fromarray(frame(c, 0)).save(folder / images / "view" / f"{camera.name}.jpg", quality=95)
    (sparse / "images.txt").write_text("\n".join(lines) + "\n")
    (sparse / "points3D.txt").write_text("1 0.5 -0.25 1.0 255 51 0 0.7\n7 0 0 0 0 255 102 0.1\n")
    return folder


def colmap_model(folder: Path, views: list[Camera]) -> Path:
    """Write a text model whose images are each camera's first one, NAME/000000.png."""
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    rows, lines = [], []
    for c, camera in enumerate(views):
        fx, fy, cx, cy = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]
        rows.append(f"{c + 1} PINHOLE {camera.width} {camera.height} {fx} {fy} {cx} {cy}")
        pose = " ".join(str(x) for x in [*_quaternion(camera.viewmat[:3, :3]), *camera.viewmat[:3, 3]])
        lines += [f"{c + 1} {pose} {c + 1} {camera.name}/000000.png", ""]
    (sparse / "cameras.txt").write_text("\n".join(rows) + "\n")
    (sparse / "images.txt").write_text("\n".join(lines) + "\n")
    (sparse / "points3D.txt").write_text("")
    return folder


def technicolor(folder: Path, frames: int = 3, first: int = 51) -> Path:
    """Write cameras 00 to 03 of a scene whose frames start at 51."""
    folder.mkdir()
    lines = ["f cu cv ar sk qw qx qy qz tx ty tz"]
    for c, camera in enumerate(cameras()):
        numbers = [40.0, WIDTH / 2, HEIGHT / 2, 1, 0, *_quaternion(camera.viewmat[:3, :3]), *camera.viewmat[:3, 3]]
        lines.append(" ".join(str(float(x)) for x in numbers))
        for t in range(frames):
            Image.fromarray(frame(c, t)).save(folder / f"Painter_undist_{first + t:05d}_{c:02d}.png")
    (folder / "cameras_parameters.txt").write_text("\n".join(lines) + "\n")
    return folder


def easyvolcap(folder: Path, frames: int = 3, bends: tuple[float, ...] = (0, 0, 0, 0, 0), size: int = 2) -> Path:
    """Write cameras 00 to 03; K is for images `size` times as large as those in the folder."""
    import cv2

    folder.mkdir()
    intrinsics = cv2.FileStorage(str(folder / "intri.yml"), cv2.FILE_STORAGE_WRITE)
    extrinsics = cv2.FileStorage(str(folder / "extri.yml"), cv2.FILE_STORAGE_WRITE)
    for storage in (intrinsics, extrinsics):
        storage.startWriteStruct("names", cv2.FileNode_SEQ)
        for c in range(4):
            storage.write("", f"{c:02d}")
        storage.endWriteStruct()
    for c, camera in enumerate(cameras()):
        intrinsics.write(f"K_{c:02d}", camera.K.astype(float) * [[size], [size], [1]])
        intrinsics.write(f"D_{c:02d}", np.array(bends, float).reshape(5, 1))
        intrinsics.write(f"W_{c:02d}", float(size * WIDTH))
        intrinsics.write(f"H_{c:02d}", float(size * HEIGHT))
        extrinsics.write(f"Rot_{c:02d}", camera.viewmat[:3, :3].astype(float))
        extrinsics.write(f"R_{c:02d}", cv2.Rodrigues(camera.viewmat[:3, :3].astype(float))[0])
        extrinsics.write(f"T_{c:02d}", camera.viewmat[:3, 3:].astype(float))
        (folder / "images" / f"{c:02d}").mkdir(parents=True)
        for t in range(frames):
            Image.fromarray(frame(c, t)).save(folder / "images" / f"{c:02d}" / f"{t:06d}.png")
    intrinsics.release()
    extrinsics.release()
    return folder


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return wxyz of a rotation by less than half a turn."""
    w = np.sqrt(1 + np.trace(rotation)) / 2
    x, y, z = (rotation[[2, 0, 1], [1, 2, 0]] - rotation[[1, 2, 0], [2, 0, 1]]) / (4 * w)
    return np.array([w, x, y, z])
