"""Runs in blocks on Ray's own test cluster; a process of its own for `test_cluster.py`.

`python ray_runs.py DATA OUT CASE`: prints JSON, or the sentence of what was refused.
"""

import json
import os
import signal
import sys
import threading
import time
from pathlib import Path

import gsut
from gsut.blocks import cluster as room
from small_blocks import LARGE_OPTIONS, OPTIONS, train

_STORE_BYTES = 80 << 20  # the least that Ray takes
_HEALTH = {
    "health_check_initial_delay_ms": 0, "health_check_period_ms": 500,
    "health_check_timeout_ms": 1000, "health_check_failure_threshold": 3,
}  # fmt: skip


def main(data: str, out: str, case: str) -> None:
    from ray.cluster_utils import Cluster

    ray_cluster = Cluster(
        initialize_head=True,
        head_node_args={
            "num_cpus": 0, "object_store_memory": _STORE_BYTES, "_system_config": _HEALTH,
            "include_dashboard": False,
        },
    )  # fmt: skip
    count = 1 if case == "one node" else 2
    nodes = [
        ray_cluster.add_node(num_cpus=1, object_store_memory=_STORE_BYTES) for _ in range(count)
    ]
    killed: list[int] = []
    report = room.write_file
    wanted = int(os.environ.get("KILLS", "2"))

    largest: dict[str, int] = {}

    def disturb(path: os.PathLike, content: bytes) -> None:
        report(path, content)
        largest[str(path)] = max(largest.get(str(path), 0), len(content))
        if case == "worker killed" and len(killed) < wanted:
            threading.Thread(target=_kill_a_worker, args=(killed,)).start()
        if case == "node killed" and len(killed) < wanted:
            killed.append(0)
            ray_cluster.remove_node(nodes.pop(0), allow_graceful=False)
            nodes.append(ray_cluster.add_node(num_cpus=1, object_store_memory=_STORE_BYTES))
        if case == "driver killed" and Path(path).name == "state1.npz":
            killed.append(0)
            if len(killed) == 7:
                os.kill(os.getpid(), signal.SIGKILL)

    room.write_file = disturb
    if case == "mixed versions":
        room._core.__version__ = "other"  # here, not on the nodes
    began = time.monotonic()
    scene = gsut.load_dataset(data)
    try:
        resume = Path(out).exists()
        training = LARGE_OPTIONS if case == "small store" else OPTIONS
        result = train(
            scene, Path(out), resume=resume, training=training, cluster=ray_cluster.address
        )
    except gsut.InputError as error:
        print(json.dumps({"refused": str(error)}))
        return
    print(json.dumps({
        "killed": len(killed), "seconds": time.monotonic() - began,
        "gaussians": len(result.gaussians),
        "state_bytes": sum(n for path, n in largest.items() if path.endswith("state1.npz")),
        "store_bytes": _STORE_BYTES,
    }))  # fmt: skip


def _kill_a_worker(killed: list[int]) -> None:
    """kill -9 of a process that trains a segment now; its id is added."""
    for process in Path("/proc").iterdir():
        if process.name.isdecimal():
            try:
                title = (process / "cmdline").read_bytes()
            except OSError:
                continue
            if b"ray::train_segment" in title and _is_descendant(int(process.name)):
                os.kill(int(process.name), signal.SIGKILL)
                killed.append(int(process.name))
                return


def _is_descendant(pid: int) -> bool:
    """Whether a process was started by this one's."""
    while pid > 1:
        if pid == os.getpid():
            return True
        try:
            pid = int((Path("/proc") / str(pid) / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            return False
    return False


if __name__ == "__main__":
    main(*sys.argv[1:])
