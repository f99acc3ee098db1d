"""What calibration is worth to a lidar robot's filter, and how the beams of a scan should be combined.

    PMCL_DATA=/folder/with/recordings python run.py held_out     # Jarvis: calibrated on one part, judged on the other
    PMCL_DATA=/folder/with/recordings python run.py combining    # sum of cubes, product, tempered product: all logs

Results are CSV files, and the exported parameters. What is there is not computed again.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

DIRECTIONS = (("first", "second"), ("second", "first"))

FULL = {
    "held_out": {
        "kinds": {
            "navigation": ("tempered", "untempered"), "security": ("tempered", "beam"), "both": ("tempered",),
        },
        "directions": DIRECTIONS, "seeds": 24, "draws": 1000, "chains": 4,
    },
    "combining": {
        "groups": (
            ("right map", 4), ("wrong map", 4), ("wean",),
            *(("jarvis", laser, *parts) for laser in ("navigation", "security", "both") for parts in DIRECTIONS),
        ),
        "worths": (0.5, 1.0, 2.0, 4.0, 8.0, 16.0), "seeds": 12, "draws": 600, "chains": 2, "untempered": True,
        "particles": 20_000,
    },
}  # fmt: skip
SMALL = {
    "held_out": {
        "kinds": {"navigation": ("tempered",)}, "directions": (("first", "second"),), "seeds": 4, "draws": 150,
        "chains": 2,
    },
    "combining": {
        "groups": (("right map", 1), ("wrong map", 1)), "worths": (2.0,), "seeds": 6, "draws": 150, "chains": 2,
        "untempered": False, "particles": 1000,
    },
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("experiment", choices=sorted(FULL))
    parser.add_argument("--small", action="store_true", help="a minute instead of an hour")
    parser.add_argument("--output", type=Path, default=HERE, help="folder of the results")
    arguments = parser.parse_args()
    import combining
    import held_out

    experiments = {"held_out": held_out.run, "combining": combining.run}
    settings = (SMALL if arguments.small else FULL)[arguments.experiment]
    experiments[arguments.experiment](arguments.output, **settings)


if __name__ == "__main__":
    main()
