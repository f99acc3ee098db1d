"""Maps on disk as ROS's map_server keeps them: a YAML file and an image.

The rules are those of nav2_map_server (``src/map_io.cpp``, loadMapFromFile), which compares in single precision. With
px the mean of a pixel's colour channels, ``occ = 1 - px/255``, or ``px/255`` when `negate` is set:

* ``trinary``: occupied where ``occ >= occupied_thresh``, free where ``occ <= free_thresh``, else unknown;
* ``scale``: the same, but between the thresholds the cell gets a percentage from 0 to 100, rounded;
* ``raw``: the cell is px itself, a percentage when it is at most 100, else unknown. Thresholds and `negate` do nothing.

In the first two modes a pixel that is not wholly opaque is unknown. Localization takes a percentage of 0 as free and
one of 100 as occupied, and every other one as unknown, as nav2_amcl and beluga do.
"""

from __future__ import annotations

import math
import os
import secrets
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_path
from pmcl.errors import MapError, did_you_mean
from pmcl.maps.occupancy_grid import FREE, MOST_CELLS, OCCUPIED, UNKNOWN, OccupancyGrid

__all__ = ["FREE_THRESH", "OCCUPIED_THRESH", "occupancy", "read_map", "write_map"]

_CellsOf: TypeAlias = Callable[[NDArray[Any], NDArray[np.uint8] | None], NDArray[np.uint8]]

_MODES = ("trinary", "scale", "raw")
# A file of six lines; a larger one is something else, and is not parsed [byte].
_LONGEST_YAML = 65536
# Pixels that are turned into cells at a time: some 10 MB each.
_PIXELS_AT_ONCE = 1 << 20
# Greatest number of pixels of an image that Pillow decodes in Python, at a few million pixels a second.
_MOST_SLOW_PIXELS = 10_000_000
# Truth values in the spellings that map_server's YAML library (yaml-cpp) knows.
_TRUTHS = {"y": True, "yes": True, "true": True, "on": True, "n": False, "no": False, "false": False, "off": False}
# Grey values of write_map are those of map_saver.
_GREYS = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""The thresholds that map_server's documentation gives, and most maps have."""


def read_map(path: str | os.PathLike[str]) -> OccupancyGrid:
    """Read a map as nav2's map_server does.

    Parameters
    ----------
    path : path
        The YAML file, with the keys image, resolution, origin, occupied_thresh, free_thresh and negate, and if you
        like mode. The image is a PGM (text or binary) or PNG in the same folder or below.

    Returns
    -------
    OccupancyGrid
        Its `source` is the path.

    Raises
    ------
    MapError
        When a file is missing or damaged, a key is missing or impossible, the image lies outside the folder, the image
        has more than :data:`~pmcl.maps.occupancy_grid.MOST_CELLS` pixels, or no cell is occupied. The size is checked
        before the image is decoded.
    """
    where = check_path("path of the map", path, error=MapError)
    said = _read_yaml(where)
    mode = str(said.get("mode", "trinary"))
    if mode not in _MODES:
        advice = did_you_mean(mode, _MODES, "choose one of them")
        raise MapError(f"{where}: expected mode as one of {', '.join(_MODES)}, got '{mode:.40}': {advice}")
    negate = _truth(said, where)
    occupied_thresh = _number(said, "occupied_thresh", where)
    free_thresh = _number(said, "free_thresh", where)
    for name, value in (("occupied_thresh", occupied_thresh), ("free_thresh", free_thresh)):
        if not 0.0 <= value <= 1.0:
            raise MapError(f"{where}: expected {name} between 0 and 1, got {value:g}: write a probability")
    if free_thresh > occupied_thresh:
        raise MapError(
            f"{where}: expected free_thresh <= occupied_thresh, got {free_thresh:g} > {occupied_thresh:g}: swap them"
        )
    resolution = _number(said, "resolution", where)
    origin = _origin(said, where)
    # Images begin at the top, maps at the bottom.
    cells = _read_image(
        _image_path(said, where),
        lambda grey, alpha: occupancy(grey, alpha, mode, negate, occupied_thresh, free_thresh),
        where,
    )[::-1]
    cells = np.ascontiguousarray(cells)
    cells.flags.writeable = False
    return OccupancyGrid(cells, resolution, origin, where)


def occupancy(
    grey: NDArray[Any],
    alpha: NDArray[np.uint8] | None,
    mode: str,
    negate: bool,
    occupied_thresh: float,
    free_thresh: float,
) -> NDArray[np.uint8]:
    """Turn pixels into cells, by the rules of this module.

    Parameters
    ----------
    grey : ndarray, shape (H, W)
        Mean of each pixel's colour channels, 0 (black) to 255 (white): whole numbers, or whole thirds of three colours.
    alpha : ndarray of uint8, shape (H, W), or None
        Opacity of each pixel, 255 opaque; None where the image has none.
    mode : {"trinary", "scale", "raw"}
        How grey becomes occupancy.
    negate : bool
        Whether white is occupied.
    occupied_thresh, free_thresh : float
        Thresholds of the probability of being occupied.

    Returns
    -------
    ndarray of uint8, shape (H, W)
    """
    # There are few greys: the rules are worked out once for each.
    if grey.dtype == np.uint8:
        greys, index = np.arange(256, dtype=np.float32), grey
    else:
        greys = np.arange(3 * 255 + 1, dtype=np.float32) / np.float32(3.0)
        index = np.rint(grey * 3.0).astype(np.uint16)
    found = _cells_of(greys, mode, negate, np.float32(occupied_thresh), np.float32(free_thresh))
    cells: NDArray[np.uint8] = found[index]
    if alpha is not None and mode != "raw":
        cells[alpha < 255] = UNKNOWN
    return cells


def _cells_of(
    greys: NDArray[np.float32], mode: str, negate: bool, occupied_thresh: np.float32, free_thresh: np.float32
) -> NDArray[np.uint8]:
    if mode == "raw":
        percent = np.floor(greys)
        return np.select([percent == 0, percent == 100], [FREE, OCCUPIED], UNKNOWN).astype(np.uint8)
    occ = greys / np.float32(255.0)
    if not negate:
        occ = np.float32(1.0) - occ
    # Free is written last in map_server: it wins where both thresholds are equal.
    free, occupied = occ <= free_thresh, occ >= occupied_thresh
    if mode == "scale":
        between = ~free & ~occupied
        span = np.where(between, occupied_thresh - free_thresh, np.float32(1.0))
        percent = np.floor((occ - free_thresh) / span * np.float32(100.0) + np.float32(0.5))
        free |= between & (percent == 0)
        occupied |= between & (percent == 100)
    return np.select([free, occupied], [FREE, OCCUPIED], UNKNOWN).astype(np.uint8)


def _read_yaml(where: str) -> dict[str, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.constructor import ConstructorError

    if os.path.exists(where) and not os.path.isfile(where):
        # A folder has nothing to read, and a pipe that nobody writes to would be waited for without end.
        raise MapError(f"{where}: expected a map's YAML file, got something that is no file: check the path")
    try:
        with open(where, "rb") as stream:
            raw = stream.read(_LONGEST_YAML + 1)
    except OSError as problem:
        advice = "check the path" if isinstance(problem, FileNotFoundError) else "check the path and its permissions"
        raise MapError(f"{where}: expected a map's YAML file, got '{problem.strerror}': {advice}") from None
    advice = "give the YAML file of a map_server map, not its image"
    if len(raw) > _LONGEST_YAML:
        raise MapError(f"{where}: expected a map's YAML file, got one of more than {_LONGEST_YAML} bytes: {advice}")
    try:
        said = YAML(typ="safe", pure=True).load(raw.decode("utf-8"))
    except ConstructorError as problem:
        raise MapError(
            f"{where}: expected plain texts, numbers and lists, got '{problem.problem}': remove what is not needed"
        ) from None
    except Exception as problem:  # the parser answers damaged input with whatever error the damage leads it to
        text = " ".join(str(problem).split())[:200] or type(problem).__name__
        raise MapError(f"{where}: expected a map's YAML file, got one that cannot be read ({text}): {advice}") from None
    if not isinstance(said, dict):
        raise MapError(f"{where}: expected keys such as 'image' in the map's YAML file, got none: {advice}")
    missing = [name for name in ("image", "resolution", "origin", "occupied_thresh", "free_thresh", "negate")
               if said.get(name) is None]  # fmt: skip
    if missing:
        raise MapError(
            f"{where}: expected the keys image, resolution, origin, occupied_thresh, free_thresh and negate, got no "
            f"'{missing[0]}': add it as map_server needs it"
        )
    return said


def _kind(value: Any) -> str:
    """Say what came in one short line; lists and tables may be nested without end."""
    return f"{value!r:.60}" if isinstance(value, str | int | float | bool) else f"a {type(value).__name__}"


def _as_float(value: Any) -> float:
    """Return a number, also from text that spells one; NaN for everything else."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return math.nan
    try:
        return float(value)
    except (ValueError, OverflowError):
        return math.nan


def _number(said: dict[str, Any], name: str, where: str) -> float:
    number = _as_float(said[name])
    if not math.isfinite(number):
        raise MapError(f"{where}: expected {name} as a finite number, got {_kind(said[name])}: correct it")
    return number


def _origin(said: dict[str, Any], where: str) -> tuple[float, float, float]:
    given = said["origin"]
    values = [_as_float(value) for value in given[:4]] if isinstance(given, list) else []
    if len(values) != 3 or not all(map(math.isfinite, values)):
        came = _kind(given)
        if isinstance(given, list):
            came = f"[{', '.join(_kind(value) for value in given)}]" if len(given) < 5 else f"a list of {len(given)}"
        raise MapError(f"{where}: expected origin as three finite numbers [x, y, yaw], got {came}: correct it")
    return values[0], values[1], values[2]


def _truth(said: dict[str, Any], where: str) -> bool:
    given = said["negate"]
    if isinstance(given, bool | int):
        return bool(given)
    if isinstance(given, str) and given.lower() in _TRUTHS:
        return _TRUTHS[given.lower()]
    raise MapError(f"{where}: expected negate as 0 or 1, got {_kind(given)}: correct it")


def _image_path(said: dict[str, Any], where: str) -> Path:
    """Return the image's path; a map from elsewhere must not make pmcl read other files of this machine."""
    given = said["image"]
    if not isinstance(given, str) or not given or "\0" in given:
        raise MapError(f"{where}: expected image as the name of a file, got {_kind(given)}: correct it")
    file = Path(where)
    advice = "copy the image beside the YAML file and name it without a folder"
    if Path(given).is_absolute():
        raise MapError(f"{where}: expected image as a path relative to the YAML file, got {given:.100}: {advice}")
    # Where the YAML file is a link, its image may be a link to the same place.
    folders = {file.parent.resolve(), file.resolve().parent}
    image = file.parent / given
    try:
        inside = any(image.resolve().is_relative_to(folder) for folder in folders)
        is_file = image.is_file()
    except (OSError, RuntimeError, ValueError):  # a link in a circle, a name that is too long
        inside = is_file = False
    if not inside:
        raise MapError(f"{where}: expected image in the folder of the YAML file or below, got {given:.100}: {advice}")
    if not is_file:
        raise MapError(f"{where}: expected the image {given:.100} in its folder, got no such file: copy it there")
    return image


def _read_image(path: Path, cells_of: _CellsOf, where: str) -> NDArray[np.uint8]:
    """Return the cells of an image, shape (H, W), top row first; `cells_of` makes cells of grey and opacity."""
    from PIL import Image

    name = path.name
    try:
        with warnings.catch_warnings():
            # Pillow warns of large images; here they have a limit of their own, checked before anything is decoded.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path, formats=("PPM", "PNG")) as image:
                width, height = image.size
                # Pillow decodes these two kinds of PGM in Python: those written as text, and those of few greys.
                slow = image.tile[0][0] in ("ppm_plain", "ppm")
                most = _MOST_SLOW_PIXELS if slow else MOST_CELLS
                if width * height > most:
                    kind = ", which is a PGM of text or of another number of greys than 256" * slow
                    raise MapError(_too_large(where, name + kind, most, f"{width} x {height}"))
                return _cells_by_parts(image, cells_of)
    except MapError:
        raise
    except Image.DecompressionBombError:
        raise MapError(_too_large(where, name, MOST_CELLS, "far more")) from None
    except MemoryError:
        raise
    except Exception as problem:  # damaged images end in whatever error their damaged bytes lead to
        text = " ".join(str(problem).split())[:200] or type(problem).__name__
        raise MapError(
            f"{where}: expected the image {name} as PGM or PNG, got one that cannot be read ({text}): "
            "write or copy it again"
        ) from None


def _cells_by_parts(image: Any, cells_of: _CellsOf) -> NDArray[np.uint8]:
    """Convert an image part by part: as grey numbers it takes many times the memory that its pixels take."""
    image.load()
    if image.mode in ("P", "PA") and image.palette is None:
        raise ValueError("its colours are in a palette that it does not have")
    width, height = image.size
    cells = np.empty((height, width), dtype=np.uint8)
    across = min(width, _PIXELS_AT_ONCE)
    down = _PIXELS_AT_ONCE // max(across, 1)
    for top in range(0, height, down):
        for left in range(0, width, across):
            part = image.crop((left, top, min(left + across, width), min(top + down, height)))
            cells[top : top + down, left : left + across] = cells_of(*_channels(part))
    return cells


def _too_large(where: str, name: str, most: int, got: str) -> str:
    return (
        f"{where}: expected at most {most} pixels in the image {name}, got {got}: "
        "write it as PNG, cut the map, or make its cells larger"
    )


def _channels(image: Any) -> tuple[NDArray[Any], NDArray[np.uint8] | None]:
    """Return the mean of the colour channels, 0 to 255, and the opacity where the image has one."""
    if image.mode.startswith("I"):
        # 16 bits: brought to 8 as image libraries do.
        return np.rint(np.asarray(image, dtype=np.float64) / 257.0).astype(np.uint8), None
    has_alpha = image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info
    grey_only = image.mode in ("1", "L", "LA") and not (has_alpha and image.mode == "1")
    wanted = ("LA" if grey_only else "RGBA") if has_alpha else ("L" if grey_only else "RGB")
    pixels = np.asarray(image.convert(wanted) if image.mode != wanted else image)
    if wanted == "L":
        return pixels, None
    alpha = np.ascontiguousarray(pixels[..., -1]) if has_alpha else None
    if wanted == "LA":
        return np.ascontiguousarray(pixels[..., 0]), alpha
    grey = pixels[..., :3].sum(axis=-1, dtype=np.uint16)
    return grey.astype(np.float32) / np.float32(3.0), alpha


def write_map(grid: OccupancyGrid, path: str | os.PathLike[str]) -> None:
    """Write a grid as a map_server pair: see :meth:`~pmcl.maps.occupancy_grid.OccupancyGrid.write`.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    path : path
        The YAML file to write; the image is written beside it, with the ending ``.pgm``.

    Raises
    ------
    MapError
        When the path does not end in .yaml or .yml, or its folder does not exist.
    """
    from PIL import Image

    file = Path(check_path("path of the map", path, error=MapError))
    where = os.fspath(file)
    if file.suffix not in (".yaml", ".yml"):
        raise MapError(f"{where}: expected a file name that ends in .yaml, got '{file.name}': add the ending")
    if not file.parent.is_dir():
        raise MapError(f"{where}: expected a path in an existing folder, got none there: create the folder")
    image = file.with_suffix(".pgm")
    table = np.array([_GREYS[state] for state in (FREE, OCCUPIED, UNKNOWN)], dtype=np.uint8)
    x, y, yaw = grid.origin
    text = (
        f"image: {_quoted(image.name)}\nmode: trinary\nresolution: {grid.resolution!r}\n"
        f"origin: [{x!r}, {y!r}, {yaw!r}]\n"
        f"negate: 0\noccupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n"
    )
    parts = [target.with_name(f".{target.name}.{secrets.token_hex(4)}.part") for target in (image, file)]
    try:
        Image.fromarray(np.ascontiguousarray(table[grid.cells[::-1]])).save(parts[0], format="PPM")
        parts[1].write_text(text, encoding="utf-8")
        os.replace(parts[0], image)
        os.replace(parts[1], file)
    except OSError as problem:
        raise MapError(
            f"{where}: expected to write a map, got '{problem.strerror or problem}': check space and permissions"
        ) from problem
    finally:
        for part in parts:
            part.unlink(missing_ok=True)


def _quoted(name: str) -> str:
    """Write a text as YAML: plain where that is safe, else in single quotes."""
    plain = name.replace("_", "").replace("-", "").replace(".", "").isalnum() and name[0].isalpha()
    return name if plain and name.isascii() else "'" + name.replace("'", "''") + "'"
