"""Files of users are opened through `base/untrusted.py`, which never waits for a pipe and limits size and nesting."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent.parent / "src" / "splatreel"
READERS = {
    *("open", "os.open", "io.open", "av.open", "Image.open", "wave.open", "gzip.open"),
    *("json.load", "json.loads", "pickle.load", "pickle.loads", "tomllib.load", "tomllib.loads"),
    *("np.load", "np.loadtxt", "np.genfromtxt", "np.fromfile", "np.memmap", "torch.load", "load_file", "safe_open"),
    *("ElementTree.parse", "ElementTree.fromstring", "zipfile.ZipFile", "tarfile.open", "pycolmap.Reconstruction"),
    *("cv2.imread", "cv2.FileStorage", "cv2.VideoCapture"),
}
"""Functions that open or parse a file. `PATH.open`, `PATH.read_text` and `PATH.read_bytes` are found too."""
GUARDS = {"check_regular", "read_file", "open_regular"}
"""Functions of `base/untrusted.py`. A function that calls one may then name the file to a library."""
ALLOWED = {
    # Files of the package and of the system, and weights whose checksum or loader protects
    "base/paged_arrays.py": {"read_text"},
    "base/process.py": {"os.open", "open", "read_text"},
    "calibration/learned_matches.py": {"torch.load"},
    "capture/conversion.py": {"cv2.FileStorage"},
    "cli/main.py": {"os.open"},
    "evaluation/perceptual.py": {"torch.load"},
    "evaluation/page/html.py": {"read_text"},
    "gpu/device.py": {"read_text"},
    "method/images/flow.py": {"torch.load"},
    "play/player_page.py": {"read_text", "read_bytes"},
    "play/web_app.py": {"read_text"},
    "run/machine_speed.py": {"read_text", "json.loads"},
    "run/requirements.py": {"read_text"},
    # Objects and texts that were read or opened safely before
    "capture/growing_video.py": {"av.open"},
    "capture/readers/calibrations/motion_capture.py": {"tomllib.loads"},
    "capture/video.py": {"av.open"},
    "play/served_files.py": {"open"},
    # Files that the same program wrote, in the output folder or the user's cache: locks, checkpoints, logs, pictures, kernels
    "base/atomic.py": {"os.open"},
    "base/user_cache.py": {"read_bytes"},
    "calibration/moment_solver.py": {"Image.open"},
    "codec/opus_sound.py": {"read_bytes"},
    "evaluation/page/report_page.py": {"Image.open"},
    "run/store.py": {"load_file", "json.loads"},
    "run/run_logs.py": {"read_text", "json.loads"},
    "run/live/live_soundtrack.py": {"read_bytes"},
    "run/output/sound_output.py": {"read_bytes"},
    "run/run_folder.py": {"os.open"},
    # Messages between processes of one run
    "base/child_process.py": {"pickle.load"},
    "play/blender_scene.py": {"np.load", "json.loads"},
    "run/machines/ray_cluster.py": {"pickle.loads"},
    "run/machines/worker.py": {"pickle.loads"},
}
"""Calls that read no file of a user, by module."""


def dotted(node: ast.expr) -> str:
    """Return `a.b` for the expression of a function, or `.b` for a method of something else."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        return f"{node.value.id if isinstance(node.value, ast.Name) else ''}.{node.attr}"
    return ""


def mode_of(call: ast.Call, place: int) -> str | None:
    """Return the mode of a call of `open`, or None if it is not a constant."""
    values = [call.args[place]] if len(call.args) > place else [k.value for k in call.keywords if k.arg == "mode"]
    constant = values[0] if values else ast.Constant("r")
    return constant.value if isinstance(constant, ast.Constant) and isinstance(constant.value, str) else None


def reading_call(call: ast.Call) -> str | None:
    """Return the name of a call that reads a file by its path, or None for another call."""
    name = dotted(call.func)
    if name.endswith((".read_text", ".read_bytes")):
        return name.rpartition(".")[2]
    if name in READERS:
        inner = dotted(call.args[0].func) if call.args and isinstance(call.args[0], ast.Call) else ""
        writes = any(dotted(argument).endswith("_WRITE") for argument in call.args)
        if writes or inner.endswith((".source", "BytesIO", ".to_json", "Tail")):
            return None
        mode = mode_of(call, 1) if name != "os.open" else "r"
        return None if mode is not None and set(mode) & set("wax") else name
    if isinstance(call.func, ast.Attribute) and call.func.attr == "open":  # of a path, where a mode or encoding says so
        mode = mode_of(call, 0)
        is_path = (call.args and mode is not None and set(mode) <= set("rbt+")) or any(
            keyword.arg in ("mode", "encoding", "buffering") for keyword in call.keywords
        )
        return "open" if is_path and not set(mode or "r") & set("wax") else None
    return None


def unguarded_reads(tree: ast.AST) -> list[tuple[int, str]]:
    """Return the line and name of calls that read a file without a guard in the same function."""
    found = []

    def visit(node: ast.AST, guarded: bool) -> None:
        if isinstance(node, ast.FunctionDef):
            calls = {dotted(one.func) for one in ast.walk(node) if isinstance(one, ast.Call)}
            guarded = bool(calls & GUARDS)
        if isinstance(node, ast.Call) and not guarded and (name := reading_call(node)):
            found.append((node.lineno, name))
        for child in ast.iter_child_nodes(node):
            visit(child, guarded)

    visit(tree, False)
    return found


def test_files_of_users_are_opened_by_the_safe_readers() -> None:
    faults = []
    for path in sorted(SOURCE.rglob("*.py")):
        module = path.relative_to(SOURCE).as_posix()
        for line, name in unguarded_reads(ast.parse(path.read_text(encoding="utf-8"))):
            if module != "base/untrusted.py" and name not in ALLOWED.get(module, ()):
                faults.append(
                    f"{module}:{line}: {name} opens a file. Use open_regular, read_file or read_json of base/untrusted.py."
                )
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("open(path)", "open"),
        ("open(path, 'rb')", "open"),
        ("path.open('rb', buffering=0)", "open"),
        ("path.open(encoding='utf-8')", "open"),
        ("path.read_text(encoding='utf-8')", "read_text"),
        ("(folder / name).read_bytes()", "read_bytes"),
        ("json.loads(text)", "json.loads"),
        ("np.load(file)", "np.load"),
        ("open(path, 'wb')", None),
        ("path.open('a', encoding='utf-8')", None),
        ("Image.open(files.source(path))", None),
        ("Image.open(io.BytesIO(data))", None),
        ("archive.open(info)", None),
        ("context.open()", None),
        ("def f():\n    check_regular(path, kind)\n    zipfile.ZipFile(path)", None),
    ],
)
def test_reads_are_recognized(text: str, name: str | None) -> None:
    assert [found for _, found in unguarded_reads(ast.parse(text))] == ([] if name is None else [name])
