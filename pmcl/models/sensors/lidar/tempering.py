"""By how much a scan's log likelihood is tempered: its beams are not independent.

Neighbouring beams share the error of the map, what stands in the way, and the error of the pose within a cell. Taken as
independent, sixty of them make a posterior of the pose far too narrow: on a recorded robot with one and with two lasers
the 95 % ellipse of such a filter held the true position in 29 to 78 % of the rows, in recordings of an office corridor
in 87 and 91 %. Each scan's log likelihood is therefore multiplied by an exponent. What counts is the product of beams
and exponent, the number of independent beams that a scan is worth. ``analyses/lidar_on_real_robots/combining.ipynb``
has the measurements.
"""

from __future__ import annotations

__all__ = ["SCAN_WORTH", "usual_exponent"]

SCAN_WORTH = 2.0
"""Independent beams that the scan of one laser is worth.

Chosen by the coverage of filters on recorded robots; which recordings these were is not known any more, so none of them
counts as an independent judge. Measured afterwards: on the recordings of Jarvis and Wean Hall ellipses of 95 % hold the
true position in 95 to 100 % of the rows, with a worth of 4 in 89 to 98 %. In simulated rooms, whose logs were made
after the choice, a map that is right would allow 4, and one that is wrong by 0.1 m here and there asks for less than
0.5: with 2, 56 % are inside.
"""


def usual_exponent(beams: int) -> float:
    """Return the exponent with which a scan is worth :data:`SCAN_WORTH` beams.

    Parameters
    ----------
    beams : int
        Beams that are read of one scan.

    Returns
    -------
    float
        Between 0 and 1.
    """
    return min(1.0, SCAN_WORTH / max(beams, 1))
