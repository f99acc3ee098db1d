"""Where jobs run: in this process, in its threads, in processes of its own, or in a pool of the user."""

from __future__ import annotations

import concurrent.futures as futures
import contextlib
import logging
import multiprocessing
import os
import queue
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any, NamedTuple

from pmcl.errors import PmclError, SamplingError
from pmcl.interrupts import check_interrupt

__all__ = ["Done", "ExecutorPlace", "HerePlace", "Job", "MapPlace", "Place", "ProcessPlace", "Tell", "as_place"]

_logger = logging.getLogger("pmcl.fleet")

Tell = Callable[[str, str], None]
"""Is told the name of a job and how far it has come."""

# How often a job is begun anew whose process was killed, as Dask does by default: it may itself be the reason.
_MOST_LOSSES = 3
# How often the one who waits looks for Ctrl-C [s].
_PAUSE = 0.2


class Job(NamedTuple):
    """A piece of work.

    Attributes
    ----------
    name : str
        Of the robot.
    work : callable
        Does it, and tells of its progress to what it is called with. Pools of processes must be able to pickle it.
    """

    name: str
    work: Callable[[Tell], Any]


class Done(NamedTuple):
    """The end of a job.

    Attributes
    ----------
    name : str
        Of the robot.
    value : object
        What the work returned; None when it failed.
    error : str
        Why it failed, in one line; empty when it did not.
    """

    name: str
    value: Any = None
    error: str = ""


class Place(ABC):
    """Where jobs run.

    Attributes
    ----------
    slots : int
        Jobs that run at once.
    """

    slots: int = 1

    @abstractmethod
    def run(self, jobs: Sequence[Job], tell: Tell) -> Iterator[Done]:
        """Run jobs and yield each as it is done.

        Parameters
        ----------
        jobs : sequence of Job
            A job that fails stops no other.
        tell : callable
            Is told of progress, where that can be passed on.

        Yields
        ------
        Done

        Raises
        ------
        KeyboardInterrupt
            When Ctrl-C was pressed; jobs that have not begun are dropped, the others stop as soon as they can.
        """


class HerePlace(Place):
    """The calling thread, one job after the other."""

    def run(self, jobs: Sequence[Job], tell: Tell) -> Iterator[Done]:
        """Run jobs and yield each as it is done, see :meth:`Place.run`."""
        for job in jobs:
            check_interrupt()
            try:
                done = Done(job.name, job.work(tell))
            except Exception as error:
                done = failed(job, error)
            yield done


class ExecutorPlace(Place):
    """An executor of :mod:`concurrent.futures`, or one that returns such futures.

    Parameters
    ----------
    executor : concurrent.futures.Executor
        Of the user, who also ends it.
    slots : int
        Jobs that it runs at once.
    """

    def __init__(self, executor: Any, slots: int) -> None:
        self.executor, self.slots = executor, slots
        self._in_threads = isinstance(executor, futures.ThreadPoolExecutor)

    def submit(self, job: Job, tell: Tell) -> futures.Future[Any]:
        """Give one job to the executor. Only threads can tell of progress."""
        future: futures.Future[Any] = self.executor.submit(job.work, tell if self._in_threads else silent)
        return future

    def run(self, jobs: Sequence[Job], tell: Tell) -> Iterator[Done]:
        """Run jobs and yield each as it is done, see :meth:`Place.run`."""
        waiting = {self.submit(job, tell): job for job in jobs}
        try:
            while waiting:
                check_interrupt()
                ready, _ = futures.wait(waiting, timeout=_PAUSE, return_when=futures.FIRST_COMPLETED)
                for future in ready:
                    job = waiting.pop(future)
                    error = future.exception()
                    if error is not None and not isinstance(error, Exception):
                        raise error
                    yield Done(job.name, future.result()) if error is None else failed(job, error)
        finally:
            begun = [future for future in waiting if not future.cancel()]
            if self._in_threads:  # they end at their next step, as long as the interruption is known
                futures.wait(begun)


class MapPlace(Place):
    """A pool of the user that has nothing but `map`: results come in the order of the jobs.

    Parameters
    ----------
    pool : object with a `map` method
    """

    def __init__(self, pool: Any) -> None:
        self.pool = pool

    def run(self, jobs: Sequence[Job], tell: Tell) -> Iterator[Done]:
        """Run jobs and yield each as it is done, see :meth:`Place.run`."""
        yield from self.pool.map(_quietly, jobs)


class ProcessPlace(Place):
    """Processes of this machine. A job whose process was killed is begun anew.

    Parameters
    ----------
    processes : int
        How many.
    """

    def __init__(self, processes: int) -> None:
        self.slots = processes

    def run(self, jobs: Sequence[Job], tell: Tell) -> Iterator[Done]:
        """Run jobs and yield each as it is done, see :meth:`Place.run`."""
        losses = dict.fromkeys((job.name for job in jobs), 0)
        left = list(jobs)
        while left:
            lost: list[Job] = []
            for job, done in self._run_until_lost(left, tell):
                if done is None:
                    lost.append(job)
                else:
                    yield done
            # Jobs begin in their order. The first ones that were lost ran, and one of them may have killed its process;
            # the others had not begun, and go first now.
            lost.sort(key=left.index)
            ran, left = lost[: self.slots], lost[self.slots :]
            for job in ran:
                losses[job.name] += 1
                if losses[job.name] < _MOST_LOSSES:
                    left.append(job)
                else:
                    yield Done(job.name, error=f"its process was killed {_MOST_LOSSES} times; is there enough memory?")
            if left:
                _logger.warning("a process was killed; begun anew: %s", ", ".join(job.name for job in left))

    def _run_until_lost(self, jobs: Sequence[Job], tell: Tell) -> Iterator[tuple[Job, Done | None]]:
        """Yield each job as it is done; with None where the process was killed that it, or one beside it, ran in."""
        context = multiprocessing.get_context("spawn")
        messages = context.Queue()
        pids: set[int] = set()
        listener = threading.Thread(target=_listen, args=(messages, pids, tell), daemon=True)
        listener.start()
        executor = futures.ProcessPoolExecutor(
            min(self.slots, len(jobs)), context, initializer=_begin_process, initargs=(messages, os.getpid())
        )
        waiting = {executor.submit(_in_process, job): job for job in jobs}
        try:
            while waiting:
                check_interrupt()
                ready, _ = futures.wait(waiting, timeout=_PAUSE, return_when=futures.FIRST_COMPLETED)
                for future in ready:
                    job, error = waiting.pop(future), future.exception()
                    if isinstance(error, BrokenProcessPool):
                        yield job, None
                    elif error is not None and not isinstance(error, Exception):
                        raise error
                    else:
                        yield job, Done(job.name, future.result()) if error is None else failed(job, error)
        finally:
            if waiting:  # they stop after their next step, and write their checkpoints first
                for pid in pids:
                    with contextlib.suppress(OSError):
                        os.kill(pid, signal.SIGTERM)
            executor.shutdown(wait=True, cancel_futures=True)
            messages.put(None)
            listener.join(_PAUSE)


def as_place(pool: Any) -> Place:
    """Return the place that a pool of the user is.

    Parameters
    ----------
    pool : object with a `map` method, optional
        An executor of :mod:`concurrent.futures`, a ``dask.distributed`` client, or any other pool. Threads of this
        process, one for each core, when left out.

    Returns
    -------
    Place

    Raises
    ------
    SamplingError
        When it has no method map.
    """
    if pool is None:
        cores = os.cpu_count() or 1
        return ExecutorPlace(futures.ThreadPoolExecutor(cores), cores) if cores > 1 else HerePlace()
    if isinstance(pool, Place):
        return pool
    if not callable(getattr(pool, "map", None)):
        raise SamplingError(f"expected pool with a method map, but got {type(pool).__name__}; leave it out for threads")
    if callable(getattr(pool, "get_executor", None)):
        from pmcl.fleet.cluster import ClusterPlace

        return ClusterPlace(pool)
    if callable(getattr(pool, "submit", None)):
        return ExecutorPlace(pool, int(getattr(pool, "_max_workers", 1)))
    return MapPlace(pool)


def failed(job: Job, error: BaseException) -> Done:
    """Return the end of a job that raised an error."""
    if isinstance(error, PmclError):
        return Done(job.name, error=str(error))
    _logger.debug("%s failed", job.name, exc_info=error)
    return Done(job.name, error=f"{type(error).__name__}: {' '.join(str(error).split())[:300]}")


def silent(name: str, message: str) -> None:
    """Tell nobody."""


def _quietly(job: Job) -> Done:
    try:
        return Done(job.name, job.work(silent))
    except Exception as error:
        return failed(job, error)


class _Child:
    """What a process of a :class:`ProcessPlace` knows: where its messages go, whose it is, and whether it works."""

    messages: Any = None
    parent = 0
    busy = False


def _begin_process(messages: Any, parent: int) -> None:
    _Child.messages, _Child.parent = messages, parent
    # Ctrl-C goes to all processes of a terminal; the parent decides, and says so by SIGTERM.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    messages.cancel_join_thread()
    messages.put(os.getpid())
    threading.Thread(target=_watch_parent, daemon=True).start()


def _in_process(job: Job) -> Any:
    _Child.busy = True
    try:
        return job.work(_tell_parent)
    finally:
        _Child.busy = False
        if _orphaned():
            os._exit(1)


def _tell_parent(name: str, message: str) -> None:
    if _orphaned():
        raise KeyboardInterrupt("the process that waited for this one is gone")
    _Child.messages.put((name, message))


def _orphaned() -> bool:
    return os.getppid() != _Child.parent


def _watch_parent() -> None:
    """End a process that waits for work from one that was killed; one that works stops when it tells of progress."""
    while _Child.busy or not _orphaned():
        time.sleep(1.0)
    os._exit(1)


def _listen(messages: Any, pids: set[int], tell: Tell) -> None:
    while True:
        try:
            message = messages.get()
        except (EOFError, OSError, queue.Empty):
            return
        if message is None:
            return
        if isinstance(message, int):
            pids.add(message)
        else:
            tell(*message)
