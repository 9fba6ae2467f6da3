import base64
import hashlib
import os
import re
import urllib.request
from pathlib import Path

from splatreel.cli.serve import run_report
from splatreel.evaluation.page.served_report import ServedReport
from splatreel.play.server import Server
from tests.evaluation import scenes


def test_page_is_made_again_only_when_the_run_has_changed(tmp_path: Path) -> None:
    out = scenes.write_run(tmp_path / "run")
    served = ServedReport(out, out / "reel")
    first = served.read()
    assert served.read() is first
    manifest = out / "reel" / "manifest.json"
    os.utime(manifest, ns=(1, 1))
    again = served.read()
    assert again is not first
    assert again == first


def test_server_sends_the_page_with_a_policy_that_lets_its_script_run(tmp_path: Path) -> None:
    out = scenes.write_run(tmp_path / "run")
    pages = run_report(out / "reel")
    with Server(out / "reel", pages=pages) as server, urllib.request.urlopen(f"{server.url}report.html") as answer:
        text, policy = answer.read().decode(), answer.headers["Content-Security-Policy"]
        assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
    scripts = re.findall("<script>(.*?)</script>", text, re.S)
    assert len(scripts) == 1
    assert base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode() in policy
    assert "default-src 'none'" in policy


def test_a_reel_without_its_run_has_no_page(tmp_path: Path) -> None:
    assert run_report(scenes.write_reel(tmp_path / "reel")) == {}
    assert run_report("https://example.org/reel") == {}
