"""Images of calibration boards in front of cameras with distorting lenses."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from splatreel.calibration.board import Board, Sighting
from splatreel.scene.camera import Camera
from tests.capture import folders

WIDTH, HEIGHT, SAMPLES = 480, 360, 2
LENS = {"OPENCV": [-0.12, 0.04, 0.001, -0.002], "OPENCV_FISHEYE": [0.02, -0.01, 0.0, 0.0]}


class FilmedBoard:
    """Cameras on an arc of 2 m that look at a board which is held before them.

    Attributes:
        lenses: pycolmap.Camera by name.
        poses: World to camera in meters, [3, 4], by name.
    """

    def __init__(self, colmap: Any, degrees: list[float], model: str = "OPENCV", focal: float = 1.1) -> None:
        self.lenses: dict[str, Any] = {}
        self.poses: dict[str, np.ndarray] = {}
        self._rays: dict[str, np.ndarray] = {}
        for number, angle in enumerate(degrees):
            f = focal * WIDTH * (1 + 0.05 * number)
            params = [f, 1.01 * f, WIDTH / 2 + 6 - 3 * number, HEIGHT / 2 - 5 + 2 * number, *LENS[model]]
            name = f"cam{number:02d}"
            self.lenses[name] = colmap.Camera(model=model, width=WIDTH, height=HEIGHT, params=params)
            turn = Rotation.from_euler("zxy", [5 * number, 4 - 3 * number, -angle], degrees=True).as_matrix()
            self.poses[name] = np.column_stack([turn, [0.05 * number, -0.03, 2 + 0.1 * number]])

    @classmethod
    def seen_by(cls, colmap: Any, cameras: list[Camera]) -> "FilmedBoard":
        """Return other cameras that look at a board."""
        film = cls(colmap, [])
        for camera in cameras:
            params = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]
            film.lenses[camera.name] = colmap.Camera(
                model="PINHOLE", width=camera.width, height=camera.height, params=params
            )
            film.poses[camera.name] = camera.viewmat[:3].astype(np.float64)
        return film

    @staticmethod
    def _trace(lens: Any) -> np.ndarray:
        """Return the directions of all samples, [H * SAMPLES, W * SAMPLES, 3]."""
        y, x = (np.mgrid[: lens.height * SAMPLES, : lens.width * SAMPLES] + 0.5) / SAMPLES
        places = lens.cam_from_img(np.stack([x.ravel(), y.ravel()], 1))
        return np.column_stack([places, np.ones(len(places))]).reshape(*x.shape, 3)

    def image(
        self,
        name: str,
        board: Board,
        pose: np.ndarray,
        cells: np.ndarray | None = None,
        scene: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return a camera's image of a board, [H, W, 3] uint8.

        Args:
            name: Name of the camera.
            board: The board.
            pose: Board to world, [3, 4]. The board's origin is the outer corner of its first square.
            cells: What is printed on the board, if that is another one.
            scene: Image of what is behind the board, [H, W, 3] uint8; by default a gray one.
        """
        width, height = self.lenses[name].width, self.lenses[name].height
        turn = self.poses[name][:, :3] @ pose[:, :3]
        shift = self.poses[name][:, :3] @ pose[:, 3] + self.poses[name][:, 3]
        side = board.square_cells
        cells = np.pad(board.cells() if cells is None else cells, side // 2, constant_values=True)
        shape = height, SAMPLES, width, SAMPLES
        gray, covered = np.zeros((2, height * SAMPLES, width * SAMPLES))
        where = self._window(name, cells.shape, board, turn, shift)
        if name not in self._rays:
            self._rays[name] = self._trace(self.lenses[name])
        rays = self._rays[name][where]
        depth = (turn[:, 2] @ shift) / (rays @ turn[:, 2])
        places = (rays * depth[..., None] - shift) @ turn[:, :2] / board.square
        column, row = np.moveaxis(np.floor(places * side).astype(int) + side // 2, -1, 0)
        inside = (depth > 0) & (row >= 0) & (row < cells.shape[0]) & (column >= 0) & (column < cells.shape[1])
        shown = np.where(cells[row.clip(0, cells.shape[0] - 1), column.clip(0, cells.shape[1] - 1)], 235, 20)
        behind = turn[:, 2] @ shift < 0
        gray[where], covered[where] = inside * np.where(behind, 60, shown), inside
        seen, share = (part.reshape(shape).mean((1, 3))[..., None] for part in (gray, covered))
        scene = np.full((height, width, 3), 110, np.uint8) if scene is None else scene
        return (seen + (1 - share) * scene).astype(np.uint8)

    def _window(
        self, name: str, cells: tuple[int, ...], board: Board, turn: np.ndarray, shift: np.ndarray
    ) -> tuple[slice, slice]:
        """Return the samples around a board."""
        along = np.linspace(0, 1, 20)
        x, y = (v.ravel() for v in np.meshgrid(along, along))
        size = np.array(cells) / board.square_cells * board.square
        points = np.stack([x * size[1], y * size[0], 0 * x], 1) - [board.square / 2, board.square / 2, 0]
        places = np.asarray(self.lenses[name].img_from_cam(points @ turn.T + shift)) * SAMPLES
        low = np.floor(places.min(0)).astype(int) - 4
        high = np.ceil(places.max(0)).astype(int) + 4
        (left, top), (right, bottom) = low.clip(0), high.clip(0)
        return slice(top, bottom), slice(left, right)

    def places(self, name: str, board: Board, pose: np.ndarray) -> np.ndarray:
        """Return the pixels of all corners of a board in a camera, [N, 2]. `pose`: board to world."""
        points = board.points @ pose[:, :3].T + pose[:, 3]
        return np.asarray(self.lenses[name].img_from_cam(points @ self.poses[name][:, :3].T + self.poses[name][:, 3]))

    def sightings(self, board: Board, poses: list[np.ndarray], noise: float = 0.1) -> dict[int, dict[str, Sighting]]:
        """Return what cameras see of a board that faces them, in frames of these poses, with noise in pixels."""
        rng, found = np.random.default_rng(1), {}
        for frame, pose in enumerate(poses):
            seen = {}
            for name in self.lenses:
                normal = self.poses[name][:, :3] @ pose[:, 2]
                places = self.places(name, board, pose) + rng.normal(0, noise, (len(board.points), 2))
                inside = ((places > 0) & (places < [WIDTH, HEIGHT])).all(1)
                if normal[2] > 0.5 and inside.sum() >= 6:
                    seen[name] = Sighting(np.flatnonzero(inside), places[inside])
            if seen:
                found[frame] = seen
        return found

    def from_first(self, name: str) -> np.ndarray:
        """Return the pose of a camera in the axes of the first one, [3, 4]."""
        first, own = (np.vstack([self.poses[n], [0, 0, 0, 1]]) for n in (next(iter(self.poses)), name))
        return (own @ np.linalg.inv(first))[:3]

    def write(
        self, folder: Path, board: Board, poses: list[np.ndarray], hidden: dict[str, set[int]] | None = None
    ) -> Path:
        """Write a video of each camera. hidden: frames in which a camera does not see the board."""
        folder.mkdir(exist_ok=True)
        for name in self.lenses:
            without = (hidden or {}).get(name, set())
            blank = np.full((HEIGHT, WIDTH, 3), 110, np.uint8)
            images = [blank if t in without else self.image(name, board, pose) for t, pose in enumerate(poses)]
            folders.write_video(folder / f"{name}.mp4", images)
        return folder


def moves(board: Board, count: int, spread: float, seed: int = 0, reach: float = 0.25) -> list[np.ndarray]:
    """Return poses of a board that is held before the cameras.

    Args:
        board: The board.
        count: Number of poses.
        spread: Largest angle in degrees by which it is turned to either side.
        seed: Seed of all random choices.
        reach: Largest distance from the middle in meters, along each axis.
    """
    rng, made = np.random.default_rng(seed), []
    middle = np.array([board.columns, board.rows, 0]) * board.square / 2
    for azimuth in np.linspace(-spread, spread, count):
        tilt, roll = rng.uniform(-30, 30, 2)
        turn = Rotation.from_euler("yxz", [-azimuth, tilt, roll], degrees=True).as_matrix()
        place = reach * rng.uniform([-1, -0.8, -1], 1)
        made.append(np.column_stack([turn, place - turn @ middle]))
    return made
