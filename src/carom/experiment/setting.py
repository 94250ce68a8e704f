"""The settings of a scene that are measured against each other."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

from carom.experiment.reference import refined
from carom.physics.error import PhysicsError
from carom.physics.space import Space
from carom.scene.error import SceneError
from carom.scene.load import scene_from_text
from carom.scene.requirements import gravity_method, require
from carom.scene.schema import Scene
from carom.scene.variation import texts_of

STEP = "step"  # a key of its own: so many times the step, whatever rule sets it
THREADS = "threads"  # likewise: for the kernels; they change the cost and no bit
FEW = 20  # bodies whose gravity no tree would be used for


@dataclass(frozen=True, slots=True)
class Setting:
    """A few keys of the scene, with other values than it has."""

    name: str  # for people: "step × 2, integrator = euler"
    overrides: tuple[str, ...]  # as given to ``--set``
    threads: int | None = None  # in place of the study's

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
    forces, located = parts.gravity.modelled or parts.field.modelled, parts.impact_time.modelled
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
    if forces or not located:  # else next to nothing is left to the end of the step
        choices += ["contact.sweeps=2", "contact.stabilisation=none", "contact.stabilisation=baumgarte"]
    other = "end-of-step" if located else "time-of-impact"
    otherwise = vary(
        scene, [f"contact.timing={other}", f"{STEP}=" + ("2" if forces else "1,0.25" if located else "8,1")]
    )
    if parts.adaptive_step.modelled:
        choices += ["time.velocity_limit=fastest-body", "time.smoothing=1"]
    if parts.gravity.modelled and scene.count > FEW:
        tree = ["gravity.opening_angle=0.3,0.8", "gravity.quadrupoles=false"]
        choices += tree if gravity_method(scene) == "tree" else ["gravity.method=tree"]
    return [setting for choice in choices for setting in vary(scene, [choice])] + otherwise


def vary(scene: Scene, choices: list[str]) -> list[Setting]:
    """Return the settings of a grid.

    Parameters
    ----------
    choices
        ``key=a,b,c`` or ``key=first:last:count`` each, as `carom sweep` takes it; every value of one is combined with
        every value of the others. The key ``step`` multiplies whatever sets the step, and ``threads`` is not of the
        scene: it changes the cost alone.

    Raises
    ------
    SceneError
        If a key or a value is wrong.
    """
    axes = [_axis(choice) for choice in choices]
    settings = []
    for picked in itertools.product(*axes):
        try:
            settings.append(_setting(scene, picked))
        except SceneError as error:
            raise SceneError(str(error).replace("--set", "--vary")) from None
    return settings


def refusal(scene: Scene) -> str:
    """Say why this version refuses to run a valid scene, or cannot begin to; empty if it runs it."""
    try:
        Space(scene)
    except (SceneError, PhysicsError) as error:
        return str(error)
    return ""


@dataclass(frozen=True, slots=True)
class _Choice:
    """One value of one key."""

    word: str = ""  # for people
    override: str = ""  # as given to ``--set``
    step: float = 1.0  # factor on the step
    threads: int | None = None


def _setting(scene: Scene, picked: tuple[_Choice, ...]) -> Setting:
    """Put choices together; the step is a multiple of what it is with all the others."""
    overrides = [choice.override for choice in picked if choice.override]
    step = math.prod(choice.step for choice in picked)
    if step != 1.0:
        overrides += refined(Setting("", tuple(overrides)).apply(scene), 1.0 / step)
    name = ", ".join(choice.word for choice in picked if choice.word) or "as written"
    threads = next((choice.threads for choice in picked if choice.threads), None)
    setting = Setting(name, tuple(overrides), threads)
    setting.apply(scene)
    return setting


def _axis(choice: str) -> list[_Choice]:
    """Read the values of a key."""
    key, separator, values = choice.partition("=")
    key = key.strip()
    if not separator or not key:
        raise SceneError(f"--vary {choice}: expected key=a,b,c, such as time.integrator=euler,leapfrog")
    try:
        parts = texts_of(values)
    except ValueError as error:
        raise SceneError(f"--vary {key}: {error}") from None
    if key == STEP:
        return [_step(choice, value) for value in parts]
    if key == THREADS:
        return [_threads(choice, value) for value in parts]
    return [_Choice(f"{key.rpartition('.')[2]} = {value}", f"{key}={value}") for value in parts]


def _step(choice: str, value: str) -> _Choice:
    try:
        times = float(value)
    except ValueError:
        times = 0.0
    if not 0.0 < times < math.inf:
        raise SceneError(f"--vary {choice}: {value!r} is no number above 0, by which the step is multiplied")
    return _Choice("" if times == 1.0 else f"step × {times:g}", step=times)


def _threads(choice: str, value: str) -> _Choice:
    if not value.isdigit() or int(value) < 1:
        raise SceneError(f"--vary {choice}: {value!r} is no number of threads; expected 1, 2 and so on")
    return _Choice(f"threads = {value}", threads=int(value))
