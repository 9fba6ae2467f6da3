"""Resources that each job asks of the nodes of a Ray cluster, chosen so that as many jobs as possible fit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from splatreel.base.errors import UsageError
from splatreel.run.estimate import SERIAL_CHAPTER, WORTH, job_time


@dataclass(frozen=True)
class Resources:
    """Resources of a job.

    Attributes:
        cores: Number of cores, and of threads.
        gpus: Number of GPUs.
        memory: Bytes of memory.
    """

    cores: int
    gpus: int
    memory: int


@dataclass(frozen=True)
class ClusterPlan:
    """Resources of all jobs.

    Attributes:
        scene: Resources of the scene's job.
        chapter: Resources of a chapter's job.
        at_once: Number of chapters that fit at a time.
    """

    scene: Resources
    chapter: Resources
    at_once: int


@dataclass(frozen=True)
class _Node:
    cores: int
    gpus: int
    memory: int

    def slots(self, wanted: Resources) -> int:
        """Return the number of jobs that fit."""
        by_gpu = self.gpus // wanted.gpus if wanted.gpus else self.cores
        return min(self.cores // wanted.cores, by_gpu, self.memory // max(wanted.memory, 1))


def share_nodes(
    nodes: list[dict[str, Any]], chapters: int, device: str, need: int, threads: int | None = None
) -> ClusterPlan:
    """Return the resources of all jobs. Nodes that cannot hold a chapter are left out. The scene takes the whole largest node.

    Args:
        nodes: Nodes as `ray.nodes()` returns them.
        chapters: Number of chapters.
        device: auto, cpu or cuda. Unless it is cpu, each job takes a GPU if the cluster has any.
        need: Bytes of memory of a job.
        threads: Threads of each job; None chooses by the nodes' cores.

    Raises:
        UsageError: No node can hold a job.
    """
    resources = [node["Resources"] for node in nodes if node["Alive"] and node["Resources"].get("CPU", 0) >= 1]
    if not resources:
        raise UsageError("--cluster: no node of the Ray cluster offers a CPU. Add one with `ray start`.")
    alive = [_Node(int(n["CPU"]), int(n.get("GPU", 0)), int(n.get("memory", need))) for n in resources]
    with_gpu = [node for node in alive if node.gpus]
    if device == "cuda" and not with_gpu:
        raise UsageError("--device cuda: no node of the Ray cluster has a GPU. Use --device cpu, or add such a node.")
    gpus = int(bool(with_gpu) and device != "cpu")
    usable = [node for node in (with_gpu if gpus else alive) if node.memory >= need]
    if not usable:
        most = max(node.memory for node in (with_gpu if gpus else alive))
        raise UsageError(
            f"--cluster: a chapter takes {need / 2**30:.1f} GiB of memory, and no node of the Ray cluster offers more than "
            f"{most / 2**30:.1f}. Add a larger node, give Ray more of it (`ray start --memory`), or choose a smaller --width."
        )
    largest = max(usable, key=lambda node: (node.cores, node.memory))
    scene = Resources(min(largest.cores, threads or largest.cores), gpus, need)
    choices = [Resources(cores, gpus, need) for cores in range(1, largest.cores + 1)]
    if threads is not None:
        choices = [Resources(min(threads, largest.cores), gpus, need)]
    slots = {choice: sum(node.slots(choice) for node in usable) for choice in choices}
    times = {
        choice: math.ceil(chapters / slots[choice]) * job_time(1.0, SERIAL_CHAPTER, choice.cores)
        for choice in choices
        if slots[choice]
    }
    best = min(times.values())
    chosen = max((choice for choice in times if times[choice] <= WORTH * best), key=lambda choice: choice.cores)
    return ClusterPlan(scene, chosen, slots[chosen])
