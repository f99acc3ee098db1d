"""Tables with a header, comma separated, for recordings of one's own: columns by name, settings as comments above."""

from __future__ import annotations

import csv
import os
import re
from array import array
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import did_you_mean
from pmcl.logs.text_lines import require_short_text
from pmcl.logs.validation import fail

__all__ = ["Table", "read_csv_table"]

Float = NDArray[np.float64]

_SETTING = re.compile(r"#\s*([A-Za-z_][\w ]*?)\s*:\s*(.*\S)\s*$")
_LONGEST_LINE = 1_000_000


@dataclass
class Table:
    """The content of a table.

    Attributes
    ----------
    where : str
        The file, for messages.
    columns : dict of str to array of float
        Numbers by the names of columns; NaN for cells that hold none.
    texts : dict of str to list of str
        Columns of texts.
    lines : array of int
        Number of the line that each row stands in.
    settings : list of (str, str, int)
        Comments ``# name: value``, with the number of their line.
    """

    where: str
    columns: dict[str, array[float]] = field(default_factory=dict)
    texts: dict[str, list[str]] = field(default_factory=dict)
    lines: array[int] = field(default_factory=lambda: array("q"))
    settings: list[tuple[str, str, int]] = field(default_factory=list)
    # The first cell of a column that is neither empty nor a number: its row, and what it holds.
    _unreadable: dict[str, tuple[int, str]] = field(default_factory=dict)

    def add(self, cells: list[str], line: int) -> None:
        """Add a row: a cell for each column, those of numbers and those of texts in the order of the header."""
        row = len(self.lines)
        self.lines.append(line)
        for name, cell in zip(self.columns, cells, strict=True):
            if name in self.texts:
                self.texts[name].append(cell)
                continue
            try:
                number = float(cell) if cell else np.nan
            except ValueError:
                number = np.nan
                self._unreadable.setdefault(name, (row, cell))
            self.columns[name].append(number)

    def numbers(self, name: str, *, may_be_missing: bool = False) -> Float:
        """Return a column as numbers, shape (N,).

        Parameters
        ----------
        name : str
            A column of the table.
        may_be_missing : bool, optional
            Whether a cell may be empty or ``nan`` (not measured), or ``inf``.

        Raises
        ------
        LogError
            With the first cell that is no such number.
        """
        values = np.array(self.columns[name], dtype=np.float64)
        row, came = self._unreadable.get(name, (len(values), ""))
        bad = np.flatnonzero(~np.isfinite(values[:row]))
        if bad.size and not may_be_missing:
            row = int(bad[0])
            came = "" if np.isnan(values[row]) else f"{values[row]}"
        if row < len(values):
            place, got = f"{self.where}, line {self.lines[row]}", f"{came!r:.40}" if came else "none"
            fail(place, f"expected a number in column '{name}', got {got}: correct it")
        return values

    def setting(self, name: str, count: int) -> Float | None:
        """Return the numbers of the setting with a name, shape (count,); None when there is none.

        Raises
        ------
        LogError
            When it is stated twice, or holds something else.
        """
        found = [setting for setting in self.settings if setting[0] == name]
        if not found:
            return None
        if len(found) > 1:
            fail(f"{self.where}, line {found[1][2]}", f"expected '# {name}:' once, got it again: remove one")
        return self.values_of(found[0], count)

    def values_of(self, setting: tuple[str, str, int], count: int) -> Float:
        """Return the numbers of one setting, shape (count,); raises LogError when it holds something else."""
        name, text, line = setting
        try:
            values = np.array([float(word) for word in text.replace(",", " ").split()])
        except ValueError:
            values = np.empty(0)
        if values.shape != (count,) or not np.isfinite(values).all():
            fail(
                f"{self.where}, line {line}", f"expected '# {name}:' with {count} numbers, got {text!r:.60}: correct it"
            )
        return values


def read_csv_table(
    path: str | os.PathLike[str], known_settings: tuple[str, ...] = (), texts: tuple[str, ...] = ()
) -> Table:
    """Read a table: comments, one line with the names of the columns, then rows with a cell for each.

    Parameters
    ----------
    path : path
        The file.
    known_settings : tuple of str, optional
        Names of comments that mean something, as regular expressions; other comments are remarks, unless their name
        looks like a misspelled one.
    texts : tuple of str, optional
        Names of columns that hold texts.

    Returns
    -------
    Table

    Raises
    ------
    LogError
        When the file is missing, empty, too long or no table, or a line has another number of cells than the header.
    """
    where = os.fspath(path)
    if not os.path.isfile(path):
        fail(where, "expected a CSV table, got no such file: check the path")
    table = Table(where)
    names: list[str] = []
    number, length = 0, 0
    try:
        with open(path, encoding="utf-8-sig", newline="") as stream:
            while line := stream.readline(_LONGEST_LINE):
                number += 1
                length += len(line)
                require_short_text(number, length, where)
                place = f"{where}, line {number}"
                if len(line) == _LONGEST_LINE or "\0" in line:
                    fail(place, "expected a line of text, got something else: check the file")
                if line.lstrip().startswith("#"):
                    _add_setting(table, line, number, known_settings)
                    continue
                cells = [cell.strip() for cell in next(csv.reader([line]), [])]
                if not any(cells):
                    continue
                if not names:
                    names = cells
                    _check_names(names, place)
                    table.columns = {name: array("d") for name in names}
                    table.texts = {name: [] for name in names if name in texts}
                    continue
                if len(cells) != len(names):
                    fail(place, f"expected {len(names)} cells, as the header has, got {len(cells)}: correct the line")
                table.add(cells, number)
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        said = getattr(problem, "strerror", None) or str(problem)
        fail(where, f"expected a readable CSV table, got '{said:.80}' after line {number}: check the file")
    if not table.lines:
        fail(where, "expected a header and rows, got none: check the file")
    return table


def _check_names(names: list[str], place: str) -> None:
    count = Counter(names)
    for name in names:
        if not name or count[name] > 1:
            fail(place, f"expected a name of its own for each column, got {name!r:.40}: correct the header")


def _add_setting(table: Table, line: str, number: int, known: tuple[str, ...]) -> None:
    match = _SETTING.match(line.strip())
    if match is None:
        return
    name, text = match[1], match[2]
    if any(re.fullmatch(pattern, name) for pattern in known):
        table.settings.append((name, text, number))
        return
    plain = [pattern for pattern in known if re.fullmatch(r"\w+", pattern)]
    advice = did_you_mean(name, plain, "")
    if advice:
        fail(f"{table.where}, line {number}", f"expected a known setting, got '# {name}:': {advice}")
