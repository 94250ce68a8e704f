"""The parts of installed packages that a scene uses, their names in a recording, and the missing parts."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping
from typing import Any

from carom import registry
from carom.scene.scene_model import SceneModel
from carom.scene.wording import MOST_QUOTED, in_one_line

PROPERTY = "extension."  # prefix of the properties with a part's package and version; kind.name follows


def extensions_of(scene: SceneModel) -> dict[str, str]:
    """Return the package and version of each part that a scene uses from installed packages, by kind.name."""
    used: dict[str, Iterable[str]] = {
        "forces": scene.forces.given,
        "contact_laws": scene.contact.laws,
        "walls": (wall.shape for wall in scene.wall),
        "series": scene.record.series,
        "integrators": (scene.time.integrator,),
    }
    found = {f"{kind}.{name}": registry.origin(kind, name) for kind, names in used.items() for name in names}
    return {key: f"{origin.package} {origin.version}" for key, origin in found.items() if origin}


def stamped(properties: Mapping[str, Any]) -> dict[str, str]:
    """Return the result of `extensions_of` for the scene of a recording, from its properties."""
    known = {key.removeprefix(PROPERTY): str(value) for key, value in properties.items() if key.startswith(PROPERTY)}
    return dict(sorted(known.items()))


def of_extensions(extensions: Mapping[str, str]) -> dict[str, str]:
    """Return the version of each package, given packages and versions as in `extensions_of`."""
    return {name: number for name, _, number in (package.rpartition(" ") for package in extensions.values())}


def names_of(kind: str, extensions: Mapping[str, str]) -> list[str]:
    """Return the names of the parts of a kind."""
    return [key.removeprefix(f"{kind}.") for key in extensions if key.startswith(f"{kind}.")]


# A public version in its normal form (https://packaging.python.org/en/latest/specifications/version-specifiers/). The
# text comes from a stranger and enters a command, so only such a version is repeated in the command. No index accepts a
# local version, such as "1.0+mine".
_NUMBER = "(?:0|[1-9][0-9]{0,8})"  # at most 9 digits, since a date as a version (20240906) has 8
RELEASE = re.compile(
    rf"{_NUMBER}(?:\.{_NUMBER}){{0,4}}(?:(?:a|b|rc){_NUMBER})?(?:\.post{_NUMBER})?(?:\.dev{_NUMBER})?", re.ASCII
)
_DISTRIBUTION = re.compile(rf"([A-Za-z0-9](?:[A-Za-z0-9._-]{{0,98}}[A-Za-z0-9])?) ({RELEASE.pattern})", re.ASCII)


def missing(extensions: Mapping[str, str]) -> str:
    """Return a sentence about the packages of missing parts of a recording; empty if none is missing.

    The names come from the file. Anybody can register a name with an index of packages. The sentence therefore says
    that the names come from the recording. Its command contains a package and version only if they are valid.
    """
    lost: dict[str, list[str]] = {}
    for key, package in extensions.items():
        kind, _, name = key.partition(".")
        if kind in registry.KINDS and name not in registry.installed(kind):
            lost.setdefault(package, []).append(f'the {registry.KINDS[kind]} "{in_one_line(name)}"')
    return "; ".join(f"it uses {' and '.join(parts)} {_from(package)}" for package, parts in lost.items())


def _from(package: str) -> str:
    """Name the package that defines parts, and the command that installs it."""
    if (named := _DISTRIBUTION.fullmatch(package)) is None:
        given = in_one_line(package[:MOST_QUOTED])
        return f"of a package that is not installed; the file gives no package with its release, but {given!r}"
    return (
        f"of the package {package}, which is not installed. If you trust the sender of the file, who chose this name: "
        f"pip install {shlex.quote(f'{named[1]}=={named[2]}')}"
    )
