"""Run the corpus and print a table: ``python tests/corpus/run.py [--quick] [FAMILY ...]``."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from corpus.check import checked, summary
from corpus.families import FAMILIES, quick_cases
from corpus.runner import Runner
from corpus.sound import Sound


def main() -> int:
    """Run families, print what is wrong with cases, and the table; return how many have failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("families", nargs="*", metavar="FAMILY", help=", ".join(FAMILIES))
    parser.add_argument("--quick", action="store_true", help="only the part that always runs")
    given = parser.parse_args()
    results = []
    with tempfile.TemporaryDirectory() as folder, Runner() as runner:
        sound = Sound(Path(folder))
        for name in given.families or FAMILIES:
            for command in FAMILIES[name].warm(sound):
                runner.warm(*command)
            for case in quick_cases(name, sound) if given.quick else FAMILIES[name].cases(sound):
                results.append(checked(case, runner, Path(folder) / "case"))
                if results[-1].problem:
                    print(f"{case.title}: {results[-1].problem}\n")
    print(summary(results))
    return sum(bool(result.problem) for result in results)


if __name__ == "__main__":
    sys.exit(main())
