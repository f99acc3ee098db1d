"""Missing effects: systematic errors and other noise that a plain model lacks, as edits of coefficient tables.

An :class:`~pmcl.models.effects.effect.Effect` has a name, parameters with priors, and a function that edits the tables
of :mod:`pmcl.models.tables`. In a :class:`~pmcl.models.robot_model.RobotModel` it is calibrated with everything else,
in ``pmcl simulate --effect`` it is simulated, and it is a candidate of the critic.
:mod:`~pmcl.models.effects.catalogue` holds the effects of pmcl, :mod:`~pmcl.models.effects.registry` adds those of
installed packages and of files (``--effects FILE.py``), :mod:`~pmcl.models.effects.selection` picks them by name, and
:mod:`~pmcl.models.effects.formula` makes effects of formulas that are written as text.

An effect of your own is a few lines of numpy. A robot that pulls to one side whenever it accelerates::

    import numpy as np
    from scipy import stats

    from pmcl import Parameter, RobotModel
    from pmcl.models import RangeNoise
    from pmcl.models.effects import Effect

    def pulled(tables, values, log, where):
        (pull,) = values                                       # [rad/m]: turn per change of the forward increment
        mean = tables.motion.mean.copy()
        mean[1:, 2] += pull * np.diff(mean[:, 0])
        return tables._replace(motion=tables.motion._replace(mean=mean))

    torque_steer = Effect(
        name="torque-steer",
        summary="The robot pulls to one side whenever it accelerates.",
        finding="accelerating turns the robot to the {0:left|right} by {0}",
        parameters=(Parameter("torque_steer", "rad/m", stats.norm(scale=0.5)),),
        null=(0.0,),
        change=pulled,
        carrier="motion",
        typical={"clear": (0.5,)},
    )
    model = RobotModel(sensors=(RangeNoise(),), effects=(torque_steer,))

Edits run in order at every proposed theta: keep them cheap, return new arrays and do not change the given ones. They
change the expected value or the distribution of a reading or an increment, never the readings themselves. An effect
that the plain tables cannot express adds extra fields to them first (:mod:`pmcl.models.effects.editing`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.models.effects.catalogue import CATALOGUE
    from pmcl.models.effects.editing import edit_beams, edit_landmarks, edit_motion, edit_sensors
    from pmcl.models.effects.effect import Effect
    from pmcl.models.effects.registry import candidates, known_effects, read_effects, use_effects
    from pmcl.models.effects.selection import effect_named

__all__ = [
    "CATALOGUE",
    "Effect",
    "candidates",
    "edit_beams",
    "edit_landmarks",
    "edit_motion",
    "edit_sensors",
    "effect_named",
    "known_effects",
    "read_effects",
    "use_effects",
]

_HOMES = {
    "CATALOGUE": "pmcl.models.effects.catalogue",
    "Effect": "pmcl.models.effects.effect",
    "candidates": "pmcl.models.effects.registry",
    "edit_beams": "pmcl.models.effects.editing",
    "edit_landmarks": "pmcl.models.effects.editing",
    "edit_motion": "pmcl.models.effects.editing",
    "edit_sensors": "pmcl.models.effects.editing",
    "effect_named": "pmcl.models.effects.selection",
    "known_effects": "pmcl.models.effects.registry",
    "read_effects": "pmcl.models.effects.registry",
    "use_effects": "pmcl.models.effects.registry",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
