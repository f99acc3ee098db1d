"""Calibration methods by name: pmcl's own and those that others registered. Importing this costs nothing."""

from __future__ import annotations

from typing import Any

from pmcl.calibration.method import CalibrationMethod
from pmcl.errors import SamplingError
from pmcl.registry import METHODS, registered

__all__ = ["as_method", "method_class", "method_names"]


def method_names() -> tuple[str, ...]:
    """Return the names of all methods, pmcl's own first."""
    return tuple(registered(METHODS))


def method_class(name: str) -> type[CalibrationMethod]:
    """Return the class of a method.

    Parameters
    ----------
    name : str
        Its name, such as ``particle-gibbs``.

    Returns
    -------
    type
        A subclass of :class:`~pmcl.calibration.method.CalibrationMethod`.

    Raises
    ------
    SamplingError
        When there is no such method, or what is registered by the name is none.
    """
    known = registered(METHODS)
    if name not in known:
        from pmcl.checks import check_choice

        check_choice("method", name, known, error=SamplingError)
    found = known[name]
    if not (isinstance(found, type) and issubclass(found, CalibrationMethod) and getattr(found, "name", "") == name):
        raise SamplingError(
            f"expected a subclass of CalibrationMethod named '{name}' to be registered as '{name}', but got {found!r}; "
            "repair its registration"
        )
    return found


def as_method(method: Any) -> CalibrationMethod:
    """Return a method as it is, or the method of a name with its default settings.

    Parameters
    ----------
    method : CalibrationMethod or str
        A method, or its name.

    Returns
    -------
    CalibrationMethod

    Raises
    ------
    SamplingError
        When it is neither.
    """
    if isinstance(method, CalibrationMethod):
        return method
    if not isinstance(method, str):
        raise SamplingError(
            f"expected method as a calibration method or its name, but got {type(method).__name__}; write for example "
            "ParticleGibbs(particles=25) or 'ensemble'"
        )
    return method_class(method)()
