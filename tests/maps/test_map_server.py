"""Maps on disk: the rules of nav2_map_server written a second time, pixel by pixel, and files that are refused."""

import json
import math
import os
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from pmcl.errors import MapError
from pmcl.maps import OccupancyGrid
from pmcl.maps.map_server import occupancy
from pmcl.maps.occupancy_grid import FREE, MOST_CELLS, OCCUPIED, UNKNOWN

USUAL = {"resolution": 0.05, "origin": [-1.0, -2.0, 0.0], "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196}


def write_yaml(folder, image="hall.pgm", name="hall.yaml", **changes):
    keys = {"image": image, **USUAL, **changes}
    lines = [f"{key}: {value}" for key, value in keys.items() if value is not None]
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def write_image(path, pixels):
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(path)
    return path.name


def percentage(px, alpha, mode, negate, occupied_thresh, free_thresh):
    """What nav2_map_server publishes for one grey pixel: -1 unknown, 0 to 100 percent occupied."""
    single = np.float32
    if mode == "raw":
        return px if px <= 100 else -1
    if alpha < 255:
        return -1
    occ = single(px) / single(255)
    occ = occ if negate else single(1) - occ
    if occ <= single(free_thresh):
        return 0
    if occ >= single(occupied_thresh):
        return 100
    if mode == "trinary":
        return -1
    # C++ rounds halves away from zero.
    return math.floor((occ - single(free_thresh)) / (single(occupied_thresh) - single(free_thresh)) * single(100) + 0.5)


@pytest.mark.parametrize("thresholds", [(0.65, 0.196), (0.5, 0.5), (129 / 255, 0.25), (0.1, 0.05), (1.0, 0.0)])
@pytest.mark.parametrize("negate", [False, True])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_every_grey_becomes_what_map_server_makes_of_it(mode, negate, thresholds):
    grey = np.tile(np.arange(256, dtype=np.uint8), (3, 1))
    alpha = np.repeat(np.array([[255], [254], [0]], dtype=np.uint8), 256, axis=1)
    # Localization takes 0 as free, 100 as occupied, and everything else as unknown.
    state = {0: FREE, 100: OCCUPIED}
    expected = [
        [state.get(percentage(px, opacity, mode, negate, *thresholds), UNKNOWN) for px in range(256)]
        for opacity in (255, 254, 0)
    ]
    np.testing.assert_array_equal(occupancy(grey, alpha, mode, negate, *thresholds), expected)
    np.testing.assert_array_equal(occupancy(grey, None, mode, negate, *thresholds), [expected[0]] * 3)
    # Means of colours are no whole numbers, and take another way.
    np.testing.assert_array_equal(occupancy(grey.astype(np.float32), alpha, mode, negate, *thresholds), expected)


def test_the_greys_at_which_nav2s_own_tests_look():
    greys = np.arange(256, dtype=np.uint8)[None]
    trinary = occupancy(greys, None, "trinary", False, 0.65, 0.196)[0]
    assert [trinary[k] for k in (89, 90, 147, 204, 205, 206)] == [OCCUPIED, *[UNKNOWN] * 4, FREE]
    # Compared in double precision, 129/255 would be another number than 1 - 126/255.
    edge = occupancy(np.array([[126, 127]], dtype=np.uint8), None, "trinary", False, 129 / 255, 0.196)
    assert edge.tolist() == [[OCCUPIED, UNKNOWN]]


def test_rows_are_flipped_and_the_yaml_is_taken_at_its_word(tmp_path):
    # Top left is black, bottom right is grey, all else is white.
    name = write_image(tmp_path / "hall.pgm", [[0, 255, 255], [255, 255, 128]])
    grid = OccupancyGrid.read(write_yaml(tmp_path, name, origin=[1.5, -2, 0.25]))
    assert grid.cells.tolist() == [[FREE, FREE, UNKNOWN], [OCCUPIED, FREE, FREE]]
    assert (grid.resolution, grid.origin, grid.source) == (0.05, (1.5, -2.0, 0.25), str(tmp_path / "hall.yaml"))
    negated = OccupancyGrid.read(write_yaml(tmp_path, name, negate="true"))
    assert negated.cells.tolist() == [[OCCUPIED, OCCUPIED, UNKNOWN], [FREE, OCCUPIED, OCCUPIED]]


PIXELS = np.array([[0, 100, 255], [205, 254, 7]], dtype=np.uint8)
CELLS = [[UNKNOWN, FREE, OCCUPIED], [OCCUPIED, UNKNOWN, FREE]]


def plain_pgm(path):
    path.write_text("P2\n# a remark\n3 2\n255\n" + " ".join(map(str, PIXELS.ravel())) + "\n")


def short_scale(path):
    # Greys from 0 to 51 stand for 0 to 255.
    path.write_bytes(b"P5 3 2 51\n" + (PIXELS // 5).astype(np.uint8).tobytes())


def sixteen_bits(path):
    path.write_bytes(b"P5 3 2 65535\n" + (PIXELS.astype(">u2") * 257).tobytes())


def palette(path):
    image = Image.fromarray(PIXELS).convert("P")
    image.save(path)


IMAGES = {
    "plain.pgm": plain_pgm,
    "binary.pgm": lambda path: Image.fromarray(PIXELS).save(path),
    "short.pgm": short_scale,
    "deep.pgm": sixteen_bits,
    "grey.png": lambda path: Image.fromarray(PIXELS).save(path),
    "deep.png": lambda path: Image.fromarray(PIXELS.astype(np.uint16) * 257).save(path),
    "colour.png": lambda path: Image.fromarray(np.repeat(PIXELS[..., None], 3, axis=2)).save(path),
    "palette.png": palette,
    "grey and alpha.png": lambda path: Image.fromarray(np.dstack((PIXELS, np.full_like(PIXELS, 255)))).save(path),
}


@pytest.mark.parametrize("name", IMAGES)
def test_every_kind_of_image_gives_the_same_cells(tmp_path, name):
    IMAGES[name](tmp_path / name)
    assert OccupancyGrid.read(write_yaml(tmp_path, name)).cells.tolist() == CELLS


def test_black_and_white_images_are_read(tmp_path):
    Image.fromarray(np.array([[True, False], [False, True]])).save(tmp_path / "two.png")
    cells = OccupancyGrid.read(write_yaml(tmp_path, "two.png")).cells
    assert cells.tolist() == [[OCCUPIED, FREE], [FREE, OCCUPIED]]


def test_grey_is_the_mean_of_the_colours_and_transparent_pixels_are_unknown(tmp_path):
    # Means 85 (occupied at 0.65) and 89.67 (not), although their luminances are far from that.
    colours = np.array([[[255, 0, 0, 255], [0, 14, 255, 255], [0, 0, 0, 254], [0, 0, 0, 255]]], dtype=np.uint8)
    Image.fromarray(colours).save(tmp_path / "colours.png")
    grid = OccupancyGrid.read(write_yaml(tmp_path, "colours.png"))
    assert grid.cells.tolist() == [[OCCUPIED, UNKNOWN, UNKNOWN, OCCUPIED]]
    transparent = Image.fromarray(PIXELS)
    transparent.save(tmp_path / "clear.png", transparency=0)
    assert OccupancyGrid.read(write_yaml(tmp_path, "clear.png")).cells.tolist() == [CELLS[0], [UNKNOWN, UNKNOWN, FREE]]


def test_what_is_written_is_read_again_bit_for_bit(tmp_path):
    cells = np.random.default_rng(5).integers(0, 3, (17, 29)).astype(np.uint8)
    grid = OccupancyGrid(cells, 1.0 / 3.0, (0.1, -1e-7, -3.0000000000000004), "made")
    for name in ("a map's.yaml", "007.yml", "no.yaml", "hall-2_b.yaml"):
        grid.write(tmp_path / name)
        again = OccupancyGrid.read(tmp_path / name)
        assert again.fingerprint() == grid.fingerprint()
    grid.write(tmp_path / "no.yaml")
    assert len(list(tmp_path.iterdir())) == 8


@pytest.mark.parametrize(("name", "says"), [("hall.pgm", "ends in .yaml"), ("nowhere/hall.yaml", "existing folder")])
def test_a_map_is_not_written_where_it_cannot_be(tmp_path, name, says):
    with pytest.raises(MapError, match=says):
        OccupancyGrid(np.ones((2, 2), dtype=np.uint8), 0.1).write(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [(1500, 1700), (1, 2_200_000), (2_200_000, 1)])
@pytest.mark.parametrize("mode", ["RGB", "PA"])
def test_large_images_are_converted_part_by_part(tmp_path, size, mode):
    """Every part lands in its place, and numbers for grey and opacity are never there for the whole image at once."""
    greys = np.random.default_rng(3).choice(np.array([0, 100, 254], dtype=np.uint8), size)
    image = Image.fromarray(greys).convert("P" if mode == "PA" else mode)
    image.save(tmp_path / "large.png", compress_level=1, **({"transparency": 100} if mode == "PA" else {}))
    path = write_yaml(tmp_path, "large.png")
    tracemalloc.start()
    try:
        cells = OccupancyGrid.read(path).cells
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    expected = np.select([greys == 0, greys == 254], [OCCUPIED, FREE], UNKNOWN)
    np.testing.assert_array_equal(cells, expected[::-1])
    # As numbers for the whole image: 75 MB for the mean of the colours, 10 MB for pixels with opacity.
    assert most < 35e6


def test_links_to_a_map_elsewhere_are_followed(tmp_path):
    # As colcon installs maps with --symlink-install: the YAML file and its image are links into one folder.
    source, installed = tmp_path / "source", tmp_path / "installed"
    source.mkdir()
    installed.mkdir()
    write_image(source / "hall.pgm", PIXELS)
    write_yaml(source)
    for name in ("hall.pgm", "hall.yaml"):
        (installed / name).symlink_to(source / name)
    assert OccupancyGrid.read(installed / "hall.yaml").cells.tolist() == CELLS


def test_numbers_may_be_written_as_map_server_reads_them(tmp_path):
    name = write_image(tmp_path / "hall.pgm", PIXELS)
    path = write_yaml(tmp_path, name, resolution="'5e-2'", origin="[0, 1e1, -0.000]", negate="no", mode="trinary")
    grid = OccupancyGrid.read(path)
    assert (grid.resolution, grid.origin) == (0.05, (0.0, 10.0, 0.0))
    assert grid.cells.tolist() == CELLS


BAD = {
    **{f"no {key}": ({key: None}, f"got no '{key}'") for key in ("image", *USUAL)},
    "an absolute path": ({"image": "/etc/passwd"}, "relative to the YAML file"),
    "a path outside": ({"image": "../secret.pgm"}, "in the folder of the YAML file"),
    "a detour outside": ({"image": "sub/../../secret.pgm"}, "in the folder of the YAML file"),
    "a link outside": ({"image": "link.pgm"}, "in the folder of the YAML file"),
    "no such image": ({"image": "gone.pgm"}, "got no such file"),
    "a folder as image": ({"image": "sub"}, "got no such file"),
    "a list as image": ({"image": "[a, b]"}, "image as the name of a file, got a list"),
    "no side": ({"resolution": 0}, "resolution as a number of at least 0.001 m"),
    "a negative side": ({"resolution": -0.05}, "resolution as a number"),
    "nan": ({"resolution": ".nan"}, "resolution as a finite number"),
    "a huge side": ({"resolution": 1e9}, "at most 10 m"),
    "a side in words": ({"resolution": "fine"}, "finite number, got 'fine'"),
    "a side as truth value": ({"resolution": "true"}, "finite number, got True"),
    "an integer beyond floats": ({"resolution": "1" * 400}, "finite number"),
    "two numbers of origin": ({"origin": "[0, 0]"}, r"three finite numbers \[x, y, yaw\], got \[0, 0\]"),
    "four numbers of origin": ({"origin": "[0, 0, 0, 1]"}, "three finite numbers"),
    "words in origin": ({"origin": "[0, x, 0]"}, r"got \[0, 'x', 0\]"),
    "origin without end": ({"origin": "[0, .inf, 0]"}, r"got \[0, inf, 0\]"),
    "one number of origin": ({"origin": 5}, "three finite numbers"),
    "yaw in degrees": ({"origin": "[0, 0, 90]"}, "convert degrees"),
    "percent": ({"occupied_thresh": 65}, "between 0 and 1"),
    "negative": ({"free_thresh": -0.1}, "between 0 and 1"),
    "swapped": ({"occupied_thresh": 0.2, "free_thresh": 0.65}, "swap them"),
    "mode": ({"mode": "trinari"}, "did you mean 'trinary'"),
    "negate": ({"negate": "perhaps"}, "negate as 0 or 1, got 'perhaps'"),
    "objects": ({"negate": "!!python/object/apply:os.system ['touch owned']"}, "plain texts"),
    "an unknown tag": ({"origin": "!custom [0, 0, 0]"}, "plain texts"),
    "twice": ({"image": "hall.pgm\nresolution: 0.1"}, "cannot be read"),
    "no occupied cell": ({"occupied_thresh": 1.0, "image": "grey.pgm"}, "at least one occupied cell"),
    "nothing known": ({"image": "grey.pgm"}, "100% of 3 x 2 cells are unknown"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_map_is_one_line_that_names_the_file(tmp_path, case, monkeypatch):
    changes, says = BAD[case]
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "maps"
    (folder / "sub").mkdir(parents=True)
    write_image(tmp_path / "secret.pgm", PIXELS)
    (folder / "link.pgm").symlink_to(tmp_path / "secret.pgm")
    write_image(folder / "hall.pgm", PIXELS)
    write_image(folder / "grey.pgm", np.full((2, 3), 128))
    path = write_yaml(folder, **changes)
    with pytest.raises(MapError, match=says) as caught:
        OccupancyGrid.read(path)
    assert str(caught.value).startswith(f"{path}: expected")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "owned").exists()


def png_head(width, height):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")


whole = b"P5 300 200 255\n" + bytes(60000)
IMAGE_FILES = {
    "empty": (b"", "cannot be read"),
    "no image": (b"hello, world\n" * 9, "cannot be read"),
    "truncated": (whole[:-1000], "cannot be read"),
    "truncated head": (whole[:6], "cannot be read"),
    "truncated text": (b"P2 300 200 255\n" + b"0 " * 100, "cannot be read"),
    "words": (b"P2 2 1 255\n0 white\n", "cannot be read"),
    "no pixels": (b"P5 0 0 255\n", "cannot be read"),
    "10^9 cells": (b"P5 40000 25000 255\n", f"at most {MOST_CELLS} pixels"),
    "a little too many": (b"P5 10000 5001 255\n", f"at most {MOST_CELLS} pixels .* 10000 x 5001"),
    "10^9 cells of PNG": (png_head(40000, 25000), f"at most {MOST_CELLS} pixels"),
    "5e7 cells of text": (b"P2 7000 7000 255\n" + b"0 " * 100, "at most 10000000 pixels .* a PGM of text"),
    "5e7 cells of 51 greys": (b"P5 7000 7000 51\n" + bytes(100), "at most 10000000 pixels"),
    "a PNG that ends": (png_head(300, 200), "cannot be read"),
    "a JPEG": (b"\xff\xd8\xff\xe0\x00\x10JFIF" + bytes(100), "PGM or PNG"),
}


@pytest.mark.parametrize("case", IMAGE_FILES)
def test_a_bad_image_is_one_line(tmp_path, case):
    content, says = IMAGE_FILES[case]
    (tmp_path / "hall.pgm").write_bytes(content)
    with pytest.raises(MapError, match=says) as caught:
        OccupancyGrid.read(write_yaml(tmp_path))
    assert str(caught.value).startswith(f"{tmp_path / 'hall.yaml'}: expected")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"just text",
        b"- a\n- list\n",
        b"\xff\xfe\x00binary",
        b"image: [unclosed\n",
        b"P5 3 2 255\n" + bytes(6),
        b"[" * 20000,
        b"a: &a [x, x]\nb: &b [*a, *a]\nimage: [*b, *b]\n",
        b"#" * 100_000,
    ],
    ids=["empty", "text", "list", "binary", "unclosed", "an image", "nested", "aliases", "long"],
)
def test_what_is_no_map_is_one_line(tmp_path, content):
    path = tmp_path / "hall.yaml"
    path.write_bytes(content)
    with pytest.raises(MapError, match=f"^{path}: expected") as caught:
        OccupancyGrid.read(path)
    assert len(str(caught.value)) < 500
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_one_line(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # reading it would wait for a writer
    for path in (tmp_path / "gone.yaml", tmp_path, tmp_path / "pipe"):
        with pytest.raises(MapError, match="expected a map's YAML file"):
            OccupancyGrid.read(path)


_scalars = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=12))
_values = st.recursive(_scalars, lambda inner: st.lists(inner, max_size=4), max_leaves=6)


@settings(max_examples=150, deadline=None)
@given(key=st.sampled_from(["image", "mode", *USUAL]), value=_values)
def test_whatever_a_key_holds_gives_a_map_or_one_line(tmp_path_factory, key, value):
    folder = tmp_path_factory.mktemp("map")
    write_image(folder / "hall.pgm", PIXELS)
    path = write_yaml(folder)
    lines = [line for line in path.read_text().splitlines() if not line.startswith(f"{key}:")]
    path.write_text("\n".join([*lines, f"{key}: {json.dumps(value)}"]))
    problem = ""
    try:
        assert OccupancyGrid.read(path).cells.shape == (2, 3)
    except MapError as error:
        problem = str(error)
    assert not problem or problem.startswith(f"{path}: expected")
    assert "\n" not in problem
