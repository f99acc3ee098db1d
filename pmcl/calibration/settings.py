"""How a calibration method declares its settings: once, for Python, the command line and the help of both.

Importing this costs nothing, because the command line reads the settings of all methods before it does any work.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

__all__ = ["Setting", "setting", "settings_of"]

_KEY = "pmcl setting"


@dataclass(frozen=True)
class Setting:
    """What is known of one setting besides its name and default.

    Attributes
    ----------
    help : str
        What it does, in whole sentences.
    kind : type
        int, float, bool, str (one of `choices`), or tuple (of whole numbers; not on the command line).
    least, most : float
        Limits of numbers, both allowed.
    choices : tuple of str
        The values of a text.
    otherwise : str
        What the default None stands for; empty when None is not allowed.
    advice : str
        What to do when a value cannot be used.
    """

    help: str
    kind: type
    least: float
    most: float
    choices: tuple[str, ...]
    otherwise: str
    advice: str

    def check(self, name: str, value: Any) -> None:
        """Raise SamplingError unless a value can be used.

        Parameters
        ----------
        name : str
            Name of the setting, for the message.
        value : object
            The value.

        Raises
        ------
        SamplingError
            When it has another type, or lies beyond the limits.
        """
        from pmcl.checks import check_choice, check_flag, check_number, check_type
        from pmcl.errors import SamplingError

        if value is None and self.otherwise:
            return
        if self.kind is int:
            self._check_whole(name, value)
        elif self.kind is float:
            check_number(name, value, self.least, self.most, error=SamplingError, advice=self.advice)
        elif self.kind is bool:
            check_flag(name, value, error=SamplingError)
        elif self.kind is str:
            check_choice(name, value, self.choices, error=SamplingError)
        else:
            for number in check_type(name, value, tuple, error=SamplingError, advice="write for example (60, 80)"):
                self._check_whole(f"each of {name}", number)

    def _check_whole(self, name: str, value: Any) -> None:
        from pmcl.checks import MOST_COUNT, check_whole
        from pmcl.errors import SamplingError

        least = 0 if self.least == -math.inf else int(self.least)
        most = MOST_COUNT if self.most == math.inf else int(self.most)
        check_whole(name, value, least, most, error=SamplingError, advice=self.advice)


def setting(
    default: Any,
    help: str,
    *,
    kind: type = int,
    least: float = -math.inf,
    most: float = math.inf,
    choices: tuple[str, ...] = (),
    otherwise: str = "",
    advice: str = "choose another",
) -> Any:
    """Declare a setting as the field of a method's dataclass.

    Parameters
    ----------
    default : object
        Its default.
    help, kind, least, most, choices, otherwise, advice
        See :class:`Setting`. With `choices` the kind is a text.

    Returns
    -------
    dataclasses.Field
    """
    declared = Setting(help, str if choices else kind, least, most, choices, otherwise, advice)
    return dataclasses.field(default=default, metadata={_KEY: declared})


def settings_of(method: Any) -> dict[str, Setting]:
    """Return the declared settings of a method or its class, by name; fields without a declaration are left out."""
    return {field.name: field.metadata[_KEY] for field in dataclasses.fields(method) if _KEY in field.metadata}
