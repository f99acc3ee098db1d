"""Checks on the arguments of criticism, before any work is done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pmcl.checks import check_flag, check_memory, check_number, check_seed, check_type, check_whole
from pmcl.errors import CriticismError, LogError, ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import readings
from pmcl.models.effects.effect import Effect
from pmcl.models.robot_model import RobotModel

__all__ = ["check_arguments", "check_other"]

# Least values: with fewer particles or simulated logs the tests have no power (chosen by hand).
_LEAST = {"particles": 50, "simulations": 15, "paths": 1, "rounds": 1, "draws": 1, "workers": 1}
# A log that is held out must have so many rows: two blocks, which give a gain its standard error.
_LEAST_HELD_OUT = 30
# Bytes of a scored pass for each particle and row: state, weight and parent.
_BYTES_PER_PARTICLE = 60.0


def check_arguments(
    logs: Sequence[RobotLog],
    held_out: Any,
    model: Any,
    effects: Any,
    sizes: Mapping[str, Any],
    flags: Mapping[str, Any],
    seed: Any,
    level: Any,
) -> None:
    """Check all arguments of :func:`pmcl.criticism.workflow.criticize`.

    Parameters
    ----------
    logs : sequence of RobotLog
        The logs.
    held_out, model, effects, seed, level : Any
        Arguments of that function.
    sizes : mapping of str to Any
        Its arguments that are whole numbers, by name.
    flags : mapping of str to Any
        Its arguments that are True or False, by name.

    Raises
    ------
    CriticismError, LogError, ModelError
        When one of them cannot be used.
    """
    if held_out is not None:
        check_type("held_out", held_out, RobotLog, error=LogError, advice="read one with pmcl.read_log")
    for name, size in sizes.items():
        if size is not None or name != "workers":
            check_whole(name, size, _LEAST[name], error=CriticismError)
    check_number("level", level, 0.0, 0.5, open_low=True, open_high=True, error=CriticismError, advice="0.05 is usual")
    for name, flag in flags.items():
        check_flag(name, flag, error=CriticismError)
    check_seed(seed, error=CriticismError)
    n_bytes = _BYTES_PER_PARTICLE * float(sizes["particles"]) * sum(log.n_steps for log in logs)
    check_memory("the particles", n_bytes, error=CriticismError, advice="ask for fewer particles")
    if model is not None:
        check_type("model", model, RobotModel, error=ModelError, advice="leave it out for the default model")
    if effects is not None:
        check_type("effects", effects, (list, tuple), error=CriticismError, advice="write a list of effects")
        for effect in effects:
            check_type("each of effects", effect, Effect, error=CriticismError, advice="see pmcl.models.effects")


def check_other(log: RobotLog, other: RobotLog) -> None:
    """Check that a second log can confirm what is found in the first one.

    Parameters
    ----------
    log : RobotLog
        The log on which models are fitted.
    other : RobotLog
        The log that is held out.

    Raises
    ------
    CriticismError
        When it is the same log, is too short, or has other sensors.
    """
    if other.fingerprint() == log.fingerprint():
        raise CriticismError(
            f"expected another log to be held out, but {other.where} holds what {log.where} holds; give a log of "
            "another drive, or none"
        )
    if other.n_steps < _LEAST_HELD_OUT:
        raise CriticismError(
            f"{other.where}: expected at least {_LEAST_HELD_OUT} rows of a log that is held out, but got "
            f"{other.n_steps}; record longer"
        )
    for what, of in (("readings", _readings_of), ("channels and walls", _channels_of)):
        own, its = of(log), of(other)
        if own != its:
            raise CriticismError(
                f"{other.where}: expected the {what} of {log.where}, {', '.join(own)}, but got {', '.join(its)}; hold "
                "out a log of the same robot in the same surroundings"
            )


def _readings_of(log: RobotLog) -> list[str]:
    return sorted(name for name in readings(log.dataset) if name in log.dataset)


def _channels_of(log: RobotLog) -> list[str]:
    of_interest = {"beam": "beams", "landmark": "landmarks", "wall_index": "walls"}
    return [f"{size} {of_interest[name]}" for name, size in sorted(log.dataset.sizes.items()) if name in of_interest]
