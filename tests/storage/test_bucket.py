"""Buckets whose server fails, stalls, truncates or corrupts uploads, or returns wrong tags."""

from typing import Any

import pytest

from splatreel.base.errors import ReelError, StorageError
from splatreel.codec.inspection import verify_reel
from splatreel.codec.publish import Publication
from splatreel.storage.address import Address
from tests.buckets import Bucket, Faults
from tests.codec.reels import write_reel


@pytest.mark.parametrize(("fault", "times"), [("fails", 2), ("is_slow", 100), ("cuts", 2), ("tags_wrongly", 100)])
def test_publication_is_complete_after_s3_faults(
    faulty: tuple[Bucket, Faults], tmp_path: Any, fault: str, times: int
) -> None:
    bucket, faults = faulty
    reel = write_reel(tmp_path / "reel")
    faults.begin(fault, left=times)
    there = Address(bucket.url("reel"), pauses=(0.0, 0.0, 0.0, 0.0))
    published = Publication(reel, there).update()
    faults.left = 0
    assert faults.met >= 2
    assert published is not None
    assert verify_reel(bucket.url("reel")).bytes == published.bytes
    again = Publication(reel, there).update()
    assert again is not None
    assert again.sent == 0


def test_failing_server_leaves_no_partial_reel(faulty: tuple[Bucket, Faults], tmp_path: Any) -> None:
    bucket, faults = faulty
    reel = write_reel(tmp_path / "reel")
    faults.begin("fails", left=1000)
    with pytest.raises(StorageError, match="could not be written"):
        Publication(reel, Address(bucket.url("reel"), pauses=(0.0,))).update()
    faults.left = 0
    assert bucket.keys("reel") == []
    assert Publication(reel, Address(bucket.url("reel"))).update() is not None
    verify_reel(bucket.url("reel"))


def test_readers_find_silent_corruption(faulty: tuple[Bucket, Faults], tmp_path: Any) -> None:
    bucket, _ = faulty
    reel = write_reel(tmp_path / "reel")
    Publication(reel, Address(bucket.url("reel"))).update()
    key = next(key for key in bucket.keys("reel") if key.endswith(".safetensors"))
    data = bytearray(bucket.client.get_object(Bucket=bucket.name, Key=key)["Body"].read())
    data[-1] ^= 1
    bucket.client.put_object(Bucket=bucket.name, Key=key, Body=bytes(data))
    with pytest.raises(ReelError, match=r"SHA-256|checksum|damaged"):
        verify_reel(bucket.url("reel"))


@pytest.fixture
def stored(faulty: tuple[Bucket, Faults], tmp_path: Any) -> tuple[str, int]:
    """Return the address of a reel in the bucket, and the number of its files."""
    address = faulty[0].url("reel")
    published = Publication(write_reel(tmp_path / "reel"), Address(address)).update()
    assert published is not None
    return address, published.files + 1


@pytest.mark.parametrize("fault", ["is_busy", "fails", "cuts", "ignores_ranges"])
def test_reel_is_complete_though_each_first_request_fails(
    faulty: tuple[Bucket, Faults], stored: tuple[str, int], fault: str
) -> None:
    faults = faulty[1]
    faults.begin(fault, ("GET",))
    verify_reel(stored[0])
    assert faults.met == stored[1]


def test_private_bucket_is_explained_and_not_asked_again(
    faulty: tuple[Bucket, Faults], stored: tuple[str, int]
) -> None:
    faults = faulty[1]
    faults.begin("is_private", ("GET", "PUT"), 100)
    with pytest.raises(ReelError, match=r"manifest\.json: cannot be read \(.*is private.*AWS_ACCESS_KEY_ID") as caught:
        verify_reel(stored[0])
    assert "docs/publishing.md" in str(caught.value)
    assert faults.met == 1
    for act in (Address(stored[0]).sizes, lambda: Address(stored[0]).write("a", b"1")):
        with pytest.raises(StorageError, match="is private") as refused:
            act()
        assert refused.value.lasting
    assert faults.met == 3


@pytest.mark.parametrize("fault", ["is_busy", "fails"])
def test_listing_is_retried(faulty: tuple[Bucket, Faults], stored: tuple[str, int], fault: str) -> None:
    faults = faulty[1]
    faults.begin(fault, ("GET",), 2)
    assert len(Address(stored[0]).sizes()) == stored[1]
    assert faults.left is not None
    assert faults.left < 0


@pytest.mark.parametrize("fault", ["is_busy", "ignores_ranges"])
def test_parts_of_a_file_are_exact(faulty: tuple[Bucket, Faults], fault: str) -> None:
    bucket, faults = faulty
    address = Address(bucket.url("files"))
    address.write("a", bytes(range(200)))
    address.write("empty", b"")
    faults.begin(fault, ("GET",))
    assert address.read_range("a", 20, 30) == bytes(range(20, 30))
    assert address.open("a", 200).read() == bytes(range(200))
    assert address.read("empty", 10) == b""
    assert faults.met
    with pytest.raises(StorageError, match="ended after 10 of 20 bytes"):
        address.read_range("a", 190, 210)
