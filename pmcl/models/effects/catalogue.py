"""All effects of pmcl itself; :mod:`~pmcl.models.effects.registry` adds those of other packages."""

from __future__ import annotations

from pmcl.models.effects.echoes import ECHO_EFFECTS
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.grip import GRIP_EFFECTS
from pmcl.models.effects.landmarks import LANDMARK_EFFECTS
from pmcl.models.effects.maps import MAP_EFFECTS
from pmcl.models.effects.motion_noise import MOTION_NOISE_EFFECTS
from pmcl.models.effects.mount import MOUNT_EFFECTS
from pmcl.models.effects.odometry import ODOMETRY_EFFECTS
from pmcl.models.effects.range_noise import RANGE_NOISE_EFFECTS
from pmcl.models.effects.ranges import RANGE_EFFECTS

__all__ = ["CATALOGUE"]

CATALOGUE: tuple[Effect, ...] = (
    *ODOMETRY_EFFECTS,
    *MOTION_NOISE_EFFECTS,
    *GRIP_EFFECTS,
    *RANGE_EFFECTS,
    *RANGE_NOISE_EFFECTS,
    *ECHO_EFFECTS,
    *MOUNT_EFFECTS,
    *LANDMARK_EFFECTS,
    *MAP_EFFECTS,
)
"""Every effect once, in its general form."""
