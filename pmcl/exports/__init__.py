"""What leaves pmcl: calibrated numbers in the names, units and formulas of the programs that use them.

:mod:`~pmcl.exports.calibration` collects what a posterior says of a robot, and :mod:`~pmcl.exports.export` writes it
for nav2, beluga and ROS 1 AMCL, for ros2_controllers, as static transforms, or as JSON.
:mod:`~pmcl.exports.likelihood_field` and :mod:`~pmcl.exports.beam_model` translate the weights of lidar models,
:mod:`~pmcl.exports.wheels` and :mod:`~pmcl.exports.mounts` turn effects that were found into corrections of a robot's
description. :mod:`~pmcl.exports.mcap_track` writes a localized log for viewers. The files go to the robot and to
Foxglove or rerun.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.exports.export import export_text

__all__ = ["export_text"]

_HOMES = {"export_text": "pmcl.exports.export"}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
