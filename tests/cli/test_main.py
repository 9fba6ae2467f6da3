"""The command line as a user sees it: exit codes, and the exact text of errors."""

import contextlib
import errno
import io
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from splatreel.base import errors
from splatreel.base.command_line import EXTRAS
from splatreel.base.errors import CaptureError
from splatreel.base.process import quiet_threads
from splatreel.cli import main as cli
from splatreel.cli.failure import LIGHTER, Terminated, explain
from splatreel.cli.main import main
from tests.capture import folders

VERBS = [
    "demo",
    "capture",
    "reconstruct",
    "config",
    "encode",
    "edit",
    "info",
    "verify",
    "serve",
    "view",
    "export",
    "evaluate",
    "devices",
    "warmup",
]


def run(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "splatreel", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=600)


def processor_seconds() -> float:
    """Return the processor time of all finished child processes."""
    times = os.times()
    return times.children_user + times.children_system


def error_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = main(list(arguments))
    captured = capsys.readouterr()
    assert captured.out == ""
    return code, captured.err


def test_help_is_quick_and_names_every_verb() -> None:
    before = processor_seconds()
    result = run("--help")
    assert result.returncode == 0
    for verb in VERBS:
        assert f"• {verb} " in result.stdout, verb
    assert processor_seconds() - before < 5  # 0.4 s on a fast machine


def help_of(capsys: pytest.CaptureFixture[str], *verb: str) -> str:
    with pytest.raises(SystemExit):
        main([*verb, "--help"])
    return capsys.readouterr().out


def test_list_of_verbs_has_one_paragraph_a_verb(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    for group in ((), ("capture",)):
        listed = help_of(capsys, *group).partition("(required)")[2]
        lines = [line.strip(" │") for line in listed.splitlines() if line.strip(" │╰╯─")]
        assert [line for line in lines if not line.startswith("•")] == []
    assert "Remove floaters" in help_of(capsys, "edit")


@pytest.mark.parametrize(
    ("verb", "text"),
    [
        ("reconstruct", "a sound or video file that starts with the capture; or none."),
        ("reconstruct", "use quicker settings until the delay is gone; skip: leave out"),  # of a group of options
        ("capture calibrate", "If the videos do not start together, run `capture sync` first."),
        ("edit", "Points: crop=VOLUME, remove=VOLUME, min-cameras=N, min-opacity=X"),
    ],
)
def test_help_has_no_line_breaks_of_the_source(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, verb: str, text: str
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    assert text in help_of(capsys, *verb.split())


def test_license_has_one_spelling_in_help_and_two_on_the_command_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    text = help_of(capsys, "edit")
    assert "--license" in text
    assert "--licence" not in text
    for option in (["--licence", "CC0"], ["--licence=CC0"], ["--license", "CC0"]):
        assert main(["edit", str(tmp_path / "none"), *option]) == 1
        assert "manifest.json" in capsys.readouterr().err


def test_help_names_arguments_and_no_value_none(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert "[ENCODE OPTIONS] OUT\n" in help_of(capsys, "encode")
    assert "REEL CAPTURE" in help_of(capsys, "evaluate")
    assert "{None" not in help_of(capsys, "reconstruct")


def test_command_line_loads_nothing_heavy() -> None:
    code = "import sys, splatreel.cli.main as m; m.build(); print(sorted({'numpy', 'numba', 'torch', 'av'} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_threads_sleep_unless_told_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GOMP_SPINCOUNT", raising=False)
    monkeypatch.setenv("KMP_BLOCKTIME", "7")
    quiet_threads()
    assert (os.environ["GOMP_SPINCOUNT"], os.environ["KMP_BLOCKTIME"]) == ("0", "7")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert re.fullmatch(r"splatreel \d+\.\d+\.\d+\n", capsys.readouterr().out)


@pytest.mark.parametrize(
    "arguments", [[], ["frobnicate"], ["reconstruct"], ["info", "a", "b"], ["warmup", "--threads", "many"]]
)
def test_wrong_use_exits_with_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 2
    assert capsys.readouterr().err.strip()


REFUSALS = [
    (
        ["reconstruct", "CAPTURE", "--out", "OUT", "--frames", "60"],
        "Error: --frames '60' is not a range of frames. Write A:B with A < B, such as 0:60 for the first 60.\n",
    ),
    (
        ["reconstruct", "CAPTURE", "--out", "OUT", "--frames", "9:3"],
        "Error: --frames '9:3' is not a range of frames. Write A:B with A < B, such as 0:60 for the first 60.\n",
    ),
    (
        ["reconstruct", "CAPTURE", "--out", "OUT", "--hold-out", "a,,b"],
        "Error: --hold-out 'a,,b' holds an empty name. Write names with commas between them, such as cam00,cam10.\n",
    ),
    (["reconstruct", "CAPTURE", "--out", "OUT", "--hold-out", "a,b,a"], "Error: --hold-out 'a,b,a' names 'a' twice.\n"),
]


@pytest.mark.parametrize(("arguments", "expected"), REFUSALS)
def test_impossible_values_are_refused(arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert error_of(capsys, *arguments) == (2, expected)


def test_missing_files_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, text = error_of(capsys, "capture", "check", "nowhere")
    assert code == 1
    assert text.startswith("Error: nowhere: is not a folder")
    for verb in (["info"], ["verify"], ["export", "--frame", "0", "--out", "x.ply"]):
        code, text = error_of(capsys, verb[0], "nowhere", *verb[1:])
        assert code == 1
        assert text == (
            "Error: nowhere/manifest.json: does not exist. Is the name right, and is the folder complete?\n"
        )


def test_failing_command_shows_one_block_and_no_traceback(tmp_path: Path) -> None:
    result = run("info", "nowhere", cwd=tmp_path)
    assert result.returncode == 1
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    assert result.stderr.startswith("Error: nowhere/manifest.json")


def explained(error: BaseException) -> tuple[str, int]:
    found = explain(error, ["reconstruct", "my capture", "--out", "o"])
    assert found is not None
    return found


def test_every_error_of_the_family_has_its_exit_code() -> None:
    assert explained(errors.UsageError("a")) == ("Error: a", 2)
    assert explained(errors.CaptureError("b")) == ("Error: b", 1)


def test_interruption_message_names_the_command_to_continue() -> None:
    assert explained(KeyboardInterrupt()) == (
        "Interrupted. Finished parts are kept; continue with the same command:\n"
        '  splatreel reconstruct "my capture" --out o',
        130,
    )


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOSPC, "No space left on device", "o/work/a"),
        RuntimeError("Error while serializing: IoError(Os { code: 28, message: No space left on device })"),
    ],
)
def test_full_disk(error: Exception) -> None:
    text, code = explained(error)
    assert code == 1
    assert text.startswith("Error: the disk is full")
    assert "o/work/a" in text or isinstance(error, RuntimeError)
    assert text.endswith('then run\n  splatreel reconstruct "my capture" --out o')


def test_file_size_limit_is_not_reported_as_full_disk() -> None:
    text, code = explained(OSError(errno.EFBIG, "File too large", "o/film.mp4"))
    assert (code, text.splitlines()[0]) == (
        1,
        "Error: a file would be larger than the system allows while writing o/film.mp4. Finished parts are kept; raise the limit "
        "(ulimit -f), then run",
    )


def caused(error: Exception, cause: Exception) -> Exception:
    error.__context__ = cause
    return error


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("[enforce fail] DefaultCPUAllocator: can't allocate memory: you tried 8 bytes"),
        ImportError("libtorch_cpu.so: failed to map segment from shared object"),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        caused(
            OSError("Could not find/load shared object file"),
            OSError("it.so: failed to map segment from shared object"),
        ),
    ],
)
def test_out_of_memory_is_reported_with_advice(error: Exception) -> None:
    assert explained(error) == (
        "Error: out of memory. Ask for smaller images (--width), fewer frames (--frames) or --quality draft.",
        1,
    )


@pytest.mark.parametrize("verb", [*LIGHTER, "info", "verify"])
def test_advice_names_only_options_of_the_verb(verb: str) -> None:
    text, _ = explain(RuntimeError("CUDA out of memory."), verb.split()) or ("", 0)
    named = set(re.findall("--[a-z]+", text))
    assert named == set(LIGHTER.get(verb, ()))
    if named:
        with pytest.raises(SystemExit), contextlib.redirect_stdout(io.StringIO()) as help:
            main([*verb.split(), "--help"])
        assert named <= set(re.findall("--[a-z]+", help.getvalue()))


def test_damaged_cache_of_compiled_code_is_named(tmp_path: Path) -> None:
    """Numba reads what it finds; a text file in place of its index is enough."""
    code = "import numba\n@numba.njit(cache=True)\ndef one():\n    return 1\none()\n"
    script = code.replace(
        "\none()\n",
        """
import sys
from splatreel.cli.failure import explain
try:
    print(one())
except Exception as error:
    print(explain(error, ["demo", "--out", "a b"]))
""",
    )
    (tmp_path / "it.py").write_text(script)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, str(tmp_path / "it.py")]
    assert subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout == "1\n"
    for file in (tmp_path / "cache").rglob("*.nb?"):
        file.write_bytes(file.read_bytes()[:40] + b"damaged")
    text = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    assert f"the compiled code in {tmp_path}" in text
    assert "Delete this folder" in text
    assert 'splatreel demo --out "a b"' in text


def test_no_gpu_memory() -> None:
    text, code = explained(RuntimeError("CUDA out of memory. Tried to allocate 2.00 GiB."))
    assert (text.startswith("Error: out of GPU memory."), "or --device cpu." in text, code) == (True, True, 1)


def test_package_that_is_not_installed() -> None:
    needed = "Error: the Python package {!r} is needed and not installed. Run\n  {}"
    for name, command in {"cv2": 'pip install "splatreel[recon]"', "torch": "pip install torch"}.items():
        assert explained(ModuleNotFoundError(f"No module named {name!r}", name=name)) == (
            needed.format(name, command),
            1,
        )
    assert explain(ModuleNotFoundError("No module named 'splatreel.oops'", name="splatreel.oops"), []) is None


def test_extras_that_are_named_can_be_installed() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(EXTRAS.values()) <= set(project["optional-dependencies"])


def test_other_trouble_with_files() -> None:
    assert explained(PermissionError(errno.EACCES, "Permission denied", "/o")) == ("Error: /o: Permission denied.", 1)


def test_unexpected_error_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    assert explain(ValueError("broken"), []) is None

    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(cli, "build", broken)
    with pytest.raises(ZeroDivisionError):
        main(["info"])


CHAINED = CaptureError("scene/a.mp4: cannot be decoded. The file is truncated or damaged.")
CHAINED.__cause__ = OSError(errno.EMFILE, "Too many open files", "scene/a.mp4")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (
            CHAINED,
            "scene/a.mp4: cannot be opened, as this process cannot open more files. Raise the limit (ulimit -n",
        ),
        (OSError(errno.ENFILE, "Too many open files in system"), "this process cannot open more files"),
        (
            RuntimeError("can't start new thread"),
            "the system starts no more threads. Raise the limit of processes (ulimit -u",
        ),
    ],
)
def test_system_limits_are_reported_through_other_errors(error: Exception, said: str) -> None:
    found = explain(error, ["info", "reel"])
    assert found is not None
    assert said in found[0]
    assert found[0].endswith("then run\n  splatreel info reel")
    assert "truncated" not in found[0]
    assert "memory." not in found[0]


def test_interrupted_native_code_counts_as_interruption() -> None:
    error, middle = SystemError("returned a result with an exception set"), SystemError("returned a result")
    error.__cause__, middle.__cause__ = middle, Terminated()
    found = explain(error, ["info", "reel"])
    assert found is not None
    assert found[1] == 143
    failed = RuntimeError("Cannot import the C++ backend")
    failed.__context__ = KeyboardInterrupt()
    found = explain(failed, ["info", "reel"])
    assert found is not None
    assert found[1] == 130
    assert explain(SystemError("a bug"), ["info", "reel"]) is None


@pytest.mark.skipif(os.name != "posix", reason="limits of processes")
def test_open_file_limit_is_not_reported_as_damage(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """With few files left to open, a capture of whole videos is not called damaged."""
    import resource

    scene = folders.neu3dv(tmp_path / "scene", count=4, frames=2)
    main(["capture", "check", str(scene), "--quick"])  # what is imported then needs no file later
    capfd.readouterr()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    lowest = os.open(os.devnull, os.O_RDONLY)
    os.close(lowest)
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest + 4, hard))  # two for signals, and two of four videos
    try:
        assert main(["capture", "check", str(scene), "--quick"]) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    error = capfd.readouterr().err
    assert "this process cannot open more files. Raise the limit (ulimit -n" in error
    assert "damaged" not in error


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of Linux")
def test_a_low_limit_of_virtual_memory_is_named(tmp_path: Path) -> None:
    """OpenBLAS tried forever to get its memory, and the number of processes was blamed."""
    code = (
        "import resource, sys; from splatreel.cli.main import main; "
        "resource.setrlimit(resource.RLIMIT_AS, (700_000_000,) * 2); sys.exit(main(['info', 'reel']))"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=100
    )
    assert ended.returncode == 1
    assert "the limit of virtual memory of 700 MB is too low. Raise it (ulimit -v unlimited" in ended.stderr


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("can't start new thread")])
def test_errors_below_a_limit_of_virtual_memory_name_it(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    monkeypatch.setattr("splatreel.cli.failure.address_space_limit", lambda: 2_000_000_000)
    known = explain(error, ["import", "film"])
    assert known is not None
    assert known[0].startswith("Error: the limit of virtual memory of 2,000 MB is too low. Raise it (ulimit -v")
