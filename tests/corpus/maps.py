"""Bad grid maps: YAML files and images."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np
from corpus.cases import EITHER, Case, cut, drawn, flipped
from corpus.sound import Sound
from hypothesis import strategies as st
from PIL import Image

FAMILY = "map"

USUAL = {"image": "room.pgm", "resolution": 0.1, "origin": "[0, 0, 0]", "negate": 0, "occupied_thresh": 0.65,
         "free_thresh": 0.196}  # fmt: skip


def yaml(**changes):
    keys = {**USUAL, **changes}
    return "".join(f"{key}: {value}\n" for key, value in keys.items() if value is not None)


def pixels(mode="L"):
    grey = np.full((60, 60), 254, dtype=np.uint8)
    grey[[0, -1]] = grey[:, [0, -1]] = 0
    return Image.fromarray(grey).convert(mode)


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width, height, *, depth=8, colour=0, data=b"", extra=b""):
    head = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + extra + png_chunk(b"IDAT", zlib.compress(data)) + png_chunk(b"IEND", b"")


KEYS = {
    **{f"no {key}": {key: None} for key in USUAL},
    "resolution of 1e-30": {"resolution": 1e-30},
    "resolution of 1e300": {"resolution": 1e300},
    "resolution of 400 digits": {"resolution": "1" * 400},
    "resolution of nan": {"resolution": ".nan"},
    "resolution in a list": {"resolution": "[0.1]"},
    "origin of 1e300": {"origin": "[1e300, 0, 0]"},
    "origin of words": {"origin": "[here, there, 0]"},
    "origin of a table": {"origin": "{x: 0, y: 0}"},
    "origin nested": {"origin": "[[0], [0], [0]]"},
    "yaw in degrees": {"origin": "[0, 0, 45]"},
    "thresholds in percent": {"occupied_thresh": 65},
    "thresholds swapped": {"occupied_thresh": 0.1, "free_thresh": 0.9},
    "threshold of infinity": {"free_thresh": ".inf"},
    "an unknown mode": {"mode": "binary"},
    "a mode of numbers": {"mode": "[1, 2]"},
    "negate of words": {"negate": "maybe"},
    "objects": {"negate": "!!python/object/apply:os.system ['true']"},
    "a Python name": {"mode": "!!python/name:os.system"},
    "an unknown tag": {"image": "!file room.pgm"},
    "an absolute image": {"image": "/etc/passwd"},
    "an image above": {"image": "../room.pgm"},
    "an image of no file": {"image": "gone.pgm"},
    "an image of a device": {"image": "/dev/zero"},
    "an image with a null": {"image": '"room\\0.pgm"'},
    "an image of 10000 letters": {"image": "x" * 10_000},
    "itself as image": {"image": "bad.yaml"},
    "a pipe as image": {"image": "pipe.pgm"},
    "a folder as image": {"image": "sub"},
    "nothing occupied": {"occupied_thresh": 1.0, "image": "white.pgm"},
    "all unknown": {"image": "grey.pgm"},
}

YAML_FILES = {
    "empty": b"",
    "a null byte": b"\0",
    "a list": b"- a\n- b\n",
    "a number": b"7\n",
    "an image": b"P5 2 2 255\n" + bytes(4),
    "not UTF-8": yaml().encode("utf-16"),
    "nested without end": b"[" * 60_000,
    "maps nested without end": b"{a: " * 10_000,
    "aliases": b"a: &a [x, x, x, x]\n"
    + b"".join(b"%c: &%c [*%c, *%c, *%c]\n" % (k, k, k - 1, k - 1, k - 1) for k in range(98, 118)) + yaml().encode(),
    "aliases as origin": b"a: &a [0, 0, 0]\n" + yaml(origin="*a").encode() + b"image2: &b [*b]\n",
    "merge keys": b"base: &b {image: room.pgm}\n<<: *b\n" + yaml(image=None).encode(),
    "a key twice": yaml().encode() + b"negate: 1\n",
    "100 kB": yaml().encode() + b"# " + b"x" * 100_000,
    "many documents": yaml().encode() + b"---\n" + yaml().encode(),
    "a tab": b"image:\troom.pgm\n\tresolution: 0.1\n",
    "a number of 100 kB digits": yaml(resolution="9" * 50_000).encode(),
    "a sexagesimal number": yaml(resolution="1:30").encode(),
}  # fmt: skip

IMAGES = {
    "empty": b"",
    "text": b"this is no image\n",
    "JPEG": b"\xff\xd8\xff\xe0\x00\x10JFIF" + bytes(50),
    "10^9 cells": b"P5 40000 25000 255\n" + bytes(100),
    "10^18 cells": b"P5 1000000000 1000000000 255\n" + bytes(100),
    "numbers of 100 digits": b"P5 " + b"9" * 100 + b" 1 255\n",
    "5e7 cells of text": b"P2 7000 7000 255\n" + b"0 " * 1000,
    "no cells": b"P5 0 0 255\n",
    "negative width": b"P5 -5 5 255\n" + bytes(25),
    "65536 greys": b"P5 2 2 65536\n" + bytes(8),
    "no greys": b"P5 2 2 0\n" + bytes(4),
    "words for greys": b"P2 2 1 255\nwhite black\n",
    "a comment without end": b"P5 #" + b"x" * 100_000,
    "too short": b"P5 60 60 255\n" + bytes(100),
    "PNG of 10^9 cells": png(40_000, 25_000),
    "PNG of no cells": png(0, 0),
    "PNG without pixels": png(60, 60),
    "PNG of depth 3": png(60, 60, depth=3),
    "PNG of colour 5": png(60, 60, colour=5),
    "PNG with a text that grows": png(
        60, 60, extra=png_chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(10**8))), data=bytes(61 * 60)
    ),
    "PNG without palette": png(60, 60, colour=3, data=bytes(61 * 60)),
    "PNG of a wrong checksum": png(60, 60)[:29] + b"\0\0\0\0" + png(60, 60, data=bytes(61 * 60))[33:],
}

_values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(st.characters(codec="ascii"), max_size=8)),
    lambda inner: st.lists(inner, max_size=4), max_leaves=5,
)  # fmt: skip
_mutation = st.tuples(st.sampled_from([*USUAL, "mode"]), _values)


def reading(sound):
    return lambda folder: ["localize", sound.lidar_log, "--map", folder / "bad.yaml", "--method", "prior",
                           "--particles", 20, "-o", folder / "out.nc"]  # fmt: skip


def cases(sound: Sound) -> list[Case]:
    """All cases of this family."""
    read = reading(sound)

    def of_yaml(content):
        def make(folder):
            pixels().save(folder / "room.pgm")
            Image.fromarray(np.full((9, 9), 255, dtype=np.uint8)).save(folder / "white.pgm")
            Image.fromarray(np.full((9, 9), 128, dtype=np.uint8)).save(folder / "grey.pgm")
            os.mkfifo(folder / "pipe.pgm")
            (folder / "sub").mkdir()
            (folder / "bad.yaml").write_bytes(content)
            return read(folder)

        return make

    def of_image(content, name="room.pgm"):
        def make(folder):
            (folder / name).write_bytes(content)
            (folder / "bad.yaml").write_text(yaml(image=name))
            return read(folder)

        return make

    found = [Case(FAMILY, name, of_yaml(yaml(**changes).encode())) for name, changes in KEYS.items()]
    either = ("aliases", "aliases as origin", "merge keys", "100 kB")
    found += [Case(FAMILY, f"YAML, {name}", of_yaml(content), EITHER if name in either else "refused")
              for name, content in YAML_FILES.items()]  # fmt: skip
    found += [Case(FAMILY, f"image, {name}", of_image(content)) for name, content in IMAGES.items()]
    for k, (key, value) in enumerate(drawn(_mutation, 40)):
        text = yaml(**{key: repr(value) if isinstance(value, str | list) else value})
        found.append(Case(FAMILY, f"{key} of {value!r:.50}, {k}", of_yaml(text.encode()), EITHER, quick=k < 3))
    for k in range(9):
        found.append(Case(FAMILY, f"YAML cut {k}", of_yaml(cut(yaml().encode(), k)), EITHER, quick=False))
    for name, mode in (("room.pgm", "L"), ("room.png", "L"), ("colours.png", "RGBA"), ("palette.png", "P")):

        def content(mode=mode, name=name):
            path = sound.folder / f"sound_{name}"
            pixels(mode).save(path)
            return path.read_bytes()

        whole = content()
        for k in range(7):
            found.append(Case(FAMILY, f"{name} cut {k}", of_image(cut(whole, k), name), EITHER, quick=k == 5))
        for k in range(8):
            damaged = flipped(whole, (1, 3, 30, 1)[k % 4], k, within=(0.0, 0.05 if k % 2 else 1.0))
            found.append(Case(FAMILY, f"{name} flipped {k}", of_image(damaged, name), EITHER, quick=k == 1))
    return found


def warm(sound: Sound) -> list[list[object]]:
    """A command with a sound map."""
    return [["localize", sound.lidar_log, "--map", sound.grid, "--method", "prior", "--particles", 20, "-o",
             sound.folder / "warm.nc"]]  # fmt: skip
