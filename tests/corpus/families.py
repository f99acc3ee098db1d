"""All families of the corpus, by name; each has the functions ``cases`` and ``warm``."""

from __future__ import annotations

from corpus import checkpoints, logs, maps, models, posteriors, recordings
from corpus.cases import Case
from corpus.sound import Sound

__all__ = ["FAMILIES", "all_cases"]

FAMILIES = {
    "logs": logs,
    "maps": maps,
    "models": models,
    "posteriors": posteriors,
    "recordings": recordings,
    "checkpoints": checkpoints,
}


def all_cases(sound: Sound) -> list[Case]:
    """Every case of every family."""
    return [case for family in FAMILIES.values() for case in family.cases(sound)]
