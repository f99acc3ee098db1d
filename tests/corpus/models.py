"""Bad model files."""

from __future__ import annotations

from corpus.cases import EITHER, Case, cut, drawn, flipped
from corpus.sound import Sound
from hypothesis import strategies as st

FAMILY = "model"


def prior(text, name="sigma_turn"):
    return f"[priors.{name}]\n{text}\n"


def effect(text):
    return f"[[effects]]\n{text}\n"


def formula(terms, more=""):
    return effect(f'name = "formula"\ncarrier = "turn"\nterms = [{terms}]\n{more}')


REFUSED = {
    "no TOML": "sigma_turn: 3\n",
    "a null": 'motion = "\0"\n',
    "an unknown key": "kernel = 1\n",
    "motion of numbers": "motion = [1, 2]\n",
    "motion of another name": 'motion = "tricycle"\n',
    "start of words": 'start = "here"\n',
    "start of two numbers": "[start]\nmean = [0, 0]\n",
    "start at 1e300": "[start]\nmean = [1e300, 0, 0]\nstd = [1, 1, 1]\n",
    "start std of zero": "[start]\nmean = [0.5, 0.5, 0]\nstd = [0, 0, 0]\n",
    "start std of nan": "[start]\nmean = [0.5, 0.5, 0]\nstd = [nan, 1, 1]\n",
    "start of tables": "[start.mean]\nx = 1\n",
    "no sensors": "[sensors]\n",
    "sensors of a number": "sensors = 3\n",
    "a sensor of another name": "[sensors.sonar]\n",
    "a setting of text": '[sensors.range_beams]\noutliers = "yes"\n',
    "an unknown setting": "[sensors.range_beams]\nbeams = 8\n",
    "priors of a list": "priors = [1]\n",
    "an unknown parameter": prior('distribution = "gamma"\na = 2', "sigma_trun"),
    "no distribution": prior("a = 2"),
    "an unknown distribution": prior('distribution = "gama"\na = 2'),
    "a discrete distribution": prior('distribution = "poisson"\nmu = 2'),
    "a module as distribution": prior('distribution = "distributions"'),
    "a private distribution": prior('distribution = "_gamma"\na = 2'),
    "a function as distribution": prior('distribution = "describe"'),
    "a method as distribution": prior('distribution = "rv_continuous"'),
    "no shape": prior('distribution = "gamma"'),
    "an unknown argument": prior('distribution = "gamma"\na = 2\nb = 3'),
    "a shape of text": prior('distribution = "gamma"\na = "two"'),
    "a shape of nan": prior('distribution = "gamma"\na = nan'),
    "a shape of 1e308": prior('distribution = "gamma"\na = 1e308'),
    "a shape of 1e18": prior('distribution = "gamma"\na = 1e18'),
    "a shape of 500 digits": prior(f'distribution = "gamma"\na = {"9" * 500}'),
    "a shape of 10000 digits": prior(f'distribution = "gamma"\na = {"9" * 10_000}'),
    "a negative shape": prior('distribution = "gamma"\na = -2'),
    "a scale of zero": prior('distribution = "gamma"\na = 2\nscale = 0'),
    "a scale of 1e300": prior('distribution = "gamma"\na = 2\nscale = 1e300'),
    "a scale of 1e-320": prior('distribution = "gamma"\na = 1e-300'),
    "a loc below zero": prior('distribution = "norm"\nloc = -5'),
    "a noise that may be negative": prior('distribution = "norm"'),
    "a uniform of no width": prior('distribution = "uniform"\nscale = 0'),
    "a beta of 1e-300": prior('distribution = "beta"\na = 1e-300\nb = 1e-300'),
    "a lognorm of 1e8": prior('distribution = "lognorm"\ns = 1e8'),
    "a power law without end": prior('distribution = "pareto"\nb = 1e-9'),
    "fixed at zero": "[fixed]\nsigma_turn = 0\n",
    "fixed below zero": "[fixed]\nsigma_turn = -1\n",
    "fixed at 1e308": "[fixed]\nsigma_turn = 1e308\n",
    "fixed at text": '[fixed]\nsigma_turn = "small"\n',
    "fixed at a list": "[fixed]\nsigma_turn = [0.1]\n",
    "fixed at 500 digits": f"[fixed]\nsigma_turn = {'9' * 500}\n",
    "fixed and prior": "[fixed]\nsigma_turn = 0.1\n" + prior('distribution = "gamma"\na = 2'),
    "effects of a number": "effects = 3\n",
    "an effect without name": effect("beams = [1]"),
    "an unknown effect": effect('name = "range-bais"'),
    "an effect of a file": effect('name = "/etc/passwd"'),
    "a beam of 1e300": effect('name = "beam-bias"\nbeams = [1e300]'),
    "a beam of -1": effect('name = "beam-bias"\nbeams = [-1]'),
    "a beam of a half": effect('name = "beam-bias"\nbeams = [0.5]'),
    "a beam that is not there": effect('name = "beam-bias"\nbeams = [99]'),
    "no beams": effect('name = "beam-bias"\nbeams = []'),
    "an effect twice": effect('name = "range-bias"') + effect('name = "range-bias"'),
    "a formula without carrier": effect('name = "formula"\nterms = ["time"]'),
    "a formula of nothing": formula(""),
    "a formula of an empty text": formula('""'),
    "a formula of Python": formula("\"__import__('os').system('true')\""),
    "a formula of attributes": formula('"time.__class__"'),
    "a formula of powers": formula('"9**9**9**9**9"'),
    "a formula of a large power": formula('"(10**8)**(10**8)"'),
    "a formula nested without end": formula(f'"{"(" * 3000}time{")" * 3000}"'),
    "a formula of a long sum": formula(f'"{"time+" * 20_000}time"'),
    "a formula of a text": formula("\"'a'*10**9\""),
    "a formula of a list": formula('"[0]*10**9"'),
    "a formula of a lambda": formula('"(lambda: 0)()"'),
    "a formula of 1/0": formula('"1/0"'),
    "a formula of nan": formula('"log(-1-time)"'),
    "a formula of 1e308": formula('"exp(time*1000)"'),
    "a formula of unknown names": formula('"speed_of_light"'),
    "a formula with null": formula('"time\\u0000"'),
    "constants of 1e308": formula('"sin(time/period)"', "constants = { period = 1e308 }"),
    "constants of text": formula('"sin(time/period)"', 'constants = { period = "long" }'),
    "a window that ends before": formula('"sin(time)"', "window = [10.0, 5.0]"),
    "a window of nan": formula('"sin(time)"', "window = [nan, 5.0]"),
    "coefficients of another count": formula('"sin(time)"', 'coefficients = ["a", "b"]'),
    "coefficients of a known name": formula('"sin(time)"', 'coefficients = ["sigma_turn"]'),
    "2 MB": "# " + "x" * 2_000_000 + "\n",
    "arrays nested without end": "a = " + "[" * 50_000 + "\n",
    "tables nested without end": "[" + "a." * 5000 + "a]\nb = 1\n",
    "a key twice": 'motion = "increment"\nmotion = "increment"\n',
    "a date": "[fixed]\nsigma_turn = 2020-01-01\n",
}

ALLOWED = {
    "empty": "",
    "a sensor that the log lacks": "[sensors.landmarks]\n",
    "all fixed": "[fixed]\nsigma_left = 1\nsigma_forward = 1\nsigma_range = 1\nsigma_turn = 1\n",
    "a wide gamma": prior('distribution = "gamma"\na = 0.01\nscale = 100'),
    "a half-Cauchy": prior('distribution = "halfcauchy"\nscale = 0.1'),
    "a power law": prior('distribution = "pareto"\nb = 1'),
    "a narrow gamma": prior('distribution = "gamma"\na = 1e6\nscale = 1e-8'),
    "a tiny scale": prior('distribution = "gamma"\na = 2\nscale = 1e-30'),
    "fixed at 1e-300": "[fixed]\nsigma_turn = 1e-300\n",
    "fixed at 1e8": "[fixed]\nsigma_turn = 1e8\n",
    "a coefficient of dollars": formula('"sin(time)"', 'coefficients = ["$x_{$"]'),
    "a formula called <script>": formula('"sin(time)"').replace('"formula"', '"formula: <script>$"'),
    "start anywhere": 'start = "anywhere"\n',
}

_numbers = st.one_of(st.floats(), st.integers(), st.sampled_from([0.0, 1e-300, 1e300, -1.0, 2, 1e9, 1e10]))
_priors = st.tuples(
    st.sampled_from(
        ["gamma", "lognorm", "norm", "uniform", "beta", "halfnorm", "expon", "invgamma", "t", "levy", "gennorm"]
    ),
    st.dictionaries(st.sampled_from(["a", "b", "s", "df", "beta", "loc", "scale"]), _numbers, max_size=3),
)


def written(number):
    return str(number).lower() if isinstance(number, float) else str(number)


def cases(sound: Sound) -> list[Case]:
    """All cases of this family."""

    def of(content):
        def make(folder):
            (folder / "bad.toml").write_bytes(content if isinstance(content, bytes) else content.encode())
            return ["calibrate", sound.walls_log, "--model", folder / "bad.toml", "--print-model"]

        return make

    def using(folder):
        return [
            "localize",
            sound.walls_log,
            "--model",
            folder / "bad.toml",
            "--method",
            "prior",
            "--particles",
            20,
            "-o",
            folder / "out.nc",
        ]

    found = [Case(FAMILY, name, of(text)) for name, text in REFUSED.items()]
    found += [Case(FAMILY, name, of(text), EITHER, follow=using, quick=False) for name, text in ALLOWED.items()]
    for k, (family, arguments) in enumerate(drawn(_priors, 50)):
        lines = [f'distribution = "{family}"', *(f"{key} = {written(value)}" for key, value in arguments.items())]
        found.append(
            Case(FAMILY, f"{', '.join(lines)}, {k}", of(prior("\n".join(lines))), EITHER, follow=using, quick=k < 3)
        )
    whole = sound.model_text.encode()
    for k in range(9):
        found.append(Case(FAMILY, f"cut {k}", of(cut(whole, k)), EITHER, follow=using, quick=False))
    for k in range(20):
        found.append(
            Case(FAMILY, f"flipped {k}", of(flipped(whole, (1, 3, 10)[k % 3], k)), EITHER, follow=using, quick=k < 2)
        )
    return found


def warm(sound: Sound) -> list[list[object]]:
    """Commands with a sound model."""
    path = sound.folder / "model.toml"
    path.write_text(sound.model_text)
    return [
        ["calibrate", sound.walls_log, "--model", path, "--print-model"],
        [
            "localize",
            sound.walls_log,
            "--model",
            path,
            "--method",
            "prior",
            "--particles",
            20,
            "-o",
            sound.folder / "warm.nc",
        ],
    ]
