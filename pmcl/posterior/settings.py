"""The settings of a run as attributes of the posterior, which NetCDF must be able to hold."""

from __future__ import annotations

from typing import Any

import numpy as np

from pmcl.errors import PosteriorError
from pmcl.posterior.compat import Posterior, attributes

__all__ = ["decode_setting", "encode_setting", "settings"]

Setting = str | int | float | bool

_LARGEST_INTEGER = 2**63 - 1


def settings(data: Posterior) -> dict[str, Setting]:
    """Every setting of the run, as Python values.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    dict of str to str, int, float or bool
    """
    return {str(name): decode_setting(value) for name, value in attributes(data).items()}


def encode_setting(name: str, value: Any) -> str | int | float:
    """Write a setting so that a NetCDF attribute can hold it.

    NetCDF has no booleans and no integers beyond 64 bits (which seeds may be): those become text.

    Parameters
    ----------
    name : str
        For the error message.
    value : str, int, float, bool or a NumPy scalar

    Returns
    -------
    str, int or float

    Raises
    ------
    PosteriorError
        If the value is not a scalar.
    """
    plain = value.item() if isinstance(value, np.generic) else value
    if isinstance(plain, bool):
        return "true" if plain else "false"
    if isinstance(plain, int) and abs(plain) > _LARGEST_INTEGER:
        return str(plain)
    if isinstance(plain, str | int | float):
        return plain
    raise PosteriorError(
        f"expected text, a number or a truth value for the setting {name!r} of a run, got "
        f"{type(value).__name__}: store it as text"
    )


def decode_setting(value: Any) -> Setting:
    """Undo :func:`encode_setting`.

    Parameters
    ----------
    value : str, int, float or a NumPy scalar
        As found in a file.

    Returns
    -------
    str, int, float or bool
    """
    plain = value.item() if isinstance(value, np.generic | np.ndarray) and np.size(value) == 1 else value
    if isinstance(plain, np.ndarray):
        return str(plain)  # no setting of pmcl
    if plain in ("true", "false"):
        return bool(plain == "true")
    if isinstance(plain, str) and plain.removeprefix("-").isdecimal() and abs(int(plain)) > _LARGEST_INTEGER:
        return int(plain)
    return plain if isinstance(plain, int | float) else str(plain)
