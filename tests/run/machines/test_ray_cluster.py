"""A Ray cluster of two nodes on this machine, one of which is lost during a chapter."""

import json
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from splatreel.base.errors import UsageError
from splatreel.cli.machine_options import MachineOptions
from splatreel.cli.publish import publishing
from splatreel.run.machines import ray_cluster
from splatreel.run.machines.exchange import Exchange
from splatreel.run.machines.ray_cluster import (
    ClusterOptions,
    ClusterPlan,
    Resources,
    connected,
    reconstruct_on_cluster,
    share_nodes,
    wait_for_nodes,
)
from splatreel.run.output.group_writer import no_presentation
from splatreel.run.pipeline import RunSpec
from tests.buckets import CREDENTIALS, Bucket
from tests.method.captures import WallCapture
from tests.run.machines.runs import CONFIG, FRAMES, spec
from tests.run.machines.test_local_processes import Display
from tests.run.test_pipeline import content

ray = pytest.importorskip("ray", reason="the tests of clusters need the extra cluster")

QUICKLY = {
    "health_check_initial_delay_ms": 500,
    "health_check_period_ms": 500,
    "health_check_timeout_ms": 5000,
    "health_check_failure_threshold": 2,
}
"""So that the loss of a node is noticed within seconds."""
SMALL = {"num_cpus": 1, "object_store_memory": 80 << 20}


@pytest.fixture(scope="module")
def cluster(s3_server: str) -> Iterator[Any]:
    """A cluster of two nodes that reach buckets; the first test removes one node."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**CREDENTIALS, "AWS_ENDPOINT_URL": s3_server, "RAY_USAGE_STATS_ENABLED": "0"}.items():
            patch.setenv(name, value)
        head = SMALL | {"include_dashboard": False, "_system_config": QUICKLY}
        made = Cluster(initialize_head=True, head_node_args=head)
        made.second = made.add_node(**SMALL)  # pyright: ignore[reportArgumentType, reportAttributeAccessIssue]
        yield made
        made.shutdown()


@pytest.mark.cluster
def test_node_that_is_lost_changes_nothing(cluster: Any, out: Path, expected: dict[str, str]) -> None:
    """All nodes see OUT. The node is lost once chapters are being made on both."""
    lost = []

    def lose(published: int) -> None:
        busy = list((out / "work").glob("group*/chapter.safetensors"))
        if len(busy) >= 2 and not lost:
            lost.append(time.monotonic())
            cluster.remove_node(cluster.second, allow_graceful=False)

    display = Display(lose)
    result = reconstruct_on_cluster(spec(out), cluster.address, progress=display)
    assert lost
    (moved,) = [note for note in display.notes if "continues after the last finished group" in note]
    assert re.fullmatch(r"chapter \d/3: \S+ was lost; \S+ continues after the last finished group \(attempt 2\)", moved)
    status = json.loads((out / "status.json").read_text())
    assert (status["state"], sorted(chapter["attempts"] for chapter in status["chapters"])) == ("complete", [1, 1, 2])
    assert content(result.reel) == expected
    assert display.stages[-1][0] == "reconstructing 3 chapters, 2 at a time"
    assert display.steps[-1] == 1000
    assert display.published == sorted(display.published)
    assert not ray.is_initialized()


def made_in(bucket: Bucket, cluster: Any, display: Display) -> dict[str, str]:
    """The reel of the command with `--cluster ADDRESS --out s3://...`, as it is in the driver's folder, which begins empty."""
    out, machines = bucket.url("run"), MachineOptions(cluster=cluster.address)
    machines.check(out, follow=False)
    with machines.folder(out) as folder:
        url, run = machines.published(out, None), spec(folder)
        with publishing(folder / "reel", url, 24.0, display, no_presentation) as present:
            said = machines.reconstruct(run, out, display, present)
        assert said == f"{out}/reel: the reel is complete."
        return content(folder / "reel")


@pytest.mark.cluster
def test_without_a_common_disk_checkpoints_are_exchanged(
    cluster: Any, bucket: Bucket, scene: Path, expected: dict[str, str]
) -> None:
    """Checkpoints that a task sent to the bucket are used by the next task and by the next driver."""
    Exchange(bucket.url("run"), scene).send_scene()
    display = Display()
    assert made_in(bucket, cluster, display) == expected
    assert len(set(display.published)) > 2  # it grows while it is made
    assert len(bucket.keys("run/reel/")) == len(expected)
    assert len(bucket.keys("run/work/logs/")) == 3
    assert bucket.keys("run/status.json") == ["run/status.json"]
    for key in bucket.keys("run/work/group0003/"):
        bucket.client.delete_object(Bucket=bucket.name, Key=key)
    again = Display()
    assert made_in(bucket, cluster, again) == expected
    assert again.stages[0][0] == "reconstructing 1 chapter"


def node(cpu: int, gpu: int = 0, memory: int = 64 << 30, alive: bool = True) -> dict[str, Any]:
    return {"Alive": alive, "Resources": {"CPU": cpu, "memory": memory} | ({"GPU": gpu} if gpu else {})}


GIB = 1 << 30


def test_tasks_request_resources_that_nodes_have() -> None:
    need = 2 * GIB
    plan = share_nodes([node(1), node(1), node(4, alive=False)], 3, "auto", need)
    assert plan == ClusterPlan(Resources(1, 0, need), Resources(1, 0, need), 2)
    plan = share_nodes(8 * [node(16)], 20, "auto", need)
    assert plan.at_once == 8 * (16 // plan.chapter.cores)
    assert plan.scene == Resources(16, 0, need)
    plan = share_nodes([node(16, gpu=4), node(8), node(32, gpu=4)], 20, "auto", need)
    assert (plan.chapter.gpus, plan.scene) == (1, Resources(32, 1, need))
    assert plan.at_once <= 8
    assert share_nodes([node(16, gpu=4)], 20, "cpu", need).chapter.gpus == 0
    with pytest.raises(UsageError, match="no node of the Ray cluster has a GPU"):
        share_nodes([node(16)], 20, "cuda", need)
    with pytest.raises(UsageError, match="no node of the Ray cluster offers a CPU"):
        share_nodes([node(0)], 20, "auto", need)


def test_small_node_does_not_limit_the_others() -> None:
    need = 9 * GIB
    large = 8 * [node(16, memory=64 * GIB)]
    alone = share_nodes(large, 56, "auto", need)
    assert share_nodes([node(4, memory=4 * GIB), *large], 56, "auto", need) == alone
    assert alone.at_once >= 32
    assert alone.at_once * need <= 8 * 64 * GIB
    for memory in (2, 8):
        with pytest.raises(UsageError, match=rf"takes 9.0 GiB of memory, and no node .* offers more than {memory}.0"):
            share_nodes([node(16, memory=memory * GIB)], 20, "auto", need)


def test_number_of_threads_is_honored() -> None:
    plan = share_nodes(2 * [node(16)], 20, "auto", GIB, threads=3)
    assert (plan.chapter.cores, plan.scene.cores, plan.at_once) == (3, 3, 10)
    assert share_nodes([node(2)], 20, "auto", GIB, threads=3).chapter.cores == 2


def test_node_that_an_autoscaler_starts_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[int] = []
    asked: list[int] = []
    told: list[str] = []

    def nodes() -> list[dict[str, Any]]:
        looks.append(1)
        return [node(0)] if len(looks) < 3 else [node(0), node(8)]

    monkeypatch.setattr(ray_cluster, "INTERVAL", 0.0)
    monkeypatch.setattr(ray_cluster, "_ask_autoscaler", lambda _, need, cores: asked.append(need))
    there = SimpleNamespace(nodes=nodes)
    plan = wait_for_nodes(there, 4, "auto", GIB, ClusterOptions(wait=60.0), told.append)
    assert plan.scene.cores == 8
    assert asked == [GIB]
    assert told == ["Waiting up to 60 s for a node of the cluster that can hold a chapter"]
    looks.clear()
    with pytest.raises(UsageError, match="offers a CPU"):
        wait_for_nodes(there, 4, "auto", GIB, ClusterOptions(), told.append)


def test_retries_and_resources_reach_ray() -> None:
    asked: list[dict[str, Any]] = []
    said: list[str | None] = []

    def remote(**options: Any) -> Any:
        asked.append(options)
        return lambda function: SimpleNamespace(remote=lambda *_: "reference")

    def get(reference: Any) -> Any:
        if reference == "reference":
            raise LookupError("\n  a long dump\n\nThe node died.\n")
        return []

    there = SimpleNamespace(
        remote=remote, get=get, wait=lambda refs, timeout: (refs, []), exceptions=SimpleNamespace(RayError=LookupError)
    )
    made = ray_cluster._Cluster.__new__(ray_cluster._Cluster)
    made.ray, made.options, made.spec, made.url = there, ClusterOptions(retries=7), b"", None
    made.mailbox = SimpleNamespace(take=SimpleNamespace(remote=list))
    made._run({4: (print,)}, lambda report: said.append(getattr(report, "error", None)), Resources(3, 1, GIB))
    assert asked == [
        {"max_retries": 7, "scheduling_strategy": "SPREAD", "num_cpus": 3, "num_gpus": 1, "memory": GIB},
    ]
    assert said == ["Ray gave up after 8 attempts: The node died."]


def test_messages_of_ray_go_to_its_log(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    import logging

    log = tmp_path / "work" / "logs" / "ray.log"
    with ray_cluster._ray_log(log):
        logging.getLogger("ray").warning("a dump of many lines")
    assert log.read_text().endswith("WARNING a dump of many lines\n")
    assert "dump" not in "".join(capfd.readouterr())


def test_ray_client_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"Ray Client is not supported.*--cluster auto"), connected("ray://head:10001"):
        pass


def test_unreachable_cluster_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    assert os.environ.get("RAY_ADDRESS") is None
    opened: list[int] = []

    def source() -> WallCapture:
        opened.append(1)
        return WallCapture(FRAMES)

    with pytest.raises(UsageError, match=r"--cluster 127.0.0.1:9: no Ray cluster answers there"):
        reconstruct_on_cluster(RunSpec(source, tmp_path / "out", CONFIG, device="cpu"), "127.0.0.1:9")
    assert opened == [], "nothing is read for a cluster that is not there"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("given", "out", "words"),
    [
        ({"job": "scene", "workers": 2}, "out", "--workers and --job exclude each other"),
        ({"chapter": "0/2"}, "out", "Add --job chapter"),
        ({"job": "chapter", "chapter": "2/2"}, "out", "is not a share of the chapters"),
        ({}, "s3://bucket/run", "only --cluster writes elsewhere"),
        ({"cluster": "auto", "cluster_retries": -1}, "out", "--cluster-retries -1: give 0 or more"),
        ({"cluster": "auto", "cluster_wait": float("nan")}, "out", "--cluster-wait nan: give seconds"),
    ],
)
def test_options_that_do_not_go_together(given: dict[str, Any], out: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        MachineOptions(**given).check(out, follow=False)
    with pytest.raises(UsageError, match="is already written to s3://bucket/run"):
        MachineOptions(cluster="auto").published("s3://bucket/run", "s3://other")
