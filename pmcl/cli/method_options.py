"""The options of calibration methods: one for each setting of each registered method, so that none is listed here."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import click

from pmcl.calibration.methods import method_class, method_names
from pmcl.calibration.settings import Setting, settings_of

if TYPE_CHECKING:
    import dataclasses

    from pmcl.calibration.method import CalibrationMethod

__all__ = ["MethodCommand", "chosen_method"]


class MethodCommand(click.Command):
    """A command with the option --method, and an option for each setting of each registered method, before --draws.

    They are looked up when the command is used, so that methods of installed packages and of the same process are
    known, and a package that cannot be imported does no harm to other commands.
    """

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the command's own parameters and those of the methods."""
        params = super().get_params(ctx)
        place = [param.name for param in params].index("draws")
        return [*params[:place], _method_option(), *_setting_options(), *params[place:]]


def chosen_method(ctx: click.Context, name: str, given: dict[str, Any]) -> CalibrationMethod:
    """Return the method of a name with the settings that were given on the command line.

    Parameters
    ----------
    ctx : click.Context
        The command, for messages.
    name : str
        Name of the method.
    given : dict of str to object
        Values of the methods' options; None where an option was left out.

    Returns
    -------
    CalibrationMethod

    Raises
    ------
    click.UsageError
        When an option belongs to another method.
    """
    method = method_class(name)
    own = settings_of(method)
    settings = {}
    for setting, value in given.items():
        if value is None:
            continue
        if setting not in own:
            owners = ", ".join(each for each in method_names() if setting in settings_of(method_class(each)))
            raise click.UsageError(f"{_flag(setting)} belongs to the method {owners}: leave it out", ctx)
        option = next(param for param in ctx.command.get_params(ctx) if param.name == setting)
        settings[setting] = value if own[setting].kind is bool else _type(own[setting]).convert(value, option, ctx)
    return method(**settings)


def _method_option() -> click.Option:
    names = method_names()
    descriptions = " ".join(f"{name}: {method_class(name).description}." for name in names)
    text = f"{descriptions} The options that follow are their settings."
    return click.Option(["--method"], type=click.Choice(names), default=names[0], show_default=True, help=text)


def _setting_options() -> list[click.Option]:
    """Return an option for each setting, in the order of the methods."""
    declared: dict[str, dict[str, tuple[Setting, Any]]] = {}
    for name in method_names():
        method = method_class(name)
        fields: dict[str, dataclasses.Field[Any]] = method.__dataclass_fields__
        for setting, declaration in settings_of(method).items():
            if declaration.kind is not tuple:
                declared.setdefault(setting, {})[name] = (declaration, fields[setting].default)
    return [_option(setting, by_method) for setting, by_method in declared.items()]


def _option(name: str, by_method: dict[str, tuple[Setting, Any]]) -> click.Option:
    first, *others = (declaration for declaration, _ in by_method.values())
    flag = _flag(name)
    text = f"{first.help}  [{_default_note(by_method)}]"
    if first.kind is bool:
        return click.Option([f"{flag}/--no-{flag.removeprefix('--')}"], default=None, help=text)
    # The methods may allow different values; each then converts its own.
    same = all(_type(other).to_info_dict() == _type(first).to_info_dict() for other in others)
    return click.Option([flag], type=_type(first) if same else click.STRING, help=text)


def _default_note(by_method: dict[str, tuple[Setting, Any]]) -> str:
    """Return the defaults of a setting, with the names of the methods unless only the default method has it."""
    usual = method_names()[0]
    texts = []
    for name, (declaration, default) in by_method.items():
        shown = ("on" if default else "off") if declaration.kind is bool else str(default)
        text = declaration.otherwise if default is None else shown
        texts.append(text if name == usual else f"{text} for {name}")
    return f"default: {', '.join(texts)}"


def _flag(setting: str) -> str:
    return f"--{setting.replace('_', '-')}"


def _type(setting: Setting) -> Any:
    """Return the type of option that a setting's kind and limits make."""
    if setting.kind is str:
        return click.Choice(setting.choices)
    low = None if setting.least == -math.inf else setting.least
    high = None if setting.most == math.inf else setting.most
    if setting.kind is float:
        return click.FloatRange(low, high)
    if setting.kind is bool:
        return click.BOOL
    return click.IntRange(None if low is None else int(low), None if high is None else int(high))
