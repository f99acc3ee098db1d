"""Numbers and functions of single numbers that the kernels of several rooms share."""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel

__all__ = ["HALF_LOG_2PI", "LOG_2PI", "TURN", "log_sum", "wrap_angle"]

LOG_2PI = math.log(2.0 * math.pi)
# Minus the log density of a standard normal at zero.
HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
# A full turn [rad].
TURN = 2.0 * math.pi


@kernel
def wrap_angle(angle):
    """Return the same direction in [-pi, pi) [rad]; :func:`pmcl.geometry.wrap` does this for arrays."""
    return angle - TURN * math.floor(angle / TURN + 0.5)


@kernel
def log_sum(a, b):
    """Return log(exp(a) + exp(b)) without overflow; both may be minus infinity."""
    high = max(a, b)
    return high + math.log1p(math.exp(min(a, b) - high)) if high > -math.inf else high
