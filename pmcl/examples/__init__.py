"""Examples to copy and change: data, an effect, a sensor and a statistic of your own.

Each module is one short file that runs as it is, with a simulated robot in place of yours. ``pmcl example`` lists them
and ``pmcl example NAME -o FILE.py`` copies one; nothing else in pmcl uses them.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from importlib.resources import files

from pmcl.errors import PmclError, did_you_mean

__all__ = ["example_names", "example_text"]


def example_names() -> Mapping[str, str]:
    """Return the names of the examples, each with one line about it."""
    texts = {
        path.name.removesuffix(".py"): path.read_text(encoding="utf-8")
        for path in files(__name__).iterdir()
        if path.name.endswith(".py") and not path.name.startswith("_")
    }
    return {name: (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0] for name, text in sorted(texts.items())}


def example_text(name: str) -> str:
    """Return the source of an example.

    Raises
    ------
    PmclError
        When there is no example of that name.
    """
    names = example_names()
    if name not in names:
        advice = did_you_mean(name, names, "'pmcl example' lists them")
        raise PmclError(f"expected the name of an example ({', '.join(names)}), but got '{name}'; {advice}")
    return (files(__name__) / f"{name}.py").read_text(encoding="utf-8")
