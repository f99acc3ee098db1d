"""Where jobs run: results, failures, progress, lost processes, and Ctrl-C."""

from __future__ import annotations

import os
import signal
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.pool import ThreadPool

import pytest
from fleets import KilledAtFirst, Square

from pmcl.errors import SamplingError
from pmcl.fleet.places import ExecutorPlace, HerePlace, Job, MapPlace, ProcessPlace, as_place
from pmcl.interrupts import check_interrupt, stopping_on_interrupt


def _results(place, numbers=range(6)):
    told = []
    jobs = [Job(f"robot{number}", Square(number)) for number in numbers]
    done = {one.name: one for one in place.run(jobs, lambda name, text: told.append(text))}
    return done, told


def _check(done):
    assert {name: one.value for name, one in done.items() if not one.error} == {
        f"robot{number}": number**2 for number in (0, 1, 2, 4, 5)
    }
    assert done["robot3"].error == "ArithmeticError: three is not for me"


def test_jobs_run_here_and_one_that_fails_stops_no_other():
    done, told = _results(HerePlace())
    _check(done)
    assert told == [f"squaring {number}" for number in range(6)]


def test_jobs_run_in_threads_and_tell_of_their_progress():
    with ThreadPoolExecutor(2) as executor:
        place = as_place(executor)
        assert isinstance(place, ExecutorPlace)
        assert place.slots == 2
        done, told = _results(place)
    _check(done)
    assert sorted(told) == [f"squaring {number}" for number in range(6)]


def test_jobs_run_in_a_pool_that_has_only_a_map():
    with ThreadPool(2) as pool:

        class OnlyMap:
            map = pool.map

        assert isinstance(as_place(OnlyMap()), MapPlace)
        _check(_results(OnlyMap() and as_place(OnlyMap()))[0])


def test_what_is_no_pool_is_refused():
    with pytest.raises(SamplingError, match="expected pool with a method map, but got int"):
        as_place(3)


def test_jobs_run_in_processes_and_tell_of_their_progress():
    done, told = _results(ProcessPlace(2), (1, 2, 3))
    assert done["robot1"].value == 1
    assert done["robot2"].value == 4
    assert done["robot3"].error == "ArithmeticError: three is not for me"
    assert set(told) <= {f"squaring {number}" for number in (1, 2, 3)}
    assert told


@pytest.mark.slow
def test_a_job_whose_process_was_killed_is_begun_anew_and_given_up_in_the_end(tmp_path):
    jobs = [
        Job("once", KilledAtFirst(str(tmp_path / "once"), 1)),
        Job("always", KilledAtFirst(str(tmp_path / "always"), 10)),
    ]
    done = {one.name: one for one in ProcessPlace(1).run(jobs, lambda name, text: None)}
    assert done["once"].value == "alive"
    assert "its process was killed 3 times" in done["always"].error


def test_ctrl_c_stops_the_jobs_in_threads_and_waits_for_them():
    begun, ended, finished = [], [], []

    class Long:
        def __call__(self, tell):
            begun.append(1)
            try:
                for _ in range(1000):
                    check_interrupt()
                    threading.Event().wait(0.01)
                finished.append(1)
            finally:
                ended.append(1)

    def work():
        with ThreadPoolExecutor(2) as executor, stopping_on_interrupt():
            threading.Timer(0.1, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
            list(as_place(executor).run([Job(f"r{k}", Long()) for k in range(20)], lambda name, text: None))

    with pytest.raises(KeyboardInterrupt):
        work()
    assert len(begun) == len(ended), "a job goes on"
    assert not finished


def test_an_executor_whose_futures_are_made_elsewhere_is_used():
    class Elsewhere:
        def map(self, function, items):
            raise AssertionError("submit is better: results come as they are done")

        def submit(self, function, *arguments):
            future = Future()
            try:
                future.set_result(function(*arguments))
            except Exception as error:
                future.set_exception(error)
            return future

    _check(_results(as_place(Elsewhere()))[0])
