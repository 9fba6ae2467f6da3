"""Score images that others rendered by our metrics, and print their own metrics beside ours.

python benchmarks/authors_renders.py RENDERS TRUTH --metrics FILE compares two folders of images, such as those of the paper's authors
(`turandai/4DGV_eval`). Images belong together by their paths without extension, otherwise by the numbers in their names.
"""

import csv
import io
import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tyro

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import SplatreelError, UsageError
from splatreel.base.untrusted import is_number, read_file, read_json
from splatreel.capture.image_sequences import IMAGE_SUFFIXES
from splatreel.capture.images import read_whole_image
from splatreel.evaluation.metrics import psnr, psnr_per_channel, ssim, ssim_skimage
from splatreel.evaluation.perceptual import load_lpips

TABLE_BYTES = 64 << 20
SHOWN = 20
"""Maximum number of images in the printed table. `--out` gets all."""
Rows = dict[str, dict[str, float]]
"""Values by metric, by the name of the image."""


def main(
    renders: tyro.conf.Positional[Path],
    truth: tyro.conf.Positional[Path],
    /,
    metrics: Path | None = None,
    out: Path | None = None,
    lpips: bool = True,
) -> None:
    """Compare two folders of images.

    Args:
        renders: Folder of rendered images; folders in it are searched too.
        truth: Folder of the images to compare with.
        metrics: The authors' metrics of each image: .json or .csv, see `read_metrics`.
        out: CSV file to write, with a line for each image.
        lpips: Also compute LPIPS, if its weights are on this machine.
    """
    pairs, how = pair_images(images_in(renders), images_in(truth), renders, truth)
    theirs = {} if metrics is None else match_rows(read_metrics(metrics), list(pairs), metrics)
    print(f"{len(pairs)} images, paired by {how}")
    measures = ours(lpips)
    rows: Rows = {}
    for name, (image, reference) in pairs.items():
        rows[name] = {f"our {key}": value for key, value in score(image, reference, measures).items()}
        rows[name] |= {f"their {key}": value for key, value in theirs.get(name, {}).items()}
    columns = list(dict.fromkeys(column for row in rows.values() for column in row))
    mean = {c: float(np.mean([row[c] for row in rows.values() if c in row])) for c in columns}
    print(table({**dict(list(rows.items())[:SHOWN]), f"mean of {len(rows)}": mean}, columns))
    if len(rows) > SHOWN:
        print(f"The first {SHOWN} images are shown.{'' if out else ' Write all with --out FILE.csv.'}")
    if metrics is not None and len(theirs) < len(rows):
        print(f"{metrics}: has no values for {len(rows) - len(theirs)} of {len(rows)} images")
    if out is not None:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["image", *columns])
        writer.writerows([name, *(row.get(column, "") for column in columns)] for name, row in rows.items())
        write_bytes(out, text.getvalue().encode())
        print(f"{out}: {len(rows)} lines")


def images_in(folder: Path) -> dict[str, Path]:
    """Return the images of a folder, and of those below it, by path without extension. Raise `UsageError` without images."""
    files = sorted(file for file in folder.rglob("*") if file.suffix.lower() in IMAGE_SUFFIXES and file.is_file())
    found = {file.relative_to(folder).with_suffix("").as_posix(): file for file in files}
    if not found:
        raise UsageError(f"{folder}: holds no images ({', '.join(IMAGE_SUFFIXES)}). Name the folder of the images.")
    if len(found) < len(files):
        raise UsageError(f"{folder}: has images that differ only by their extensions. Remove one kind.")
    return found


def pair_images(
    images: dict[str, Path], truth: dict[str, Path], renders: Path, reference: Path
) -> tuple[dict[str, tuple[Path, Path]], str]:
    """Return the pairs of files by name of the rendered image, and what they are paired by.

    Raises:
        UsageError: Names and numbers do not say which images belong together.
    """
    for how, key in (("name", lambda name: name), ("number", last_number)):
        one, other = by_key(images, key), by_key(truth, key)
        if one is not None and other is not None and set(one) <= set(other):
            return {name: (images[name], truth[other[found]]) for found, name in one.items()}, how
    raise UsageError(
        f"{renders} and {reference}: neither names nor numbers pair all images; they begin with {', '.join(list(images)[:3])} and "
        f"{', '.join(list(truth)[:3])}. Rename one side, or name a folder with the images of one camera."
    )


def by_key(names: dict[str, Path], key: Callable[[str], str | None]) -> dict[str, str] | None:
    """Return names by key, or None if a key is missing or not unique."""
    found = {key(name): name for name in names}
    return None if None in found or len(found) < len(names) else {k: v for k, v in found.items() if k is not None}


def last_number(name: str) -> str | None:
    """Return the last number of a name, with its folder, or None without a number."""
    folder, _, own = name.rpartition("/")
    numbers = re.findall(r"\d+", own)
    return f"{folder}/{int(numbers[-1])}" if numbers else None


def ours(with_lpips: bool) -> dict[str, Callable[[np.ndarray, np.ndarray], float | None]]:
    """Return our metrics by name."""
    found: dict[str, Callable[[np.ndarray, np.ndarray], float | None]] = {
        "PSNR": psnr,
        "PSNR of channels": psnr_per_channel,
        "SSIM": ssim,
        "SSIM of scikit-image": ssim_skimage,
    }
    if with_lpips:
        found |= {f"LPIPS {network}": measure for network, measure in load_lpips().items()}
    return found


def score(
    image: Path, reference: Path, measures: dict[str, Callable[[np.ndarray, np.ndarray], float | None]]
) -> dict[str, float]:
    """Return our metrics of an image. Raise `UsageError` for images of two sizes."""
    one, other = (read_whole_image(file).astype(np.float32) / 255 for file in (image, reference))
    if one.shape != other.shape:
        raise UsageError(
            f"{image}: is {one.shape[1]}x{one.shape[0]}, but {reference} is {other.shape[1]}x{other.shape[0]}. Metrics need images of "
            f"one size; they are not resized, which would change the result."
        )
    values = {name: measure(one, other) for name, measure in measures.items()}
    return {name: value for name, value in values.items() if value is not None}


def read_metrics(file: Path) -> Rows:
    """Return metrics by image from a file: CSV with a header, whose first column names the image, or JSON.

    JSON may be a list of objects, an object of objects by image, or an object of images or lists by metric, as 3DGS's
    `per_view.json`. Objects with one entry around them are removed.

    Raises:
        UsageError: The file is of another form.
    """
    if file.suffix.lower() in (".csv", ".tsv", ".txt"):
        text = read_file(file, TABLE_BYTES, UsageError).decode("utf-8-sig", "replace")
        lines = list(csv.reader(text.splitlines(), delimiter="\t" if "\t" in text.partition("\n")[0] else ","))
        head, body = [name.strip() for name in lines[0]] if lines else [], lines[1:]
        found = {line[0].strip(): dict(zip(head[1:], map(_number, line[1:]), strict=False)) for line in body if line}
    else:
        value = read_json(file, UsageError)
        while isinstance(value, dict) and len(value) == 1 and _is_wrapped(inner := next(iter(value.values()))):
            value = inner
        found = _rows(value)
    rows = {name: {key: v for key, v in row.items() if v is not None} for name, row in found.items()}
    if not any(rows.values()):
        raise UsageError(
            f"{file}: holds no metrics by image that are known. Write CSV: a line 'image,PSNR,SSIM', then one for each image."
        )
    return rows


def _is_wrapped(value: object) -> bool:
    """Return whether a JSON value holds metrics of several images, and not those of one, or the values of one metric."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return any(isinstance(one, dict | list) for one in inner)


def _rows(value: object) -> dict[str, dict[str, float | None]]:
    """Return metrics by image from a JSON value, or nothing from one of another form."""
    if isinstance(value, list):
        entries = [entry for entry in value if isinstance(entry, dict)]
        return {_name_in(entry, number): _numbers(entry) for number, entry in enumerate(entries)}
    if not isinstance(value, dict):
        return {}
    metric = re.compile("psnr|ssim|lpips", re.IGNORECASE)
    rows: dict[str, dict[str, float | None]] = {}
    for key, inner in value.items():
        if metric.search(key) and isinstance(inner, dict | list):
            pairs = inner.items() if isinstance(inner, dict) else ((str(n), v) for n, v in enumerate(inner))
            for name, number in pairs:
                rows.setdefault(name, {})[key] = _number(number)
        elif isinstance(inner, dict):
            rows[key] = _numbers(inner)
    return rows


def _name_in(entry: dict[str, object], number: int) -> str:
    """Return the name or number of the image that an entry of a list states, or its place."""
    known = (entry.get(key) for key in ("image", "name", "file", "frame", "frame_id", "idx", "index"))
    return str(next((value for value in known if isinstance(value, str | int)), number))


def _numbers(entry: dict[str, object]) -> dict[str, float | None]:
    names = ("frame", "frame_id", "idx", "index")
    return {key: _number(value) for key, value in entry.items() if key not in names}


def _number(value: object) -> float | None:
    try:
        number = float(value) if isinstance(value, str) else value
    except ValueError:
        return None
    return float(number) if is_number(number) else None


def match_rows(rows: Rows, names: list[str], file: Path) -> Rows:
    """Return the rows by names of our images: by the same name, otherwise by the same number.

    Raises:
        UsageError: No row belongs to an image.
    """
    stems = {str(Path(key).with_suffix("")) if "." in key else key: row for key, row in rows.items()}
    found = {name: stems[key] for name in names for key in (name, name.rpartition("/")[2]) if key in stems}
    if not found:
        keys = {key: number for key in stems if (number := last_number(key)) is not None}
        numbered = {number: stems[key] for key, number in keys.items()}
        mine = {name: last_number(name.rpartition("/")[2]) for name in names}
        if len(numbered) == len(keys) and len(set(mine.values())) == len(mine):
            found = {name: numbered[number] for name, number in mine.items() if number in numbered}
    if not found:
        raise UsageError(
            f"{file}: names {', '.join(list(rows)[:3])}, ..., but the images are {', '.join(names[:3])}, .... Rename them."
        )
    return found


def table(rows: Rows, columns: list[str]) -> str:
    """Return a table in Markdown."""
    lines = [f"| image | {' | '.join(columns)} |", f"|---|{'---|' * len(columns)}"]
    for name, row in rows.items():
        lines.append(f"| {name} | {' | '.join(f'{row[c]:.4f}' if c in row else '' for c in columns)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except SplatreelError as error:
        sys.exit(str(error))
