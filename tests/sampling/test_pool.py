"""The threads that advance the walkers: order, errors, and that they work at once."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from pmcl.sampling.pool import WalkerThreads, walker_pool


@pytest.fixture
def threads():
    with ThreadPoolExecutor(2) as executor:
        yield WalkerThreads(executor, 2)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 50])
def test_values_come_in_the_order_of_the_items(threads, count):
    assert threads.map(lambda k: k * k, iter(range(count))) == [k * k for k in range(count)]


def test_all_threads_work_at_once_and_one_is_the_callers(threads):
    met = threading.Barrier(3, timeout=20.0)

    def who(_: int) -> int:
        met.wait()  # nobody goes on before three have come
        return threading.get_ident()

    idents = threads.map(who, range(3))
    assert len(set(idents)) == 3
    assert threading.get_ident() in idents


@pytest.mark.parametrize("by_caller", [True, False])
def test_an_error_ends_the_work_and_reaches_the_caller(threads, by_caller):
    met = threading.Barrier(3, timeout=20.0)
    begun = []

    def fail(k: int) -> None:
        begun.append(k)
        if k < 3:
            met.wait()
            if (threading.get_ident() == threading.main_thread().ident) == by_caller:
                raise ValueError(f"item {k}")
        threading.Event().wait(0.01)

    with pytest.raises(ValueError, match="item"):
        threads.map(fail, range(1000))
    after = len(begun)
    assert after < 500
    threading.Event().wait(0.05)
    assert len(begun) == after, "work went on after the error was told"
    assert threads.map(abs, [-1, -2]) == [1, 2]


def test_a_pool_of_the_users_is_used_as_it_is():
    mine = object()
    with walker_pool(mine, 4) as pool:
        assert pool is mine


def test_one_walker_or_one_core_needs_no_threads(monkeypatch):
    with walker_pool(None, 1) as pool:
        assert pool is None
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with walker_pool(None, 4) as pool:
        assert pool is None
