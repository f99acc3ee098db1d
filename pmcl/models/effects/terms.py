"""The terms of formulas: arithmetic on what a log tells about each row, written as text.

A term is an expression such as ``sin(2*pi*(time - begins)/period)`` or ``inside(x, 1, 2)*abs(turn_rate)``. It may hold
numbers, ``pi``, named constants, the operators ``+ - * / **``, the functions of :data:`FUNCTIONS` and the variables of
:data:`OF_ROWS` and :data:`OF_BEAMS`. Nothing else is evaluated, so a model file from a stranger can do no harm.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import ModelError, did_you_mean
from pmcl.logs.arrays import LogArrays

__all__ = [
    "FUNCTIONS", "OF_BEAMS", "OF_ROWS", "evaluated", "motion_of_rows", "names_in", "needs_path", "parsed",
    "pose_of_rows",
]  # fmt: skip

Float = NDArray[np.float64]


def _inside(value: Float, low: Float, high: Float) -> Float:
    return ((low <= value) & (value < high)).astype(float)


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": np.abs, "sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp, "log": np.log, "sqrt": np.sqrt,
    "min": np.minimum, "max": np.maximum, "inside": _inside,
}  # fmt: skip
"""Functions of terms; ``inside(value, low, high)`` is 1 where low <= value < high and 0 elsewhere."""

OF_ROWS: dict[str, str] = {
    "time": "time of the row [s]",
    "speed": "length of the odometry increment over its duration [m/s]",
    "turn_rate": "turn of the odometry increment over its duration [rad/s]",
    "heading": "estimated heading [rad], -pi to pi",
    "x": "estimated position [m]",
    "y": "estimated position [m]",
    "x_before": "x of the row before [m]: where a step begins",
    "y_before": "y of the row before [m]",
}
"""Variables that have one value for each row, with meaning and unit."""

OF_BEAMS: dict[str, str] = {
    "distance": "estimated distance from the beam's mount to the wall [m], no more than max_range",
    "incidence": "estimated angle between the beam and the wall's normal [rad], 0 to pi / 2",
    "world_direction": "estimated direction of the beam in the world frame [rad]",
}
"""Variables that have one value for each row and each range beam."""

_LARGEST = np.finfo(float).max
_KNOWN_FROM_ODOMETRY = ("time", "speed", "turn_rate")
_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: operator.pow, ast.USub: operator.neg, ast.UAdd: operator.pos,
}  # fmt: skip


def parsed(text: str, constants: Iterable[str] = ()) -> ast.expr:
    """Parse a term and check that it holds nothing unknown.

    Parameters
    ----------
    text : str
        The term.
    constants : iterable of str
        Names of its constants.

    Raises
    ------
    ModelError
        When the text is no expression, or a name, function or operator in it is unknown.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError) as error:
        reason = getattr(error, "msg", None) or str(error)
        raise ModelError(
            f"expected a term such as 'cos(heading)', but got '{text}', which cannot be read ({reason}); correct it"
        ) from None
    _check(tree, text, {*OF_ROWS, *OF_BEAMS, "pi", *constants})
    return tree


def _check(node: ast.expr, text: str, names: set[str]) -> None:
    if isinstance(node, ast.Name):
        if node.id not in names:
            _unknown("variable", node.id, names, text)
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, bool) or not isinstance(node.value, int | float) or not abs(node.value) < _LARGEST:
            raise ModelError(f"term '{text}': expected finite numbers, but got {ast.unparse(node)}; correct it")
    elif isinstance(node, ast.Call):
        if not isinstance(node.func, ast.Name) or node.func.id not in FUNCTIONS:
            _unknown("function", ast.unparse(node.func), FUNCTIONS, text)
        count = {"min": 2, "max": 2, "inside": 3}.get(node.func.id, 1)
        if len(node.args) != count or node.keywords:
            raise ModelError(
                f"term '{text}': expected {count} argument{'s' if count > 1 else ''} of {node.func.id}, but got "
                f"{len(node.args) + len(node.keywords)}; correct it"
            )
        for argument in node.args:
            _check(argument, text, names)
    elif isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        _check(node.left, text, names)
        _check(node.right, text, names)
    elif isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        _check(node.operand, text, names)
    else:
        raise ModelError(
            f"term '{text}': expected numbers, variables, functions and + - * / **, but got '{ast.unparse(node)}'; "
            "write it with these"
        )


def _unknown(what: str, name: str, known: Iterable[str], text: str) -> NoReturn:
    names = sorted(known)
    advice = did_you_mean(name, names, f"known are {', '.join(names)}")
    raise ModelError(f"term '{text}': expected a known {what}, but got '{name}'; {advice}")


def names_in(term: ast.expr) -> set[str]:
    """Return the names of variables and constants in a term."""
    functions = {id(node.func) for node in ast.walk(term) if isinstance(node, ast.Call)}
    return {node.id for node in ast.walk(term) if isinstance(node, ast.Name) and id(node) not in functions}


def needs_path(term: ast.expr) -> bool:
    """Return whether a term depends on the pose of the robot, and so needs an estimate of its path."""
    return bool(names_in(term) & ({*OF_ROWS, *OF_BEAMS} - set(_KNOWN_FROM_ODOMETRY)))


def motion_of_rows(log: LogArrays) -> dict[str, Float]:
    """Return time [s], speed [m/s] and turn rate [rad/s] of each row, (T,), from times and odometry."""
    times = np.asarray(log.times)
    usual = float(np.median(np.diff(times))) if times.size > 1 else 1.0
    pause = np.diff(times, prepend=times[0] - usual)
    speed = np.hypot(log.odometry[:, 0], log.odometry[:, 1]) / pause
    return {"time": np.array(times), "speed": speed, "turn_rate": log.odometry[:, 2] / pause}


def pose_of_rows(path: Float) -> dict[str, Float]:
    """Return heading [rad], x and y [m] of each row, (T,), and x and y of the row before, from a path (T, >= 3).

    Row 0, into which no step leads, has the last row before it.
    """
    heading = np.mod(path[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    x, y = path[:, 0], path[:, 1]
    return {"heading": heading, "x": x, "y": y, "x_before": np.roll(x, 1), "y_before": np.roll(y, 1)}


def evaluated(term: ast.expr, variables: Mapping[str, Float | float]) -> Float:
    """Return the value of a term.

    Parameters
    ----------
    term : ast.expr
        From :func:`parsed`.
    variables : mapping of str to ndarray or float
        Variables of rows, (T,); variables of beams, (T, B); constants.

    Returns
    -------
    ndarray, shape (T,) or (T, B)
        (T, B) when the term holds a variable of beams; a term of constants alone gives shape ().
    """
    wide = bool(names_in(term) & set(OF_BEAMS))

    def value(node: ast.expr) -> Any:
        if isinstance(node, ast.Constant):
            return np.float64(node.value)  # type: ignore[arg-type]
        if isinstance(node, ast.Name):
            if node.id == "pi":
                return np.pi
            found = variables[node.id]
            return found[:, None] if wide and np.ndim(found) == 1 else found  # type: ignore[index]
        if isinstance(node, ast.Call):
            assert isinstance(node.func, ast.Name)
            return FUNCTIONS[node.func.id](*(value(argument) for argument in node.args))
        if isinstance(node, ast.BinOp):
            return _OPERATORS[type(node.op)](value(node.left), value(node.right))
        assert isinstance(node, ast.UnaryOp)
        return _OPERATORS[type(node.op)](value(node.operand))

    return np.asarray(value(term), dtype=float)
