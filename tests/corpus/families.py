"""All families of the corpus, by name; each has the functions ``cases`` and ``warm``."""

from __future__ import annotations

import zlib

from corpus import checkpoints, logs, maps, models, posteriors, recordings
from corpus.cases import Case
from corpus.sound import Sound

__all__ = ["FAMILIES", "all_cases", "quick_cases"]

# Inputs that once ended in a traceback, took gigabytes or a minute, or were accepted; they are always run.
_ONCE_WRONG = (
    "checkpoint: flipped 2",
    "checkpoint: flipped 4",
    "log: format of two numbers",
    "log: odometry of 1e308",
    "log: labels twice",
    "log: true_theta nested without end",
    "log: HDF5, an external link",
    "log: HDF5, a virtual data set in a group",
    "log: HDF5, external raw storage",
    "log: HDF5, 10^12 cells declared",
    "log: HDF5, 3000 variables",
    "log: a foreign variable of 5e8 cells",
    "log: a pipe",
    "map: an image of 10000 letters",
    "map: a pipe as image",
    "model: a shape of 1e308",
    "model: a shape of 500 digits",
    "model: a formula nested without end",
    "model: a beam of a half",
    "recording: mrclam, period of 1e-9",
    "recording: bag, nothing measured",
    "recording: bag, a mount of 1e300",
    "recording: csv, 30 000 unknown columns",
)
# Of the other cases that may always run, one in so many does.
_ONE_IN = 12

FAMILIES = {
    "logs": logs,
    "maps": maps,
    "models": models,
    "posteriors": posteriors,
    "recordings": recordings,
    "checkpoints": checkpoints,
}


def quick_cases(family: str, sound: Sound) -> list[Case]:
    """Return the cases of a family that always run."""
    cases = FAMILIES[family].cases(sound)
    chosen = [case for case in cases if case.quick and zlib.crc32(case.title.encode()) % _ONE_IN == 0]
    return chosen + [case for case in cases if case.title in _ONCE_WRONG and case not in chosen]


def all_cases(sound: Sound) -> list[Case]:
    """Every case of every family."""
    return [case for family in FAMILIES.values() for case in family.cases(sound)]
