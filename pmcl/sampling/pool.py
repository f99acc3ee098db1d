"""The threads, or the pool of the user, that advance the walkers."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from pmcl.interrupts import check_interrupt

__all__ = ["WalkerThreads", "as_pool", "walker_pool", "walker_threads"]


class WalkerThreads:
    """Threads of which the caller's is one.

    An emcee step takes a few milliseconds, and waking a thread a tenth of one. So the calling thread does not sleep
    while others work; it takes its share, and there is one hand-over less in each step.

    Parameters
    ----------
    executor : ThreadPoolExecutor
        The other threads.
    others : int
        How many they are.
    check : callable, optional
        Called before each item; it may raise, so that the work ends early.
    """

    def __init__(
        self, executor: ThreadPoolExecutor | None, others: int, check: Callable[[], None] | None = None
    ) -> None:
        self._executor, self._others, self._check = executor, others, check

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        """Return the function's values in the order of the items; each thread takes the next item that nobody has.

        Raises
        ------
        Exception
            Whatever the function or the check raises. No thread then begins another item, and those that are at work
            end first.
        """
        waiting = deque(enumerate(items))
        results: list[Any] = [None] * len(waiting)

        def work() -> None:
            while True:
                try:
                    k, item = waiting.popleft()
                except IndexError:
                    return
                try:
                    check_interrupt()
                    if self._check is not None:
                        self._check()
                    results[k] = function(item)
                except BaseException:
                    waiting.clear()
                    raise

        others = min(self._others, len(results) - 1)
        helpers = [self._executor.submit(work) for _ in range(others)] if self._executor is not None else []
        try:
            work()
        finally:
            errors = [helper.exception() for helper in helpers]
        for error in errors:
            if error is not None:
                raise error
        return results


def as_pool(pool: Any) -> Any:
    """Return a pool whose `map` gives values: a Dask client's own gives futures, but the client has an executor.

    Parameters
    ----------
    pool : object with a `map` method
        An executor of :mod:`concurrent.futures`, a pool of :mod:`multiprocessing`, of MPI, or a ``dask.distributed``
        client.

    Returns
    -------
    object with a `map` method
    """
    executor = getattr(pool, "get_executor", None)
    return executor() if callable(executor) else pool


@contextmanager
def walker_threads(threads: int, check: Callable[[], None] | None = None) -> Iterator[WalkerThreads]:
    """Yield so many threads, of which the caller's is one.

    Parameters
    ----------
    threads : int
        At least 1.
    check : callable, optional
        Called before each item: it may raise.

    Yields
    ------
    WalkerThreads
    """
    if threads == 1:
        yield WalkerThreads(None, 0, check)
        return
    with ThreadPoolExecutor(threads - 1) as executor:
        yield WalkerThreads(executor, threads - 1, check)


@contextmanager
def walker_pool(pool: Any, n_walkers: int, check: Callable[[], None] | None = None) -> Iterator[Any]:
    """Yield the pool that runs the walkers: the caller's own, or threads, as the kernels do not hold the lock.

    Parameters
    ----------
    pool : object with a `map` method, optional
        The caller's own pool.
    n_walkers : int
        Number of walkers; there are not more threads than walkers.
    check : callable, optional
        Called before each walker's part of a step, in threads only: it may raise.

    Yields
    ------
    object with a `map` method, or None
        None when there is one processor and nothing to check.
    """
    if pool is not None:
        yield as_pool(pool)
        return
    threads = min(n_walkers, os.cpu_count() or 1)
    if threads == 1 and check is None:
        yield None
        return
    with walker_threads(threads, check) as pool:
        yield pool
