from pathlib import Path

import pytest

from splatreel.base.errors import UsageError
from splatreel.cli.main import main
from splatreel.cli.options import parse_frames, parse_held_out, parse_names, parse_numbers, reel_folder, with_set
from splatreel.cli.reconstruct import ConfigOptions
from splatreel.config import Config


def test_frames() -> None:
    assert parse_frames(None) is None
    assert parse_frames("0:60") == (0, 60)
    assert parse_frames(" 30:31 ") == (30, 31)


@pytest.mark.parametrize("text", ["", ":", "5", "5:", ":5", "5:5", "6:5", "-1:5", "1:2:3", "a:b", "1.0:2"])
def test_invalid_frame_ranges_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="not a range of frames"):
        parse_frames(text)


def test_names() -> None:
    assert parse_names(None, "--cameras") is None
    assert parse_names("0, 10,cam03", "--cameras") == ["0", "10", "cam03"]
    with pytest.raises(UsageError, match="--cameras '' holds an empty name"):
        parse_names("", "--cameras")


def test_numbers() -> None:
    assert parse_numbers(None, "--at") is None
    assert parse_numbers("28, 0", "--at") == [28, 0]
    for text, fault in (
        ("0,x", "'x' is not a frame"),
        ("0:3", "'0:3' is not a frame"),
        ("3,3", "names '3' twice"),
        ("-1", "is not a frame"),
    ):
        with pytest.raises(UsageError, match=fault):
            parse_numbers(text, "--at")


def test_reel_is_found_inside_the_output_of_a_run(tmp_path: Path) -> None:
    assert reel_folder(tmp_path) == tmp_path
    (tmp_path / "reel").mkdir()
    (tmp_path / "reel" / "manifest.json").touch()
    assert reel_folder(tmp_path) == tmp_path / "reel"
    assert reel_folder(tmp_path / "reel") == tmp_path / "reel"


def test_no_camera_may_be_held_out() -> None:
    assert parse_held_out(None) is None
    assert parse_held_out("none") == []
    assert parse_held_out("cam00,none") == ["cam00", "none"]


def test_settings() -> None:
    config = with_set(Config(), ("group.lambda_arap=0", "keyframe.sh_degree=1"))
    assert (config.group.lambda_arap, config.keyframe.sh_degree) == (0, 1)
    assert with_set(Config(), ()) == Config()
    with pytest.raises(UsageError, match=r"^--set 'group.tracked' is not a setting. Did you mean group.tracks\?"):
        with_set(Config(), ("group.tracked=true",))
    with pytest.raises(UsageError, match=r"^--set group.overlap 5 does not fit group.length 5"):
        with_set(Config(), ("group.length=5",))


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["evaluate", "reel", "x", "--out", "y", "--max-memory", "0"], "--max-memory 0: give megabytes, 1 or more"),
        (["verify", "reel", "--max-memory", "0"], "--max-memory 0: give megabytes, 1 or more"),
        (
            ["reconstruct", "x", "--out", "y", "--set", "layering.relighting=false", "--set", "layering.enabled=false"],
            "--set layering.relighting has no effect with layering.enabled=false. It needs layering.enabled=true. Change the other "
            "setting too, or leave this one out.",
        ),
        (
            ["reconstruct", "x", "--out", "y", "--renditions", "high,low", "--set", "encode.coarseness=1"],
            "--set encode.coarseness has no effect with encode.renditions=high,low",
        ),
        (
            ["demo", "--out", "y", "--set", "encode.h265.crf=30"],
            "--set encode.h265.crf has no effect with encode.codec=predictive",
        ),
        (
            ["reconstruct", "x", "--out", "y", "--codec", "h265", "--renditions", "high,low"],
            "--renditions are of the predictive codec. Choose --codec predictive",
        ),
    ],
)
def test_contradicting_options_are_refused_before_work_starts(
    command: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert said in captured.err


def test_a_run_that_began_with_a_setting_without_effect_continues() -> None:
    options = ConfigOptions(settings=("layering.relighting=false", "layering.enabled=false"))
    assert not options.config(is_begun=True).layering.relighting
    with pytest.raises(UsageError, match="has no effect"):
        options.config()


@pytest.mark.parametrize(
    "arguments",
    [
        ["reconstruct", "scene", "--out", ""],
        ["reconstruct", "scene", "--out="],
        ["publish", "reel", ""],
        ["info", ""],
        ["export", "reel", "--out", "a.mp4", "--path", ""],
        ["import", "film", "--out", "reel", "--cameras", ""],
    ],
)
def test_empty_path_is_refused(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert "is empty. Write a name, or . for the current folder" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_empty_text_removes_it(capsys: pytest.CaptureFixture[str]) -> None:
    for given in (["--title", ""], ["--title="]):
        assert main(["edit", "nowhere", *given]) == 1
        assert "is empty" not in capsys.readouterr().err


@pytest.mark.parametrize("command", ["view", "serve", "info", "verify"])
def test_capture_in_the_place_of_a_reel_is_named(
    tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cam00.mp4").touch()
    (tmp_path / "poses_bounds.npy").touch()
    assert main([command, str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert f"is a capture, not a reel. Make a reel of it with `splatreel reconstruct {tmp_path} --out OUT`" in error
    assert "encode" not in error


@pytest.mark.parametrize(("name", "written"), [("-f", "./-f"), ("-my $film", "'./-my $film'")])
def test_names_that_start_with_a_dash_are_explained(
    tmp_path: Path, name: str, written: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["info", "REEL", "--out", name]) == 2
    option = f"--out={written}" if written[0] == "." else "'--out=./-my $film'"
    assert f"--out {name}: a name that starts with - is taken for an option. Write {option}." in capsys.readouterr().err
    Path(name).mkdir()
    assert main(["info", name]) == 2
    assert f"{name}: a name that starts with - is taken for an option. Write {written}." in capsys.readouterr().err
