"""[units], [time], [record], [domain] and [model], and the keys at the top of a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    AliasChoices,
    BeforeValidator,
    Field,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)

from carom import registry
from carom.scene.integrators import AUTO, INTEGRATORS, described, integrator_called
from carom.scene.parts import PARTS, unknown
from carom.scene.portable_math import ENDLESS
from carom.scene.schema.quantity import Count, Positive, Section
from carom.scene.schema.shear import Shear
from carom.scene.units.dimension import LENGTH, TIME


class Units(Section):
    """[units]: the units of plain numbers, and of the numbers that carom prints.

    The simulation and the recording are in SI.
    """

    length: str | None = Field(None, description='unit, such as "km" or "au"; m by default')
    time: str | None = Field(None, description='unit, such as "h" or "day"; s by default')
    mass: str | None = Field(None, description='unit, such as "g" or "solar mass"; kg by default')
    angle: str | None = Field(None, description='unit, such as "deg"; rad by default')
    velocity: str | None = Field(None, description='unit, such as "km/s"; by default the length over the time')
    acceleration: str | None = Field(
        None, description='unit, such as "standard gravity"; by default the length over the time squared'
    )
    angular_velocity: str | None = Field(None, description='unit, such as "rpm"; by default the angle over the time')
    density: str | None = Field(None, description='unit, such as "g/cm^3"; by default the mass over the length cubed')
    energy: str | None = Field(
        None,
        description='unit, such as "erg", for printed numbers only; by default mass times length² over time²',
    )


def _installed_or_own(value: Any, own: ValidatorFunctionWrapHandler) -> Any:
    """Accept the name of an integrator of an installed package; other names must be carom's own."""
    if isinstance(value, str) and value not in (AUTO, *INTEGRATORS) and value in registry.installed("integrators"):
        try:
            return integrator_called(value).name
        except registry.ExtensionError as error:
            raise ValueError(str(error)) from error
    return own(value)


if TYPE_CHECKING:
    IntegratorName = str
else:
    IntegratorName = Annotated[Literal[(AUTO, *INTEGRATORS)], WrapValidator(_installed_or_own)]


LARGEST_ACCURACY = 1e-2
_STEP_KEYS = {  # keys of [time] that set the step, and the values with which they do not set it
    "fixed_dt": None,
    **dict.fromkeys(("target_dx", "cfl", "pull_fraction", "smoothing"), "auto"),
    "velocity_limit": "every-body",
}


class Time(Section):
    """[time]: the duration, and how the step is chosen."""

    duration: Annotated[Positive, TIME] = Field(10.0, description="s, simulated time; more than 0")
    max_dt: Annotated[Positive, TIME] | Literal["auto"] = Field(
        "auto",
        description='s, largest step; more than 0; "auto" is 1 s, or a millionth of the duration if that is longer, a '
        "strain of 0.001 in a sheared packing, or no limit "
        "if the integrator chooses its steps by its error or by the orbits",
    )
    target_dx: Annotated[Positive, LENGTH] | Literal["auto"] = Field(
        "auto",
        description='m, largest distance that an acceleration may move a body from rest in a step; "auto" is a '
        "fraction of the smallest radius, smaller for fewer bodies, or no limit where nothing can touch",
    )
    cfl: Positive | Literal["auto"] = Field(
        "auto",
        description="largest distance that a body may move in a step, as a fraction of its own radius; more than 0; "
        '"auto" is 0.5, or 1 if impacts are resolved at their exact times and nothing presses contacts '
        "together, or no limit where nothing can touch",
    )
    pull_fraction: Annotated[Positive, Field(le=1)] | Literal["auto"] = Field(
        "auto",
        description="step as a fraction of the shortest time in which gravity changes the motion of a pair, r/√(v² + "
        'G(m_i + m_j)/r); more than 0, at most 1; "auto" is 0.01 where bodies attract each other and '
        "cannot touch (with more than 100 bodies 0.02, from the largest acceleration), otherwise and "
        "with a target_dx no limit",
    )
    smoothing: Annotated[Positive, Field(le=1)] | Literal["auto"] = Field(
        "auto",
        description='weight of the new step in the moving average; more than 0; 1 for no smoothing; "auto" is 0.2, '
        "or 1 where only pull_fraction limits the step",
    )
    velocity_limit: Literal["every-body", "fastest-body"] = Field(
        "every-body", description="bodies whose radius and speed limit the step: all, or only the fastest"
    )
    fixed_dt: Annotated[Positive, TIME] | None = Field(None, description="s, constant step instead of the adaptive one")
    accuracy: Annotated[Positive, Field(le=LARGEST_ACCURACY)] | None = Field(
        None,
        description="relative error to keep, instead of a step: of positions over the size of the system, and of "
        "times of impact over the duration; more than 0, at most 0.01; impacts are then resolved at "
        "their exact times",
    )
    after_horizon: Literal["ordinary-steps", "end"] = Field(
        "ordinary-steps",
        description="what follows where the accuracy can no longer be kept, its horizon: the steps of the scene "
        "without an accuracy, or the end of the run",
    )
    integrator: IntegratorName = Field(
        AUTO,
        description=f"{described()}; auto is Gauss–Radau where up to 100 bodies attract each other and cannot touch "
        "(up to 1000 if they orbit a dominant one far apart), or up to 32 start far apart (up to 200 if they orbit a "
        "dominant one); Wisdom–Holman where bodies that cannot "
        "touch orbit a dominant one 1000 times or more on separate orbits; Yoshida's where they cannot touch and the "
        "scene sets its step; otherwise leapfrog",
    )
    encounters: Literal["resolve", "ignore"] = Field(
        "resolve",
        description='wisdom-holman only: "resolve" integrates all bodies with Gauss–Radau during close encounters of '
        'light bodies; "ignore", for many bodies of negligible mass, does not resolve them',
    )

    @model_validator(mode="after")
    def _an_accuracy_sets_the_step(self) -> Self:
        if self.accuracy is None:
            return self
        steps = [key for key, default in _STEP_KEYS.items() if getattr(self, key) != default]
        if steps:
            given = " and ".join(f"{key} = {getattr(self, key)}" for key in steps)
            overrides = " and ".join(f"time.{key}=" for key in steps)
            way = f"override {overrides} removes it" if len(steps) == 1 else f"overrides {overrides} remove them"
            raise ValueError(
                f"{given} with accuracy = {self.accuracy:g}, which sets the step; remove one of them (the {way})"
            )
        if self.integrator != AUTO and not integrator_called(self.integrator).keeps_accuracy:
            others = ", ".join(f'"{each.name}"' for each in INTEGRATORS.values() if each.keeps_accuracy)
            raise ValueError(
                f'integrator = "{self.integrator}" with accuracy = {self.accuracy:g}, which needs its error; set '
                f'{others} or "{AUTO}"'
            )
        return self


UNTITLED = "Untitled scene"


def called(title: str) -> str:
    """Return a title; `UNTITLED` if it is blank."""
    return title if title.strip() else UNTITLED


def in_one_line(title: str) -> str:
    """Return a title without line breaks; `UNTITLED` if it is blank."""
    return called(" ".join(title.splitlines()))


class Heading(Section):
    """The title, the seed, the units and the time of a scene."""

    title: Annotated[str, AfterValidator(in_one_line)] = Field(UNTITLED, description="one line; shown everywhere")
    description: str = Field("", description="what to look for, shown in the recording")
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = Field(
        0, description="seed of the random initial state; 0 or more, below 2**63"
    )
    units: str | Units | None = Field(
        None,
        description="the units of plain numbers, as a section; or the units of the simulation, as a text such as "
        '"au, day, solar mass"; SI by default',
    )
    time: Time = Field(Time(), description="the duration, and how the step is chosen")


class Record(Section):
    """[record]: how often frames are recorded and the energy is checked. It never changes the physics."""

    every: Literal["auto", "step"] | Annotated[Positive, TIME] = Field(
        "auto",
        description='"auto", "step", or seconds of simulated time between frames; a frame is the end of a step, so '
        "longer steps give fewer frames (time.max_dt limits them)",
    )
    colour_by: Literal["auto", "group", "material", "speed", "graph", "island"] = Field(
        "auto",
        description="how bodies are coloured in the viewer: by group, material, speed, their colour in the collision "
        'graph, or the bodies that touch each other; "auto" is material if one has a colour, graph with '
        'contact.colouring = "bodies", otherwise group',
    )
    impacts: Literal["auto", "all", "none"] = Field(
        "auto",
        description="which impacts, and what contacts did, are recorded: all while they take at most a fifth of the "
        'file, then the largest between frames ("auto"); "all"; or "none"',
    )
    check_every: Count = Field(
        100,
        validation_alias=AliasChoices("check_every", "log_freq"),
        description="steps between energy checks, in addition to checks at 600 times of the run; 1 or more",
    )
    energy_tolerance: Positive = Field(
        1e-3, description="rise of the energy, relative to the energy scale, that causes a warning"
    )
    series: tuple[Annotated[str, Field(strict=True)], ...] = Field(
        (), description="recorded series of installed packages, by name; none by default"
    )

    @field_validator("series")
    @classmethod
    def _series_are_installed(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            registry.load("series", name)
        return tuple(dict.fromkeys(names))

    @model_validator(mode="before")
    @classmethod
    def _has_one_name_of_each_key(cls, given: Any) -> Any:
        if isinstance(given, dict) and "log_freq" in given and "check_every" in given:
            raise ValueError("log_freq is the old name of check_every: give only one of them")
        return given


Boundary = Literal["open", "periodic", "walls"]


class Domain(Section):
    """[domain]: the space around the bodies."""

    boundary: Boundary | tuple[Boundary, Boundary, Boundary] = Field(
        "open",
        description="open space, a periodic box, or a box with walls; or one of these for each axis, such as "
        '["periodic", "periodic", "walls"]',
    )
    size: Annotated[tuple[Positive, Positive, Positive], LENGTH] | None = Field(
        None,
        description="m, [x, y, z] of the box about the origin; needed unless the boundary is open. Along an open axis "
        "it does not matter",
    )

    material: str | None = Field(None, description="name of the [[material]] of the walls")
    shear: Shear | None = Field(
        None, description='Lees–Edwards shear of a periodic box, such as { rate = 1.0, flow = "x", gradient = "y" }'
    )

    @property
    def axes(self) -> tuple[Boundary, Boundary, Boundary]:
        """The boundary along x, y and z."""
        return (self.boundary,) * 3 if isinstance(self.boundary, str) else self.boundary

    @property
    def repeating(self) -> tuple[int, ...]:
        """The axes along which space repeats."""
        return tuple(axis for axis, boundary in enumerate(self.axes) if boundary == "periodic")

    @property
    def is_periodic(self) -> bool:
        """Whether space repeats along an axis."""
        return bool(self.repeating)

    @property
    def walled(self) -> tuple[int, ...]:
        """The axes with walls."""
        return tuple(axis for axis, boundary in enumerate(self.axes) if boundary == "walls")

    @property
    def period(self) -> tuple[float, float, float] | None:
        """The size of the periodic box in m, `ENDLESS` along an axis that does not repeat; None in open space."""
        if not self.is_periodic or self.size is None:
            return None
        x, y, z = (size if axis in self.repeating else ENDLESS for axis, size in enumerate(self.size))
        return x, y, z

    @field_validator("boundary")
    @classmethod
    def _one_word_for_all_axes(cls, boundary: Boundary | tuple[Boundary, ...]) -> Boundary | tuple[Boundary, ...]:
        return boundary[0] if isinstance(boundary, tuple) and len(set(boundary)) == 1 else boundary

    @model_validator(mode="after")
    def _keys_suit_the_boundary(self) -> Self:
        shown = f'"{self.boundary}"' if isinstance(self.boundary, str) else str(list(self.boundary))
        if self.material is not None and not self.walled:
            raise ValueError(f'material = "{self.material}" without walls; set boundary = "walls", or remove it')
        if self.shear is not None and self.boundary != "periodic":
            raise ValueError(f'shear with boundary = {shown}; set boundary = "periodic", or remove shear')
        if self.boundary != "open" and self.size is None:
            raise ValueError(f"boundary = {shown} needs size = [x, y, z]")
        if self.size is not None and "boundary" not in self.model_fields_set:
            raise ValueError('size without a boundary; add boundary = "walls" or "periodic", or remove it')
        return self


class ForcedParts(Section):
    """[model]: parts to model although the scene does not require them."""

    force: Annotated[
        tuple[Annotated[str, Field(strict=True)], ...],
        BeforeValidator(lambda value: [value] if isinstance(value, str) else value),
    ] = Field((), description="parts to force, by the names that `carom explain` prints; one, or a list")

    @field_validator("force")
    @classmethod
    def _parts_are_known(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if name not in PARTS:
                raise ValueError(unknown(name))
        return names
