"""Write a folder with a page, the player and a reel. Any static web host can serve it.

python examples/publish_site.py out/demo/reel --out site --title "A toy room"
python -m http.server --directory site
"""

import shutil
from html import escape
from pathlib import Path

import tyro
from tyro.conf import Positional

import splatreel

PAGE = """<!doctype html>
<html lang="en">
  <head>
    <meta charset="utf-8" />
    <meta name="viewport" content="width=device-width, initial-scale=1" />
    <title>{title}</title>
    <link rel="icon" href="data:," />
    <script type="module" src="player/player.js"></script>
  </head>
  <body>
    <h1>{title}</h1>
    <splat-reel src="reel/manifest.json" controls aria-label="{title}"></splat-reel>
  </body>
</html>
"""


def main(reel: Positional[Path], out: Path = Path("site"), title: str = "A volumetric video") -> None:
    """Write a site.

    Args:
        reel: Folder of the reel. Every file of it is checked first.
        out: Folder to write; it must not exist.
        title: Title of the page.
    """
    splatreel.verify_reel(reel)
    splatreel.copy_player(out / "player")
    shutil.copytree(reel, out / "reel")
    (out / "index.html").write_text(PAGE.format(title=escape(title)), encoding="utf-8")
    print(f"{out}: {sum(path.stat().st_size for path in out.rglob('*')) / 1e6:.1f} MB")


if __name__ == "__main__":
    tyro.cli(main)
