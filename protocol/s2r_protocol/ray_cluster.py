"""Jobs on a Ray cluster. Ray begins the job of a worker or machine that died anew, elsewhere."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

from s2r_protocol.exits import NotReadyError

LOCAL = "local"
RETRIES = 3
AHEAD = 2  # jobs handed out per processor: workers never wait, and an interruption costs little


def on_ray(
    work: Callable[..., Any],
    jobs: list[tuple[Any, ...]],
    workers: int,
    address: str,
    lost: Callable[..., Any] | None = None,
) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Jobs with their results, in the order in which they end.

    Args:
        work: A function that the cluster's workers can import; on this machine they look where this process looks.
        jobs: Arguments of its calls.
        workers: Processors of a local cluster.
        address: Of the cluster, or "local".
        lost: Called here with a job whose workers died again and again, as for want of memory; its result stands for
            the job's. None: that ends everything.

    Raises:
        NotReadyError: Ray is not installed, or nothing answers there.
    """
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise NotReadyError(
            f"a Ray cluster needs the extra 'scale': pip install sim2real2[scale] ({error})"
        ) from error
    try:
        if address == LOCAL:
            paths = {"env_vars": {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}}
            ray.init(
                num_cpus=workers, include_dashboard=False, log_to_driver=False, configure_logging=False,
                runtime_env=paths,
            )  # fmt: skip
        else:
            ray.init(address=address, log_to_driver=False, configure_logging=False)
    except ConnectionError as error:
        raise NotReadyError(f"no Ray cluster answers at {address}: {error}") from error
    try:

        def call(*job: Any) -> Any:  # whatever the caller's function returns
            return work(*job)

        remote = ray.remote(max_retries=RETRIES, num_cpus=1)(call)
        most = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        queue, waiting = list(jobs), {}
        while queue or waiting:
            while queue and len(waiting) < most:
                job = queue.pop(0)
                waiting[remote.remote(*job)] = job
            finished, _ = ray.wait(list(waiting), num_returns=1)
            for one in finished:
                job = waiting.pop(one)
                try:
                    result = ray.get(one)
                except (ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError):
                    if lost is None:
                        raise
                    result = lost(*job)
                yield job, result
    finally:
        ray.shutdown()
