"""Bad checkpoints of a run that is to go on."""

from __future__ import annotations

from functools import partial

import h5py
from corpus.cases import Case, cut, flipped
from corpus.logs import SPECIAL, deep, many, nested_raw, nested_virtual
from corpus.sound import Sound
from oracles.changed_checkpoints import changed_checkpoint, with_head

from pmcl.sampling.checkpoint_head import N_BYTES

FAMILY = "checkpoint"

RUN = ["--draws", 4, "--chains", 2, "--particles", 5, "--burn-in-particles", 5]

REFUSED = {
    "an external link": lambda file: file.__setitem__("main2", h5py.ExternalLink("/etc/passwd", "/")),
    "a virtual data set in a group": nested_virtual,
    "external raw storage in a group": nested_raw,
    "a soft link": lambda file: file.__setitem__("again", h5py.SoftLink("/")),
    "a group within itself": lambda file: file.create_group("g").__setitem__("again", file["/"]),
    "groups 200 deep": deep,
    "3000 arrays": many(3000),
    "10^12 cells declared": lambda file: file.create_dataset("big", (10**6, 10**6), "f8", chunks=(99, 99)),
    "a stage without its chain": lambda file: file["draws"].__delitem__("chain"),
    "a stage without steps": lambda file: file["draws"].attrs.__delitem__("iteration"),
    "a stage without its first trajectories": lambda file: file["draws"].__delitem__("first_path"),
    "a stage without its kept trajectories": lambda file: file["draws"].__delitem__("kept_offsets"),
    "steps of text": lambda file: file["draws"].attrs.__setitem__("iteration", "many"),
    "more steps than there are": lambda file: file["draws"].attrs.__setitem__("iteration", 10**9),
}

HEADS = {
    "another run": {"run": "0" * 64},
    "another version": {"layout": 99},
    "a version of text": {"layout": "new"},
    "a version of two": {"layout": "4 4"},
    "a version of 400 digits": {"layout": "4" * 300},
}


def cases(sound: Sound) -> list[Case]:
    """All cases of this family."""

    def resuming(folder):
        return [
            "calibrate",
            sound.walls_log,
            "-o",
            folder / "out.nc",
            "--checkpoint",
            folder / "bad.h5",
            "--resume",
            *RUN,
        ]

    def rewritten(change):
        def make(folder):
            (folder / "bad.h5").write_bytes(sound.checkpoint.read_bytes())
            with changed_checkpoint(folder / "bad.h5") as file:
                change(file)
            return resuming(folder)

        return make

    def damaged(change):
        def make(folder):
            (folder / "bad.h5").write_bytes(change(sound.checkpoint.read_bytes()))
            return resuming(folder)

        return make

    def special(create):
        def make(folder):
            create(folder / "bad.h5")
            return resuming(folder)

        return make

    found = [
        Case(FAMILY, name, rewritten(change), quick=name.startswith(("an ext", "ext", "a virt")))
        for name, change in REFUSED.items()
    ]
    found += [
        Case(FAMILY, name, damaged(lambda content, head=head: with_head(content, **head)), quick=False)
        for name, head in HEADS.items()
    ]
    found.append(Case(FAMILY, "no head", damaged(lambda content: content[N_BYTES:]), quick=True))
    found += [
        Case(FAMILY, name, special(create), quick=False)
        for name, create in SPECIAL.items()
        if name in ("a folder", "a pipe", "a device without end", "text")
    ]
    for k in (0, 3, 6, 8):
        found.append(Case(FAMILY, f"cut {k}", damaged(lambda content, k=k: cut(content, k)), quick=False))
    # By 10 % of the file, where HDF5 keeps its tables, and anywhere.
    for k in range(12):
        part = (0.0, 0.1) if k < 8 else (0.0, 1.0)
        change = partial(flipped, count=30 if k < 10 else 1, number=k, within=part)
        found.append(Case(FAMILY, f"flipped {k}", damaged(change), quick=k in (2, 4)))
    return found


def warm(sound: Sound) -> list[list[object]]:
    """A run that goes on from a sound checkpoint, which is already complete."""
    return [
        [
            "calibrate",
            sound.walls_log,
            "-o",
            sound.folder / "warm_posterior.nc",
            "--checkpoint",
            sound.checkpoint,
            "--resume",
            *RUN,
        ]
    ]
