"""The settings of a run as a table of names, values and meanings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

__all__ = ["SettingsTable", "settings_table"]

_MEANINGS = {
    "method": "how the parameters were found",
    "kernel": "how trajectories were drawn",
    "particles": "particles of each trajectory draw",
    "chains": "independent chains",
    "draws": "stored draws of each chain",
    "sweeps_per_draw": "rounds of the sampler between stored draws",
    "trajectories": "stored trajectories of each chain",
    "seed": "all random numbers follow from it",
    "metropolis_steps": "Metropolis updates of each parameter for each trajectory (m in the paper)",
    "transport_moves": "moves of parameters and path together for each trajectory",
    "data_rate": "rows of the log that each sweep of the burn-in adds (r in the paper)",
    "burn_in_particles": "particles while rows are being added",
    "burn_in": "steps before the stored draws",
    "settling_sweeps": "sweeps between adding the last row and tuning",
    "tuning_sweeps": "sweeps of each round that tunes the proposals",
    "tuning_steps": "draws of each stage that teaches the proposals",
    "proposals_per_draw": "proposals between stored draws",
    "blocks": "blocks of random numbers, of which a proposal redraws one",
    "filter": "particle filter that estimates the evidence",
    "move": "how the walkers of an ensemble move",
    "iterations": "steps of the iteration that were made, or the most that it may make",
    "paths": "trajectories of each step of the iteration",
    "evaluations": "runs of the filter that the search may use",
    "discount": "discount factor of the kernels that parameters are drawn from",
    "window": "rows after which the estimate is updated",
    "decay": "factor on what earlier windows told",
    "estimated": "parameters that were estimated; the others have their prior mean",
    "held": "parameters that ended at a limit of what is allowed",
    "oracle": "whether the result rests on the true path, which no robot knows",
    "point_estimate": "whether the result is one estimate and no posterior",
    "restarted_chains": "chains that lost the robot during the burn-in and were started again",
    "impossible_starts": "starting values that were drawn again because no path explained the log",
    "chain_origins": "for each chain, the chain whose beginning it has; another than itself where it was restarted",
    "dependent_chains": "whether the chains are walkers of an ensemble, which depend on each other",
    "dead_sweeps": "sweeps in which every particle was impossible, so that the path stayed",
    "dead_sweeps_while_drawing": "the same, since drawing began",
    "inference_library": "program that wrote the posterior",
    "inference_library_version": "its version",
    "format": "format of the posterior file",
}
_MODEL = "model"
_FINGERPRINT = "log_fingerprint"


class SettingsTable(NamedTuple):
    """Settings ready for a page.

    Attributes
    ----------
    rows : tuple of (str, str, str)
        Name, value and meaning; the most important first.
    model : str
        The model file of the run; empty when the posterior does not hold it.
    """

    rows: tuple[tuple[str, str, str], ...]
    model: str


def settings_table(settings: Mapping[str, object]) -> SettingsTable:
    """Return the settings of a run as a table, the most important first.

    Parameters
    ----------
    settings : mapping of str to scalar
        As :func:`pmcl.posterior.settings.settings` gives them.

    Returns
    -------
    SettingsTable
        Every setting is in it; those without a known meaning come last, by name.
    """
    plain = {name: value for name, value in settings.items() if name != _MODEL}
    known = [name for name in _MEANINGS if name in plain]
    others = sorted(set(plain) - set(known))
    rows = [(name, _text(plain[name]), _meaning(name)) for name in (*known, *others)]
    return SettingsTable(tuple(rows), str(settings.get(_MODEL, "")))


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)


def _meaning(name: str) -> str:
    if name.startswith(_FINGERPRINT):
        number = name.removeprefix(_FINGERPRINT).removeprefix("_")
        return f"hash over all that calibration reads of log {number}" if number else "hash over the log's content"
    return _MEANINGS.get(name, "")
