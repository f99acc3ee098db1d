"""Results as CSV, to which rows are added."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path


class Table:
    """A CSV file whose first columns are keys; rows are written as they come."""

    def __init__(self, path: Path, columns: Sequence[str], keys: int) -> None:
        self.path, self.columns, self.keys = path, tuple(columns), keys
        self.known: set[tuple[str, ...]] = set()
        if path.exists():
            with path.open(newline="") as file:
                self.known = {tuple(row[name] for name in self.columns[:keys]) for row in csv.DictReader(file)}

    def knows(self, *key: object) -> bool:
        return tuple(_written(part) for part in key) in self.known

    def add(self, *values: object) -> None:
        row = [_written(value) for value in values]
        assert len(row) == len(self.columns)
        new = not self.path.exists()
        with self.path.open("a", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            if new:
                writer.writerow(self.columns)
            writer.writerow(row)
        self.known.add(tuple(row[: self.keys]))


def _written(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
