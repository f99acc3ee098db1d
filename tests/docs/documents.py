"""What the documentation shows: code blocks of the README and of docstrings, and how tests make them short."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import shlex
import textwrap
from pathlib import Path

from markdown_it import MarkdownIt

import pmcl

README = Path(__file__).resolve().parents[2] / "README.md"
METHODS = README.parent / "analyses" / "method_comparison" / "README.md"

SHORTER = (
    (
        "pmcl.calibrate(log",
        "pmcl.calibrate(log, method=pmcl.ParticleGibbs(burn_in_particles=100), draws=20, chains=2, seed=1",
    ),
    ("MRCLAM_Dataset6 --robot 1 -o", "MRCLAM_Dataset6 --robot 1 --duration 150 -o"),
    ("--duration 380 -o first.nc", "--duration 120 -o first.nc"),
    ("--begin 380 -o second.nc", "--begin 120 --duration 60 -o second.nc"),
    ("--duration 35 -o jarvis1.nc", "--duration 15 -o jarvis1.nc"),
    ("--begin 35 -o jarvis2.nc", "--begin 15 --duration 15 -o jarvis2.nc"),
    ("--map wean.dat.gz -o", "--map wean.dat.gz --duration 100 -o"),
    ("pmcl calibrate robot1.nc --model", "pmcl calibrate robot1.nc --draws 20 --burn-in-particles 300 --model"),
    ("pmcl criticize robot1.nc", "pmcl criticize robot1.nc --no-joint --rounds 1"),
    ("pmcl criticize first.nc", "pmcl criticize first.nc --rounds 1"),
    ("pmcl criticize steered.nc", "pmcl criticize steered.nc --no-joint"),
    ("pmcl calibrate first.nc", "pmcl calibrate first.nc --draws 100"),
    ("pmcl calibrate started.nc --particles 100 --draws 2500", "pmcl calibrate started.nc --draws 20 --chains 2"),
    ("pmcl calibrate jarvis1.nc", "pmcl calibrate jarvis1.nc --draws 20 --chains 2"),
    ("simulate amigobot --seed", "simulate amigobot --duration 60 --seed"),
    ("pmcl fleet amigobot1.nc", "pmcl fleet --draws 20 --chains 2 --burn-in-particles 100 amigobot1.nc"),
    ("-o steered.nc", "--duration 150 -o steered.nc"),
)
"""The one place that changes what is shown before it is run: settings for which a run takes seconds, not minutes."""

INSTALLATION = "pip install"
"""Commands that begin so are run by .ci/run, which installs pmcl and runs demo and tests with it."""


def shortened(text: str) -> str:
    for shown, run in SHORTER:
        text = text.replace(shown, run)
    return text


def fences(language: str) -> list[str]:
    """The fenced blocks of the README in one language, in order; "" for commands."""
    tokens = MarkdownIt().parse(README.read_text(encoding="utf-8"))
    return [token.content for token in tokens if token.type == "fence" and token.info.strip() == language]


def commands() -> list[str]:
    """The lines of the README's blocks of commands that are not the installation, without their comments."""
    lines = [line.partition("  #")[0].strip() for block in fences("") for line in block.splitlines()]
    return [line for line in lines if line and not line.startswith(INSTALLATION)]


def mentioned_commands() -> list[list[str]]:
    """The arguments of every complete pmcl command in the README and beside it, in blocks and between backticks."""
    text = README.read_text(encoding="utf-8") + METHODS.read_text(encoding="utf-8")
    inline = [found for found in re.findall(r"`(pmcl [a-z][^`]*)`", text) if "COMMAND" not in found]
    parts = [part for line in (*commands(), *inline) for part in re.split(r"&&|>", line)]
    return [shlex.split(part)[1:] for part in parts if part.strip().startswith("pmcl ")]


def documented_objects() -> dict[str, str]:
    """The docstring of every module, public class and public function of pmcl, by dotted name."""
    found = {}
    names = [pmcl.__name__, *(info.name for info in pkgutil.walk_packages(pmcl.__path__, "pmcl."))]
    for module in map(importlib.import_module, names):
        members = {f"{module.__name__}": module}
        for name, value in vars(module).items():
            own = getattr(value, "__module__", None) == module.__name__
            if own and not name.startswith("_") and (inspect.isclass(value) or inspect.isfunction(value)):
                members[f"{module.__name__}.{name}"] = value
                if inspect.isclass(value):
                    public = {k: v for k, v in vars(value).items() if not k.startswith("_")}
                    members |= {f"{module.__name__}.{name}.{k}": v for k, v in public.items() if inspect.isfunction(v)}
        found |= {name: inspect.getdoc(value) or "" for name, value in members.items()}
    return found


def literal_blocks(text: str) -> list[str]:
    """The indented blocks that follow a line that ends in two colons."""
    blocks, lines = [], text.splitlines()
    for k, line in enumerate(lines):
        if not line.rstrip().endswith("::"):
            continue
        margin = len(line) - len(line.lstrip())
        body = []
        for following in lines[k + 1 :]:
            if following.strip() and len(following) - len(following.lstrip()) <= margin:
                break
            body.append(following)
        blocks.append(textwrap.dedent("\n".join(body)).strip("\n"))
    return blocks
