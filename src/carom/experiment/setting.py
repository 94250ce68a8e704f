"""The settings of a scene that are measured against each other."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

from carom.experiment.reference import refined
from carom.physics.error import PhysicsError
from carom.physics.space import Space
from carom.scene.error import SceneError
from carom.scene.load import scene_from_text
from carom.scene.requirements import require
from carom.scene.schema import Scene

STEP = "step"  # a key of its own: so many times the step, whatever rule sets it
FEW = 20  # bodies whose gravity no tree would be used for


@dataclass(frozen=True, slots=True)
class Setting:
    """A few keys of the scene, with other values than it has."""

    name: str  # for people: "step × 2, integrator = euler"
    overrides: tuple[str, ...]  # as given to ``--set``

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with this setting.

        Raises
        ------
        SceneError
            If a key or a value is wrong.
        """
        return scene_from_text(scene.toml, scene.title, list(self.overrides))


def default_settings(scene: Scene) -> list[Setting]:
    """Return about a dozen settings worth knowing, of the parts that the scene requires."""
    parts = require(scene)
    forces = parts.gravity.modelled or parts.field.modelled
    if not parts.contact.modelled:
        return [
            *vary(scene, ["time.integrator=euler"]),
            *vary(scene, ["time.integrator=leapfrog,leapfrog-dkd,yoshida4", f"{STEP}=4,2,1,0.5"]),
        ]
    choices = [f"{STEP}=4", f"{STEP}=2", f"{STEP}=1", f"{STEP}=0.5"]
    if forces:
        choices += ["time.integrator=euler", "time.integrator=yoshida4", "contact.solver=staged"]
    else:
        choices += [f"{STEP}=8", f"{STEP}=0.25"]
    choices += ["contact.sweeps=2", "contact.stabilisation=none", "contact.stabilisation=baumgarte"]
    choices += ["contact.timing=time-of-impact"]
    if parts.adaptive_step.modelled:
        choices += ["time.velocity_limit=fastest-body"]
    if parts.gravity.modelled and scene.count > FEW:
        choices += ["gravity.method=tree"]
    return [setting for choice in choices for setting in vary(scene, [choice])]


def vary(scene: Scene, choices: list[str]) -> list[Setting]:
    """Return the settings of a grid.

    Parameters
    ----------
    choices
        ``key=a,b,c`` each; every value of one is combined with every value of the others. The key ``step`` multiplies
        whatever sets the step.

    Raises
    ------
    SceneError
        If a key or a value is wrong.
    """
    axes = [_axis(scene, choice) for choice in choices]
    settings = []
    for picked in itertools.product(*axes):
        name = ", ".join(word for word, _ in picked if word) or "as written"
        setting = Setting(name, tuple(override for _, overrides in picked for override in overrides))
        try:
            setting.apply(scene)
        except SceneError as error:
            raise SceneError(str(error).replace("--set", "--vary")) from None
        settings.append(setting)
    return settings


def refusal(scene: Scene) -> str:
    """Say why this version refuses to run a valid scene, or cannot begin to; empty if it runs it."""
    try:
        Space(scene)
    except (SceneError, PhysicsError) as error:
        return str(error)
    return ""


def _axis(scene: Scene, choice: str) -> list[tuple[str, list[str]]]:
    """Return the word for people and the overrides of each value of a choice."""
    key, separator, values = choice.partition("=")
    key = key.strip()
    if not separator or not key or not all(value.strip() for value in _values(values)):
        raise SceneError(f"--vary {choice}: expected key=a,b,c, such as time.integrator=euler,leapfrog")
    return [_step(scene, choice, value) if key == STEP else _plain(key, value) for value in _values(values)]


def _plain(key: str, value: str) -> tuple[str, list[str]]:
    return f"{key.rpartition('.')[2]} = {value}", [f"{key}={value}"]


def _step(scene: Scene, choice: str, value: str) -> tuple[str, list[str]]:
    try:
        times = float(value)
    except ValueError:
        times = 0.0
    if not 0.0 < times < float("inf"):
        raise SceneError(f"--vary {choice}: {value!r} is no number above 0, by which the step is multiplied")
    return ("", []) if times == 1.0 else (f"step × {times:g}", refined(scene, 1.0 / times))


def _values(text: str) -> list[str]:
    """Split at the commas that are not in brackets."""
    values, depth = [""], 0
    for character in text:
        depth += (character in "[{") - (character in "]}")
        if character == "," and depth == 0:
            values.append("")
        else:
            values[-1] += character
    return [value.strip() for value in values]
