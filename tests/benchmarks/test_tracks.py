import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from toyroom.solids import POSITION

FOLDER = Path(__file__).parent.parent.parent / "benchmarks"


@pytest.fixture
def tracks(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(FOLDER))
    before = set(sys.modules)
    yield importlib.import_module("tracks")
    for name in set(sys.modules) - before:
        if (FOLDER / f"{name}.py").exists():
            del sys.modules[name]


def test_points_that_go_with_their_solid_stay_on_it_and_those_that_rest_do_not(tracks: ModuleType) -> None:
    film = tracks.FILMS["dominoes"].film()
    scenes = [film.moving(frame / 30) for frame in range(20)]
    places = np.stack([scene.solids[:, POSITION : POSITION + 3] for scene in scenes])
    farthest = int(np.ptp(places, axis=0).max(1).argmax())
    start = places[0, farthest] + np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]])
    carried = np.stack([tracks._carried(scenes[0], scene, farthest, start) for scene in scenes])
    assert tracks._on(film, carried, 0.01).all()
    rested = tracks._on(film, np.repeat(start[None], len(scenes), axis=0), 0.01)
    assert rested[0].all()
    assert not rested[-1].any()


def test_points_are_one_in_each_cell_of_a_grid(tracks: ModuleType) -> None:
    places = np.random.default_rng(0).uniform(-1, 1, (5000, 3))
    points = tracks._points(places, 0.5)
    cells = np.floor(points.means / 0.5)
    assert len(np.unique(cells, axis=0)) == len(points) == 64
