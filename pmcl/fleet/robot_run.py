"""The calibration of one robot as a job that can run anywhere."""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pmcl.calibration.workflow import calibrate
from pmcl.fleet.folder import SharedFolder, marked_bytes
from pmcl.fleet.places import Tell
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.carried import EffectFile, carried_effects, restore_effects
from pmcl.models.robot_model import RobotModel
from pmcl.sampling.pool import walker_threads

__all__ = ["RobotRun", "packed"]

# Seconds between two messages of one robot about its progress.
_PAUSE = 2.0


class Packed(tuple[bytes, tuple[EffectFile, ...]]):
    """Logs and models as bytes, with the files of effects without which they could not be unpacked elsewhere."""

    __slots__ = ()

    def unpacked(self) -> Any:
        """Return what was packed."""
        content, effects = self
        restore_effects(effects)
        return pickle.loads(content)


def packed(*content: Any) -> Packed:
    """Pack logs, models and effects for another process.

    Parameters
    ----------
    *content : object
        They come out as a tuple.

    Returns
    -------
    Packed
    """
    return Packed((pickle.dumps(content), carried_effects()))


@dataclass(frozen=True)
class RobotRun:
    """One robot's calibration: called, it returns the bytes of its posterior's file.

    Attributes
    ----------
    name : str
        The robot.
    inputs : Packed
        Logs, model (None for the usual one).
    settings : mapping of str to object
        Further arguments of :func:`pmcl.calibration.workflow.calibrate`.
    key : str
        Mark of the run.
    folder : SharedFolder
        Where the checkpoint goes, for a process that sees it. A robot whose process is lost goes on from there;
        elsewhere it begins anew. The result is the same.
    threads : int
        Threads for its chains.
    """

    name: str
    inputs: Packed
    settings: Mapping[str, Any]
    key: str
    folder: SharedFolder
    threads: int

    def __call__(self, tell: Tell) -> bytes:
        """Calibrate."""
        logs: Sequence[RobotLog]
        model: RobotModel | None
        logs, model = self.inputs.unpacked()
        checkpoint = self.folder.checkpoint(self.name)
        begun = checkpoint is not None and os.path.exists(checkpoint)
        with walker_threads(self.threads) as pool:
            data = calibrate(
                logs, model, pool=pool, checkpoint=checkpoint, resume=begun,
                progress=_Reporter(self.name, tell), **self.settings,
            )  # fmt: skip
        return marked_bytes(data, self.key)


class _Reporter:
    """Tells every few seconds how far a run is, and where each stage begins and ends."""

    def __init__(self, name: str, tell: Tell) -> None:
        self.name, self.tell, self.due = name, tell, 0.0

    def __call__(self, stage: str, step: int, steps: int) -> None:
        now = time.monotonic()
        if now >= self.due or step in (1, steps):
            self.due = now + _PAUSE
            self.tell(self.name, f"{stage} {step}/{steps}")
