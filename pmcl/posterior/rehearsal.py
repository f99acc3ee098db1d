"""What comes after sampling, done once before it: hours of draws must not end in an import that fails."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pmcl.errors import PmclError, PosteriorError
from pmcl.posterior.compat import assemble, find_group, save_netcdf, size_of
from pmcl.posterior.convert import ParameterLike, to_arviz
from pmcl.posterior.diagnostics import verdict
from pmcl.posterior.log_groups import LogLike
from pmcl.sampling.chains import Chains
from pmcl.whole_file import replacing

__all__ = ["rehearse"]

# The fewest draws for which R-hat and effective draws are computed.
_CHAINS, _DRAWS = 2, 4
# Groups whose content comes from logs and users; each takes a tenth of a second to write.
_WRITTEN = ("posterior", "observed_data", "constant_data")


def rehearse(
    parameters: Sequence[ParameterLike],
    logs: Sequence[LogLike],
    attributes: Mapping[str, Any],
    place: str | os.PathLike[str] | None = None,
) -> None:
    """Convert, judge and write a handful of made-up draws, and forget them.

    Parameters
    ----------
    parameters : sequence of parameters
        Those of the model that will be calibrated.
    logs : sequence of logs
        Its logs; what else they hold goes into the posterior too.
    attributes : mapping of str to scalar
        Attributes that the posterior will have.
    place : path-like, optional
        A file, beside which the posterior is written and removed again; it is not written when left out.

    Raises
    ------
    PosteriorError
        When any of this fails; the message names what, and nothing has been sampled yet.
    """
    try:
        data = to_arviz(_made_up(parameters, logs, attributes), parameters, logs, prior_draws=_DRAWS)
        verdict(data)
        if place is not None:
            written = assemble({name: find_group(data, name) for name in _WRITTEN}, dict(attributes))
            with replacing(place, n_bytes=size_of(written), keep=False) as temporary:
                save_netcdf(written, temporary)
    except Exception as error:  # whatever a broken installation raises
        raise PosteriorError(
            "expected that draws can be made a posterior and written, which is tried before sampling, got "
            f"{'' if isinstance(error, PmclError) else type(error).__name__ + ': '}{error}; nothing was sampled yet: "
            "mend this first, or use another log or folder"
        ) from error


def _made_up(
    parameters: Sequence[ParameterLike], logs: Sequence[LogLike], attributes: Mapping[str, Any]
) -> Chains:
    medians = np.array([float(parameter.prior.median()) for parameter in parameters])
    scatter = np.random.default_rng(0).uniform(0.9, 1.1, size=(_CHAINS, _DRAWS, len(medians)))
    return Chains(
        names=tuple(parameter.name for parameter in parameters),
        units=tuple(parameter.unit for parameter in parameters),
        theta=np.nan_to_num(medians) * scatter,
        log_joint=np.zeros((_CHAINS, _DRAWS)),
        trajectories=tuple(np.zeros((_CHAINS, 1, log.dataset.sizes["time"], 3)) for log in logs),
        trajectory_draw=np.zeros(1, dtype=np.int64),
        settings=dict(attributes),
    )
