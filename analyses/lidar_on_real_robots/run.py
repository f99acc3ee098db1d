"""What calibration is worth to a lidar robot's filter, and how the beams of a scan should be combined.

    PMCL_DATA=/folder/with/recordings python run.py held_out      # Jarvis: calibrated on one part, judged on the other

Results are CSV files, and the exported parameters. What is there is not computed again.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

FULL = {
    "held_out": {
        "lasers": ("navigation", "security", "both"), "untempered_lasers": ("navigation", "security"),
        "directions": (("first", "second"), ("second", "first")), "seeds": 24, "draws": 1000, "chains": 4,
    },
}  # fmt: skip
SMALL = {
    "held_out": {
        "lasers": ("navigation",), "untempered_lasers": (), "directions": (("first", "second"),), "seeds": 4,
        "draws": 150, "chains": 2,
    },
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("experiment", choices=sorted(FULL))
    parser.add_argument("--small", action="store_true", help="a minute instead of an hour")
    parser.add_argument("--output", type=Path, default=HERE, help="folder of the results")
    arguments = parser.parse_args()
    import held_out

    experiments = {"held_out": held_out.run}
    settings = (SMALL if arguments.small else FULL)[arguments.experiment]
    experiments[arguments.experiment](arguments.output, **settings)


if __name__ == "__main__":
    main()
