"""Numbers of other methods as the paper prints them, in its Tables 1 to 3. None of them was measured here."""

from __future__ import annotations

from collections.abc import Collection

Numbers = tuple[str, ...]

SCENES = {
    "Neu3DV": {
        "coffee_martini",
        "cook_spinach",
        "cut_roasted_beef",
        "flame_salmon",
        "flame_salmon_1",
        "flame_steak",
        "sear_steak",
    },
    "MeetRoom": {"discussion", "stepin", "trimming", "vrheadset"},
    "Technicolor": {"birthday", "fabien", "painter", "theater", "train"},
    "DeskGames": {"cube", "domino", "reading", "uno"},
    "MobileStage": {"dance3"},
    "ENeRF-Outdoor": {"actor1_4", "actor2_3", "actor5_6"},
}
"""Names of the captures of each dataset, in lower case."""
TABLE_1: dict[str, dict[str, Numbers]] = {
    "MeetRoom": {
        "Grid4D": ("30.65", "0.948", "0.163", "297"),
        "STG": ("29.51", "0.932", "0.209", "71.4"),
        "3DGStream": ("30.88", "0.947", "0.186", "2287"),
        "Ex4DGS": ("31.03", "0.946", "0.186", "75.0"),
        "4DGS": ("31.94", "0.953", "0.177", "2196"),
        "V3": ("26.12", "0.864", "0.317", "81.8"),
        "4DGV": ("32.31", "0.957", "0.173", "19.2"),
    },
    "Technicolor": {
        "Grid4D": ("30.37", "0.888", "0.210", "378"),
        "STG": ("32.35", "0.905", "0.186", "436"),
        "3DGStream": ("25.48", "0.708", "0.446", "2615"),
        "Ex4DGS": ("31.33", "0.888", "0.229", "365"),
        "4DGS": ("28.92", "0.798", "0.347", "3070"),
        "V3": ("25.08", "0.746", "0.340", "199"),
        "4DGV": ("31.77", "0.893", "0.197", "40.2"),
    },
    "DeskGames": {
        "Grid4D": ("26.29", "0.863", "0.228", "334"),
        "STG": ("28.35", "0.902", "0.190", "396"),
        "3DGStream": ("30.51", "0.917", "0.173", "2243"),
        "Ex4DGS": ("29.48", "0.906", "0.180", "386"),
        "4DGS": ("30.11", "0.905", "0.199", "2616"),
        "V3": ("26.05", "0.830", "0.267", "225"),
        "4DGV": ("30.89", "0.920", "0.168", "34.5"),
    },
}
"""PSNR, SSIM, LPIPS and size in MB by dataset and method."""
TABLE_2: dict[str, dict[str, Numbers]] = {
    "Neu3DV": {
        "DyNeRF, flame_salmon only": ("29.58", "28", "80640", "0.015"),
        "StreamRF": ("28.26", "9420", "75", "8"),
        "NeRFPlayer": ("30.69", "5134", "3600", "0.05"),
        "HyperReel": ("31.10", "360", "N/A", "2.0"),
        "K-Planes": ("31.63", "311", "108", "N/A"),
        "MixVoxels-X": ("31.73", "500", "300", "4.6"),
        "MSTH": ("32.37", "135", "20", "15"),
        "4DGaussians": ("31.15", "90", "40", "30"),
        "Grid4D": ("31.49", "N/A", "N/A", "N/A"),
        "STG": ("32.05", "200", "100", "140"),
        "Ex4DGS": ("32.11", "115", "36", "121"),
        "4DGS": ("32.01", "N/A", "N/A", "114"),
        "4DRotorGS": ("31.62", "N/A", "60", "277"),
        "3DGStream": ("31.67", "2430", "60", "215"),
        "4DGV": ("32.55", "21", "73", "185"),
    }
}
"""PSNR, size in MB, time in minutes and FPS by dataset and method."""
TABLE_3: dict[str, dict[str, Numbers]] = {
    "Neu3DV": {
        "ENeRF": ("23.48", "830"),
        "3DGS per frame": ("28.61", "37500"),
        "4DGS": ("28.89", "2680"),
        "TGH": ("29.44", "90"),
        "4DGV": ("29.26", "58"),
    },
    "MobileStage": {
        "ENeRF": ("19.14", "1400"),
        "3DGS per frame": ("28.02", "106000"),
        "4DGS": ("23.22", "1830"),
        "TGH": ("27.29", "420"),
        "4DGV": ("28.21", "193"),
    },
    "ENeRF-Outdoor": {
        "ENeRF": ("25.02", "780"),
        "3DGS per frame": ("24.02", "115000"),
        "4DGS": ("24.64", "2450"),
        "TGH": ("24.74", "310"),
        "4DGV": ("25.81", "255"),
    },
}
"""PSNR and size in MB of long videos by dataset and method."""
TABLE_5: dict[str, Numbers] = {
    "Cube+": ("30.610", "0.9185", "0.1685", "299", "7.43M"),
    "Dominoes+": ("31.702", "0.9294", "0.1585", "410", "7.90M"),
    "UNO+": ("30.550", "0.9215", "0.1598", "675", "13.8M"),
}
"""PSNR, SSIM, LPIPS, size in MB and points of 4DGV on the full videos of DeskGames, by scene."""


def dataset_of(captures: Collection[str]) -> str | None:
    """Return the dataset that all captures belong to by their names; None if there is none."""
    names = {name.lower() for name in captures}
    return next((dataset for dataset, scenes in SCENES.items() if names <= scenes), None)


def published_rows(table: dict[str, dict[str, Numbers]], captures: Collection[str]) -> list[list[str]]:
    """Return the rows of a table of other methods: of the captures' dataset if the table has it, else of all datasets.

    Each row ends with its source, such as `published, Neu3DV`.
    """
    own = dataset_of(captures)
    datasets = [own] if own in table else list(table)
    return [
        [method, *numbers, f"published, {dataset}"]
        for dataset in datasets
        for method, numbers in table[dataset].items()
    ]


def has_own(table: dict[str, dict[str, Numbers]], captures: Collection[str]) -> bool:
    """Return whether a table of other methods has the dataset of the captures."""
    return dataset_of(captures) in table


def comparable(table: dict[str, dict[str, Numbers]], captures: Collection[str]) -> str:
    """Return a sentence about rows that are published: whether they are of the same captures as the measured rows."""
    if has_own(table, captures):
        return " Published rows are the paper's, of the whole dataset at its full size and length."
    return " Published rows are the paper's, of other captures: they cannot be compared with measured rows."
