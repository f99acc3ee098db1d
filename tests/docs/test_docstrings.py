"""Examples in docstrings run, each with what its text says is at hand."""

from __future__ import annotations

import doctest
import shlex
import tomllib

import click
import numpy as np
import pytest
from docs.documents import documented_objects, literal_blocks, shortened

import pmcl
from pmcl.cli.commands import pmcl as application
from pmcl.examples import own_robot
from pmcl.models.effects import read_effects
from pmcl.simulations import simulate_amigobot

DOCUMENTED = documented_objects()
LITERAL = {f"{name} {k}": block for name, text in DOCUMENTED.items() for k, block in enumerate(literal_blocks(text))}
DOCTESTS = {name: text for name, text in DOCUMENTED.items() if ">>>" in text}
QUICK = {name for name in (*LITERAL, *DOCTESTS) if not name.startswith(("pmcl 0", "pmcl.localization.online"))}


def test_examples_are_found():
    assert "pmcl 0" in LITERAL
    assert "pmcl.localization.online.OnlineLocalizer" in DOCTESTS
    assert len(DOCUMENTED) > 500


@pytest.fixture
def scope(tmp_path, monkeypatch):
    """What examples take for granted: a log, its file, and the streams of a robot, in a folder of their own."""
    monkeypatch.chdir(tmp_path)
    log = simulate_amigobot(60.0)
    log.write("robot.nc")
    own_robot.record(duration=30.0)
    wheel_times, left, right = np.loadtxt("wheels.txt").T
    seen_times, tags, distances, bearings = np.loadtxt("sightings.txt").T
    return {
        "np": np, "log": log, "ranges": log.ranges[0], "landmarks": own_robot.TAGS, "wheel_times": wheel_times,
        "forward": (left + right) / 2, "turn_rate": right - left, "seen_times": seen_times,
        "seen_names": tags.astype(int), "distances": distances, "bearings": bearings,
    }  # fmt: skip


def _marked(names):
    return [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in names]


@pytest.mark.parametrize("name", _marked(LITERAL))
def test_literal_blocks_run(name, scope, tmp_path):
    block = LITERAL[name]
    if block.startswith("pmcl "):  # commands: their options are those of the command line
        for line in block.splitlines():
            command, *arguments = shlex.split(line)[1:]
            main = application.commands[command]
            known = {option for each in main.get_params(click.Context(main)) for option in each.opts}
            for sub in getattr(application.commands[command], "commands", {}).values():
                known |= {option for each in sub.params for option in each.opts}
            assert {word for word in arguments if word.startswith("-")} <= known, line
        return
    if block.startswith("[["):  # part of a model file
        tomllib.loads(block)
        return
    exec(compile(shortened(block), name, "exec"), scope)


@pytest.mark.parametrize("name", _marked(DOCTESTS))
def test_doctests_run(name, scope):
    if "data" in DOCTESTS[name]:
        scope["data"] = pmcl.calibrate(
            scope["log"], method=pmcl.ParticleGibbs(burn_in_particles=100), draws=20, chains=2, seed=1
        )
    example = doctest.DocTestParser().get_doctest(DOCTESTS[name], scope, name, None, 0)
    result = doctest.DocTestRunner().run(example)
    assert result.attempted > 0
    assert result.failed == 0


def test_the_effect_of_the_documentation_is_an_effect(tmp_path):
    """The package's example is a file that --effects takes."""
    path = tmp_path / "documented.py"
    path.write_text(LITERAL["pmcl.models.effects 0"], encoding="utf-8")
    (effect,) = read_effects(path)
    assert effect.name == "torque-steer"
