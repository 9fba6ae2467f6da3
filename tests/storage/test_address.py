import errno
import subprocess
import sys
from pathlib import Path

import pytest

from splatreel.base.errors import StorageError, UsageError
from splatreel.storage.address import Address, is_url, local_path
from splatreel.storage.transport import Bucket, Headers, header_arguments, is_plain
from tests.buckets import breaking


def test_folder_round_trip(address):
    folder = Address(address)
    assert folder.sizes() == {}
    assert folder.read("a/b.txt", 10) is None
    folder.write("a/b.txt", b"hello", Headers("text/plain"))
    folder.write("a/b.txt", b"hello, world")
    folder.write("a/empty", b"")
    folder.write("c", b"1")
    assert folder.sizes() == {"a/b.txt": 12, "a/empty": 0, "c": 1}
    assert folder.sizes("a/b") == {"a/b.txt": 12}
    assert folder.sizes("a/") == {"a/b.txt": 12, "a/empty": 0}
    assert folder.sizes("nothing/here") == {}
    assert folder.read("a/b.txt", 5) == b"hello"
    assert folder.read("a/b.txt", 100) == b"hello, world"
    folder.remove("a/b.txt")
    folder.remove("a/b.txt")
    assert set(folder.sizes()) == {"a/empty", "c"}
    assert folder.name("c") == f"{address}/c"


def test_changes_by_others_are_visible(address):
    """Listings are not cached."""
    mine, other = Address(address), Address(address)
    mine.write("a", b"1")
    assert mine.sizes() == {"a": 1}
    other.write("b", b"22")
    assert mine.sizes() == {"a": 1, "b": 2}


def test_missing_bucket_is_named(bucket):
    folder = Address("s3://no-such-bucket/reel")
    with pytest.raises(StorageError, match=r"s3://no-such-bucket/reel/a: could not be written \(1 bytes\)") as caught:
        folder.write("a", b"1")
    assert caught.value.lasting


def test_unreachable_server_is_not_a_lasting_error(bucket, monkeypatch):
    from s3fs import S3FileSystem

    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    monkeypatch.setattr(S3FileSystem, "retries", 1)
    S3FileSystem.clear_instance_cache()
    with pytest.raises(StorageError, match="cannot be listed") as caught:
        Address("s3://bucket/reel", pauses=()).sizes()
    S3FileSystem.clear_instance_cache()
    assert not caught.value.lasting


def test_missing_credentials_are_a_lasting_error(bucket, monkeypatch, tmp_path):
    from s3fs import S3FileSystem

    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    for name in ("AWS_SHARED_CREDENTIALS_FILE", "AWS_CONFIG_FILE"):
        monkeypatch.setenv(name, str(tmp_path / name))
    S3FileSystem.clear_instance_cache()
    with pytest.raises(StorageError, match="credentials") as caught:
        Address(bucket.url("reel")).sizes()
    S3FileSystem.clear_instance_cache()
    assert caught.value.lasting


def test_headers_are_stored_in_the_bucket(bucket):
    Address(bucket.url("reel")).write("manifest.json", b"{}", Headers("application/json", "no-cache"))
    found = bucket.headers("reel/manifest.json")
    assert (found["content-type"], found["cache-control"]) == ("application/json", "no-cache")


def test_header_arguments_depend_on_the_service():
    headers = Headers("image/jpeg", "no-cache")
    assert header_arguments("s3", headers) == {"ContentType": "image/jpeg", "CacheControl": "no-cache"}
    google = {"content_type": "image/jpeg", "fixed_key_metadata": {"cache_control": "no-cache"}}
    assert header_arguments("gs", headers) == google
    assert header_arguments("memory", headers) == {}


def test_partial_files_are_hidden_by_a_move(tmp_path, monkeypatch):
    """fsspec's local files stand in for SFTP and similar protocols."""
    fsspec = pytest.importorskip("fsspec", reason="needs the extra cloud")
    folder = Address("memory://any", pauses=())
    bucket = folder._transport
    assert isinstance(bucket, Bucket)
    bucket._files, bucket._root, bucket._protocol = fsspec.filesystem("file"), str(tmp_path / "there"), "sftp"
    folder.write("a/b", b"old")
    monkeypatch.setattr(bucket._files, "mv", lambda *_: (_ for _ in ()).throw(OSError("cut")))
    with pytest.raises(StorageError, match="cut"):
        folder.write("a/b", b"new")
    assert folder.read("a/b", 9) == b"old"
    assert [path.name for path in (tmp_path / "there" / "a").iterdir()] == ["b"]


@pytest.mark.parametrize(
    ("address", "error", "words"),
    [
        ("nix://bucket/reel", UsageError, "Protocol not known"),
        ("s3://", UsageError, "names no folder"),
        ("http://host/reel", UsageError, "web servers take no files"),
        ("file://host/reel", UsageError, "three slashes"),
    ],
)
def test_invalid_addresses_are_refused(address, error, words):
    pytest.importorskip("fsspec", reason="needs the extra cloud")
    with pytest.raises(error, match=words):
        Address(address, writes=True)


@pytest.mark.parametrize(
    ("url", "missing", "command"),
    [
        ("gs://bucket/reel", "gcsfs", "pip install gcsfs"),
        ("s3://bucket/reel", "s3fs", "pip install s3fs"),
        ("s3://bucket/reel", "fsspec", 'pip install "splatreel[cloud]" s3fs'),
    ],
)
def test_missing_package_is_named(url, missing, command):
    pytest.importorskip("fsspec", reason="needs the extra cloud")
    code = "import sys; sys.modules[sys.argv[2]] = None\nfrom splatreel.cli.failure import explain\n"
    code += "from splatreel.storage.address import Address\n"
    code += "try: Address(sys.argv[1])\nexcept Exception as error: print(explain(error, [])[0])"
    result = subprocess.run([sys.executable, "-c", code, url, missing], capture_output=True, text=True, check=True)
    assert result.stdout.startswith(f"Error: {url}: ")
    assert result.stdout.endswith(f"\n  {command}\n")


def test_paths_need_no_fsspec(tmp_path):
    code = "import sys; sys.modules['fsspec'] = None\nfrom splatreel.storage.address import Address\n"
    code += "Address(sys.argv[1]).write('a/b', b'1'); print(Address('file://' + sys.argv[1]).sizes())"
    result = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True)
    assert result.stdout == "{'a/b': 1}\n"


def test_is_url_separates_paths_from_urls(tmp_path):
    assert [is_url(text) for text in ("s3://a", "memory://a", "C:\\reel", "a/b", "c:/x", "s3:/a")] == [
        True,
        True,
    ] + 4 * [False]
    assert local_path("file:///some/a%20b") == local_path("/some/a b")
    assert local_path("s3://a/b") is None


def test_names_outside_the_folder_are_not_plain():
    assert all(map(is_plain, ("a", "a/b.c", "work/group0001/keyframe.safetensors@000000-ab", "a b")))
    assert not any(map(is_plain, ("", "/a", "a/", "../a", "a/../b", "a//b", ".hidden", "a/.b", "a\\b", "a\nb")))


def test_disk_error_names_the_file(tmp_path):
    (tmp_path / "file").write_text("")
    folder = Address(tmp_path / "file")
    with pytest.raises(StorageError, match="file/a: could not be written"):
        folder.write("a", b"1")


def test_write_is_retried_and_reported(tmp_path):
    told = []
    address, _ = breaking(Address(tmp_path, report=told.append, pauses=(0.0, 0.0)), {0, 1})
    address.write("a", b"1")
    assert Address(tmp_path).sizes() == {"a": 1}
    assert told == 2 * [f"{tmp_path}/a: could not be written (1 bytes) (the line is cut). Retrying."]


def test_retries_end_after_the_last_pause(tmp_path):
    address, line = breaking(tmp_path, {0, 1, 2, 3, 5}, pauses=(0.0, 0.0))
    with pytest.raises(StorageError, match="the line is cut"):
        address.write("a", b"1")
    assert line.writes == 3
    with pytest.raises(StorageError, match="the line is cut"):
        address.write("a", b"1")
    assert line.writes == 4, "after a failure, a single attempt finds out whether the folder is back"
    address.write("a", b"1")
    address.write("a", b"1")
    assert line.writes == 7


def test_lasting_errors_are_not_retried(tmp_path):
    (tmp_path / "file").write_text("")
    told = []
    with pytest.raises(StorageError):
        Address(tmp_path / "file", report=told.append).read("a", 1)
    assert told == []


def test_full_disk_is_not_retried(tmp_path, monkeypatch):
    def refused(path, data):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_bytes", refused)
    told = []
    with pytest.raises(StorageError, match=r"could not be written \(1 bytes\) \(No space left on device\)") as caught:
        Address(tmp_path, report=told.append).write("a", b"1")
    assert caught.value.lasting
    assert told == []


def test_slow_reads_are_not_repeated_for_ever(tmp_path, monkeypatch):
    """An attempt after which `PATIENCE` has passed is the last one."""
    monkeypatch.setattr("splatreel.storage.web.PATIENCE", -1.0)
    address, attempts = Address(tmp_path, report=lambda _: None, pauses=9 * (0.0,)), []

    def time_out(name, begin, end):
        attempts.append(name)
        raise TimeoutError("slow")

    monkeypatch.setattr(address._transport, "read", time_out)
    with pytest.raises(StorageError, match="slow"):
        address.read("a", 1)
    assert attempts == ["a"]
