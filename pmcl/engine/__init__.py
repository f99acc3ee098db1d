"""What all compiled code shares: how tables look, what a table must implement, and how it is compiled and kept.

A model turns its parameters into coefficient tables, plain tuples of arrays; compiled loops
(:mod:`pmcl.filtering.kernels`) run over any tables that implement the contract. This package knows no sensor and no
motion: those have rooms of their own under :mod:`pmcl.models`, which register their tables here.

Who writes a table of one's own reads, in this order,

* :mod:`~.tables`: what a table is, its declared axes, and the extras that only effects use;
* :mod:`~.contract`: the functions that a table implements, which of them are optional, and how arrays are laid out;
* :mod:`~.compile`: the decorators ``kernel``, ``entry`` and ``generic``;
* :mod:`~.linear_readings`, and :mod:`~.residuals`: what the transport move, and the Metropolis update of the noises,
  want of a sensor; without them a model still calibrates, more slowly.

Small functions for kernels: :mod:`~.scalars`, :mod:`~.vector_math`, :mod:`~.student`, :mod:`~.random_numbers` and
:mod:`~.views`. The contract's functions for more than one table: :mod:`~.sensor_tuples` (several sensors) and
:mod:`~.parameter_draws` (many draws of the parameters).

How compiled code is made and kept, which only its maintainers need: :mod:`~.functions`, :mod:`~.disk_cache`,
:mod:`~.compile_ahead`, :mod:`~.file_lock` and :mod:`~.progress`.

The names that tables of one's own need can be imported from this package itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.engine.compile import kernel
    from pmcl.engine.contract import (
        NOT_ASKED,
        deviation_of_state,
        draw_start,
        has_reading,
        linear_information,
        linearise_start,
        linearise_transition,
        looks_back,
        one_reading,
        path_reading_logpdf,
        path_transition_logpdf,
        propagate,
        propagate_widely,
        reading_count,
        reading_exponent,
        reading_logpdf,
        reading_slots,
        scratch_rows,
        start_logpdf,
        state_of_deviation,
        state_size,
        states_asked,
        transition_logpdf,
        widens,
    )
    from pmcl.engine.residuals import GaussianSums, sum_of_squares, theta_logpdf
    from pmcl.engine.tables import Axes, NoExtras

__all__ = [
    "NOT_ASKED",
    "Axes",
    "GaussianSums",
    "NoExtras",
    "deviation_of_state",
    "draw_start",
    "has_reading",
    "kernel",
    "linear_information",
    "linearise_start",
    "linearise_transition",
    "looks_back",
    "one_reading",
    "path_reading_logpdf",
    "path_transition_logpdf",
    "propagate",
    "propagate_widely",
    "reading_count",
    "reading_exponent",
    "reading_logpdf",
    "reading_slots",
    "scratch_rows",
    "start_logpdf",
    "state_of_deviation",
    "state_size",
    "states_asked",
    "sum_of_squares",
    "theta_logpdf",
    "transition_logpdf",
    "widens",
]

_HOMES = {
    "kernel": "pmcl.engine.compile",
    "NOT_ASKED": "pmcl.engine.contract",
    "deviation_of_state": "pmcl.engine.contract",
    "draw_start": "pmcl.engine.contract",
    "has_reading": "pmcl.engine.contract",
    "linear_information": "pmcl.engine.contract",
    "linearise_start": "pmcl.engine.contract",
    "linearise_transition": "pmcl.engine.contract",
    "looks_back": "pmcl.engine.contract",
    "one_reading": "pmcl.engine.contract",
    "path_reading_logpdf": "pmcl.engine.contract",
    "path_transition_logpdf": "pmcl.engine.contract",
    "propagate": "pmcl.engine.contract",
    "propagate_widely": "pmcl.engine.contract",
    "reading_count": "pmcl.engine.contract",
    "reading_exponent": "pmcl.engine.contract",
    "reading_logpdf": "pmcl.engine.contract",
    "reading_slots": "pmcl.engine.contract",
    "scratch_rows": "pmcl.engine.contract",
    "start_logpdf": "pmcl.engine.contract",
    "state_of_deviation": "pmcl.engine.contract",
    "state_size": "pmcl.engine.contract",
    "states_asked": "pmcl.engine.contract",
    "transition_logpdf": "pmcl.engine.contract",
    "widens": "pmcl.engine.contract",
    "GaussianSums": "pmcl.engine.residuals",
    "sum_of_squares": "pmcl.engine.residuals",
    "theta_logpdf": "pmcl.engine.residuals",
    "Axes": "pmcl.engine.tables",
    "NoExtras": "pmcl.engine.tables",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
