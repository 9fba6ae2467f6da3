"""The web player as files for a site."""

from pathlib import Path

from splatreel.play.player_page import STATIC, copy_player


def test_the_player_is_copied_over_an_older_one(tmp_path: Path) -> None:
    folder = tmp_path / "site" / "player"
    copy_player(folder)
    (folder / "player.js").write_text("old", encoding="utf-8")
    copy_player(str(folder))
    assert {path.name for path in folder.iterdir()} == {path.name for path in STATIC.iterdir()}
    assert (folder / "player.js").read_bytes() == (STATIC / "player.js").read_bytes()
