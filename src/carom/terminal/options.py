"""Arguments and options that several commands share."""

from __future__ import annotations

import re
from contextlib import suppress
from decimal import Decimal
from math import isnan
from pathlib import Path
from typing import Annotated, Any

import typer

from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem

_NO_TIME = f'expected a time, such as 12.5 or "{TIME.example}"'
_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_WORK_TIME = re.compile(r"\s*([0-9.]+(?:e[-+]?[0-9]+)?)\s*(s|min|h|)\s*")
_NUMBER = re.compile(r"\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?)")
PRINTED_DIGITS = 6  # smallest number of digits of a printed time, as `UnitSystem.text` writes them by default
OptionalTime = float | None  # a result of `seconds`, or None


class TypedTime(float):
    """A time as a person typed it: in s if it has a unit, otherwise in the unit of the scene."""

    has_unit = False
    rounding = 0.0  # half a unit of the last given or printed digit, relative to the time


def seconds(text: str | float) -> TypedTime:
    """Parse a time, with or without a unit; a default that is a number is accepted. NaN is refused."""
    text = str(text)
    from carom.scene.units.dimension import UnitError, nearest_float, quantity

    try:
        value = TypedTime(text)
    except ValueError:
        try:
            value = TypedTime(nearest_float(quantity(text, TIME)))
        except UnitError as error:
            starts_as_number = text.lstrip("+-. ")[:1].isdigit()
            raise typer.BadParameter(f"{text}: {error if starts_as_number else _NO_TIME}") from None
        value.has_unit = True
    if isnan(value):
        raise typer.BadParameter(f"{text}: {_NO_TIME}")
    value.rounding = _rounding(text)
    return value


def _rounding(text: str) -> float:
    """Return half a unit of a number's last digit, relative to the number; trailing zeros are not printed."""
    matched = _NUMBER.match(text)
    number = Decimal(matched[1]) if matched else Decimal(0)
    if not number:
        return 0.0
    exponent = number.as_tuple().exponent
    assert isinstance(exponent, int), "the pattern has no NaN and no infinity"
    last = min(exponent, number.adjusted() + 1 - PRINTED_DIGITS)
    return float(Decimal(5).scaleb(last - 1) / abs(number))


def simulated(given: float, units: UnitSystem) -> float:
    """Convert a parsed time to simulated time; a plain number is in the units of the scene."""
    has_unit = isinstance(given, TypedTime) and given.has_unit
    return units.of_si(float(given), TIME) if has_unit else units.converted(float(given), TIME)


def simulated_or_none(given: float | None, units: UnitSystem) -> float | None:
    """Convert a parsed time to simulated time; None stays None."""
    return None if given is None else simulated(given, units)


def work_time(text: str | float) -> float:
    """Parse a limit of computing time (s), such as 60s, 10min or 2h."""
    matched = _WORK_TIME.fullmatch(str(text))
    with suppress(ValueError):
        if matched and float(matched[1]) > 0:
            return float(matched[1]) * _SECONDS[matched[2]]
    raise typer.BadParameter(f"{text}: expected a time such as 60s, 10min or 2h")


def bundled(incomplete: str) -> list[str]:
    """Complete the name of a bundled scene; if none matches, the shell completes files."""
    from carom.scene.scene_file import bundled_scenes, crosscheck_scenes, extreme_scenes

    names = (*bundled_scenes(), *extreme_scenes(), *crosscheck_scenes())
    return [name for name in names if name.startswith(incomplete)]


def not_a_folder(path: Path) -> Path:
    """Return the path of a recording; refuse a folder, since no output can be named after a folder such as ``.``."""
    from carom.errors import RecordingError

    with suppress(OSError):  # for example, a name that is too long is refused only when it is opened
        if path.is_dir():
            raise RecordingError(f"{path}: a folder, not a recording; give an .rrd file")
    return path


def time_option(name: str, help: str, metavar: str = "T") -> Any:
    """Return an option for a simulated time."""
    return typer.Option(name, parser=seconds, metavar=metavar, help=help, show_default=False)


def output_option(metavar: str, help: str) -> Any:
    """Return the option ``-o`` of a command that writes a file or a folder."""
    return typer.Option("-o", "--output", metavar=metavar, help=help)


def recording_option(help: str) -> Any:
    """Return the option ``-o`` of a command that writes a recording, with a name that the viewer recognises."""

    def checked(path: Path | None) -> Path | None:
        from carom.recording.write.whole_file import refuse_name

        if path is not None:
            refuse_name(path)
        return path

    return typer.Option("-o", "--output", metavar="FILE.rrd", help=help, callback=checked)


_SCENE = "A scene file (.toml) or the name of a bundled scene."
SceneArgument = Annotated[str, typer.Argument(metavar="SCENE", help=_SCENE, autocompletion=bundled)]
ScenesArgument = Annotated[
    list[str] | None,
    typer.Argument(metavar="SCENE", help="Scene files (.toml) or names of bundled scenes.", autocompletion=bundled),
]
RecordingsArgument = Annotated[
    list[Path],
    typer.Argument(metavar="FILE...", help="Recordings (.rrd).", callback=lambda files: [*map(not_a_folder, files)]),
]
RecordingArgument = Annotated[Path, typer.Argument(metavar="FILE", help="A recording (.rrd).", callback=not_a_folder)]
_THREADS = "Number of threads; results do not depend on it. Default: one per core."
ThreadsOption = Annotated[int | None, typer.Option("--threads", metavar="N", help=_THREADS, min=1)]
_SET = "Override one key of the scene. Repeatable."
SetOption = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help=_SET)]
OutputOption = Annotated[Path | None, recording_option("File to write. Default: beside FILE, named after it.")]
ForceOption = Annotated[bool, typer.Option("-f", "--force", help="Replace an existing file.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
LiveOption = Annotated[bool, typer.Option("--live", help="Show the run in a viewer window while it is recorded.")]
