"""Jobs on an existing Dask cluster; the only module that imports Dask."""

from __future__ import annotations

import concurrent.futures as futures
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from uuid import uuid4

from pmcl.errors import SamplingError
from pmcl.fleet.places import Done, ExecutorPlace, Job, Tell

__all__ = ["ClusterPlace", "cluster"]

# How long a scheduler may take to answer [s].
_PATIENCE = 20.0


class ClusterPlace(ExecutorPlace):
    """The workers of a Dask scheduler.

    A job travels with all it needs, so that the scheduler can give it to another worker when the first is lost.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: Any) -> None:
        self.client = client
        self.topic = f"pmcl-fleet-{uuid4().hex}"
        # Two jobs are never the same, whatever their arguments: one of them may have been lost.
        super().__init__(client.get_executor(pure=False), max(1, sum(client.nthreads().values())))

    def submit(self, job: Job, tell: Tell) -> futures.Future[Any]:
        """Give one job to the cluster."""
        future: futures.Future[Any] = self.executor.submit(_on_worker, job, self.topic)
        return future

    def run(self, jobs: Sequence[Job], tell: Tell) -> Iterator[Done]:
        """Run jobs and yield each as it is done, see :meth:`pmcl.fleet.places.Place.run`."""
        self.client.subscribe_topic(self.topic, lambda event: tell(*event[1]))
        try:
            for done in super().run(jobs, tell):
                if done.error.startswith("KilledWorker"):
                    lost = "the cluster lost every worker that ran it; look at the workers' logs, and at their memory"
                    yield done._replace(error=lost)
                else:
                    yield done
        finally:
            self.client.unsubscribe_topic(self.topic)


def _on_worker(job: Job, topic: str) -> Any:
    from distributed import get_worker

    worker = get_worker()
    return job.work(lambda name, message: worker.log_event(topic, (name, message)))


@contextmanager
def cluster(address: str) -> Iterator[ClusterPlace]:
    """Connect to the scheduler of an existing cluster.

    Parameters
    ----------
    address : str
        Such as ``tcp://10.0.0.1:8786``, or the path of a scheduler file.

    Yields
    ------
    ClusterPlace

    Raises
    ------
    SamplingError
        When Dask is not installed, nothing answers at this address, or the cluster has no worker.
    """
    try:
        from distributed import Client
    except ImportError:
        raise SamplingError(
            "expected dask.distributed for a scheduler, but it is not installed; pip install 'pmcl[dask]', here and "
            "on the workers, or leave the scheduler out to use the cores of this machine"
        ) from None
    try:
        to = {"scheduler_file": address} if address.endswith(".json") else {"address": address}
        client = Client(**to, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise SamplingError(
            f"expected a Dask scheduler at {address}, but got {type(error).__name__} ({' '.join(str(error).split())});"
            " start one with 'dask scheduler', and give the address that it prints"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError:
            raise SamplingError(
                f"expected workers of the scheduler at {address}, but there are none; start some with "
                f"'dask worker {address}'"
            ) from None
        yield ClusterPlace(client)
