"""A reel in a bucket, given away by the player's server."""

import time
import urllib.error
import urllib.request

import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.publish import Publication
from splatreel.play import served_files
from splatreel.play.served_files import RemoteFiles
from splatreel.play.server import serve
from splatreel.storage.address import Address
from tests.codec.reels import add_chapter_group, new_writer, write_chapters, write_reel


def get(url: str, **headers: str) -> tuple[int, bytes, str]:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=60) as answer:
            return answer.status, answer.read(), answer.headers.get("ETag", "")
    except urllib.error.HTTPError as error:
        return error.code, error.read(), ""


def read(files: RemoteFiles, name: str) -> bytes:
    found = files.open(name)
    assert found is not None
    data = found.file.read()
    assert found.size == len(data)
    return data


def test_server_fetches_remote_files_on_request(bucket, tmp_path):
    reel = write_reel(tmp_path / "reel")
    Publication(reel, Address(bucket.url("reel"))).update()
    bucket.client.put_object(Bucket=bucket.name, Key="reel/secret.txt", Body=b"secret")
    names = Address(bucket.url("reel")).sizes()
    with serve(bucket.url("reel"), port=0) as server:
        for name, size in names.items():
            status, data, tag = get(f"{server.url}reel/{name}")
            if name == "secret.txt":
                assert status == 404
                continue
            assert (status, len(data)) == (200, size)
            assert data == Address(bucket.url("reel")).read(name, size)
            assert get(f"{server.url}reel/{name}", **{"If-None-Match": tag})[0] == 304
            assert get(f"{server.url}reel/{name}", Range="bytes=2-5") == (206, data[2:6], tag)
        group = next(name for name in names if name.startswith("groups/0000"))
        bucket.client.put_object(Bucket=bucket.name, Key=f"reel/{group}", Body=b"x" * names[group])
        assert get(f"{server.url}reel/{group}")[0] == 200  # it is kept
        server._http.config.app._app._files._files.clear()  # pyright: ignore
        assert get(f"{server.url}reel/{group}")[:2] == (
            502,
            b"The remote host of the reel does not deliver this file.\n",
        )
        assert get(server.url)[0] == 200


def test_remote_address_without_reel_is_refused(bucket):
    with pytest.raises(ReelError, match=r"manifest\.json: does not exist"):
        serve(bucket.url("nothing"), port=0)


def test_remote_reel_grows_and_fetches_pages_once(tmp_path, monkeypatch):
    pytest.importorskip("fsspec", reason="needs the extra cloud")
    monkeypatch.setattr(served_files, "FRESH", 0.0)
    writer, folder = new_writer(tmp_path / "reel", page=2), Address("memory://growing/reel")
    publication = Publication(tmp_path / "reel", folder)
    add_chapter_group(writer, 0, 4)
    publication.update()
    files, fetched = RemoteFiles("memory://growing/reel"), []
    source = files._address.fetch
    files._address.fetch = lambda file, most, least=0: (fetched.append(file), source(file, most, least))[1]
    for index in range(1, 9):
        add_chapter_group(writer, index, 4)
        publication.update()
        assert read(files, "manifest.json") == folder.read("manifest.json", 1 << 20)
        for name in folder.sizes():
            if name.startswith(f"groups/{index:04d}"):
                assert len(read(files, name)) == folder.sizes()[name]
    pages = [uri for uri in fetched if uri.startswith("pages/")]
    assert len(pages) == len(set(pages)) > 1
    assert all(read(files, page) for page in pages)


def test_known_files_are_served_while_remote_is_down(tmp_path, monkeypatch):
    fsspec = pytest.importorskip("fsspec", reason="needs the extra cloud")
    monkeypatch.setattr(served_files, "FRESH", 0.0)
    Publication(write_chapters(tmp_path / "reel"), Address("memory://away/reel")).update()
    files = RemoteFiles("memory://away/reel")
    manifest = read(files, "manifest.json")
    group = next(uri for uri in files._manifest.uris if uri.startswith("groups/"))
    read(files, group)
    fsspec.filesystem("memory").rm("/away", recursive=True)
    assert read(files, "manifest.json") == manifest
    assert read(files, group)
    other = next(uri for uri in files._manifest.uris if uri.startswith("groups/") and uri != group)
    with pytest.raises(ReelError, match="does not exist"):
        files.open(other)


def test_remote_manifest_is_not_refetched_at_once(tmp_path):
    pytest.importorskip("fsspec", reason="needs the extra cloud")
    Publication(write_reel(tmp_path / "reel"), Address("memory://often/reel")).update()
    files, fetched = RemoteFiles("memory://often/reel"), []
    files._address.fetch = lambda uri, *limits: fetched.append(uri)  # pyright: ignore[reportAttributeAccessIssue]
    start = time.monotonic()
    for _ in range(50):
        read(files, "manifest.json")
    assert fetched == [] or time.monotonic() - start > served_files.FRESH


def test_remote_file_cache_is_bounded(tmp_path, monkeypatch):
    pytest.importorskip("fsspec", reason="needs the extra cloud")
    Publication(write_chapters(tmp_path / "reel"), Address("memory://much/reel")).update()
    files = RemoteFiles("memory://much/reel")
    uris = sorted(uri for uri in files._manifest.uris if uri.startswith("groups/"))
    monkeypatch.setattr(served_files, "CACHE_BYTES", 3 * max(files._entries[uri].bytes for uri in uris))
    for uri in uris:
        read(files, uri)
    assert 2 <= len(files._files) < len(uris)
    assert files._entries[uris[-1]].sha256 in files._files
