"""Plain arrays into a dataset of the file format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from pmcl.logs.schema import FORMAT, LABELS, variables
from pmcl.logs.validation import fail
from pmcl.maps.arrays import as_numbers

__all__ = ["assemble"]


def assemble(
    arrays: Mapping[str, ArrayLike | None],
    attributes: Mapping[str, object],
    where: str,
    landmark_names: Sequence[str] = (),
    of_variables: Mapping[str, Mapping[str, object]] | None = None,
) -> xr.Dataset:
    """Give arrays the dimensions and units that the format names.

    Parameters
    ----------
    arrays : mapping
        From variable names of the format to arrays of the documented shapes; None leaves a variable out.
    attributes : mapping
        Attributes of the log. One that a variable declares, such as ``max_range`` of the ranges, goes to the first
        of the given variables that declares it. None leaves an attribute out.
    where : str
        The call, for messages.
    landmark_names : sequence of str, optional
        Labels of the landmarks.
    of_variables : mapping of str to mapping, optional
        Attributes of single variables, by the variables' names.

    Returns
    -------
    xarray.Dataset
        Not validated beyond shapes.

    Raises
    ------
    LogError
        When an array has no numbers, another number of axes, or disagrees with another about a shared size.
    """
    attrs = {"format": FORMAT, **{key: value for key, value in attributes.items() if value is not None}}
    known = variables(arrays)
    owners: dict[str, str] = {}
    for name, variable in known.items():
        for attribute in variable.attributes:
            if arrays.get(name) is not None or attribute not in owners:
                first = owners.setdefault(attribute, name)
                owners[attribute] = name if arrays.get(first) is None else first
    of_one = {name: attrs.pop(name) for name in owners if name in attrs}
    sizes: dict[str, tuple[int, str]] = {dim: (len(labels), "the format") for dim, labels in LABELS.items()}
    found: dict[str, tuple[tuple[str, ...], NDArray[np.float64], dict[str, object]]] = {}
    for name, variable in known.items():
        value = arrays.get(name)
        if value is None:
            continue
        try:
            array = as_numbers(value)
        except TypeError as problem:
            fail(where, f"expected numbers [{variable.units}] for '{name}', got {problem}: convert them")
        shape = ", ".join(variable.dims)
        if array.ndim != len(variable.dims):
            fail(where, f"expected '{name}' of shape ({shape}), got {array.shape}: reshape it")
        for dim, size in zip(variable.dims, array.shape, strict=True):
            expected, source = sizes.setdefault(dim, (size, f"'{name}'"))
            if size != expected:
                fail(
                    where,
                    f"expected {expected} along '{dim}' in '{name}' ({shape}) because of {source}, got {size}: "
                    "make both agree",
                )
        found[name] = (variable.dims, array, {"units": variable.units, "long_name": variable.long_name})
    for attribute, stated in of_one.items():
        if owners[attribute] in found:
            found[owners[attribute]][2][attribute] = stated
    for name, stated_of_it in (of_variables or {}).items():
        found[name][2].update(stated_of_it)
    coords: dict[str, object] = {}
    if landmark_names:
        coords["landmark"] = list(landmark_names)
    return xr.Dataset(found, coords=coords, attrs=attrs)
