"""Robots that exist only as numbers: simulators that log as the real ones do, with the truth beside.

:mod:`~pmcl.robots.simulate` draws paths and readings from coefficient tables, the exact counterpart of the densities in
:mod:`pmcl.filtering.kernels`; :mod:`~pmcl.robots.amigobot` and
:mod:`~pmcl.robots.aibo` are the paper's robots and :mod:`~pmcl.robots.landmark_field` a plain case for tests and
benchmarks. Their logs go wherever recorded logs go.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.robots.aibo import simulate_aibo
    from pmcl.robots.amigobot import simulate_amigobot
    from pmcl.robots.landmark_field import simulate_landmark_field

__all__ = [
    "simulate_aibo",
    "simulate_amigobot",
    "simulate_landmark_field",
]

_HOMES = {
    "simulate_aibo": "pmcl.robots.aibo",
    "simulate_amigobot": "pmcl.robots.amigobot",
    "simulate_landmark_field": "pmcl.robots.landmark_field",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
