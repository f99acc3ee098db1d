"""Bad inputs of every kind: one line, exit status 2, no file made, in bounded time and memory; or a sound result.

The whole corpus is long; a part of each family always runs. ``python tests/corpus/run.py`` prints a table of it.
"""

from __future__ import annotations

import pytest
from corpus.check import checked
from corpus.families import FAMILIES, all_cases, quick_cases
from corpus.runner import Runner
from corpus.sound import Sound

# How many cases there are at least, by hand and drawn.
LEAST = 1000


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return Sound(tmp_path_factory.mktemp("sound"))


@pytest.fixture(scope="module")
def runner():
    with Runner() as found:
        yield found


def problems(family, sound, runner, folder, *, quick):
    """Run the cases of a family, and return what is wrong with them."""
    for command in FAMILIES[family].warm(sound):
        assert runner.warm(*command).status in (0, 3), command
    cases = quick_cases(family, sound) if quick else FAMILIES[family].cases(sound)
    assert cases
    results = [checked(case, runner, folder / "case") for case in cases]
    return [f"{result.case.title}: {result.problem}" for result in results if result.problem]


# What these commands need is compiled in any case. The others compile for half a minute: part of them is slow.
QUICK = ("models", "recordings")


@pytest.mark.parametrize("family", [pytest.param(f, marks=[] if f in QUICK else pytest.mark.slow) for f in FAMILIES])
def test_some_bad_inputs(family, sound, runner, tmp_path):
    assert problems(family, sound, runner, tmp_path, quick=True) == []


@pytest.mark.long
@pytest.mark.parametrize("family", FAMILIES)
def test_all_bad_inputs(family, sound, runner, tmp_path):
    assert problems(family, sound, runner, tmp_path, quick=False) == []


@pytest.mark.slow
def test_the_corpus_is_large_and_its_cases_have_names_of_their_own(sound):
    titles = [case.title for case in all_cases(sound)]
    assert len(titles) >= LEAST
    assert len(set(titles)) == len(titles)
