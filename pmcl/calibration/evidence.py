"""Settings of the methods that work with a particle filter's estimate of the evidence."""

from __future__ import annotations

from typing import Any

from pmcl.calibration.settings import setting

__all__ = ["filter_setting", "particles_setting"]


def particles_setting() -> Any:
    """Declare the number of particles, which is measured where it is left out; an `int` or None."""
    return setting(
        None,
        "Particles of the filter.",
        least=2,
        otherwise="by the measured scatter of the evidence",
        advice="25 to 1000 are usual",
    )


def filter_setting() -> Any:
    """Declare which filter estimates the evidence; a `str`."""
    return setting(
        "guided",
        "guided: the filter draws states near the most probable path of the linearised model, so that few particles "
        "suffice. bootstrap: it draws them from the motion model, as most particle filters do. Both are unbiased.",
        choices=("guided", "bootstrap"),
    )
