"""The scene: everything that a run depends on, as validated data. Each description states the unit.

Sections and keys have the names that they have in the TOML file. All are optional, except that a scene needs a body or
a group. Unknown keys are refused.
"""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self

from pydantic import (
    AfterValidator,
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    field_validator,
    model_validator,
)

from carom.scene.integrators import AUTO, INTEGRATORS, described
from carom.scene.parts import PARTS, unknown
from carom.scene.variation import MOST_RUNS, Values, alike, flattened, values_of

LARGEST = 1e100  # cubes and most products of such numbers are finite
SMALLEST = 1e-100
STEEPEST = 300  # decades that a power of radii may span


def _refuse_extremes(value: float) -> float:
    """Refuse numbers whose powers overflow or underflow; 0 is allowed."""
    if value != 0.0 and not SMALLEST <= abs(value) <= LARGEST:
        raise ValueError(f"{value:g} is not between {SMALLEST:g} and {LARGEST:g} in size; choose other units")
    return value


_Sized = AfterValidator(_refuse_extremes)
_AnyReal = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Real = Annotated[float, Field(strict=True, allow_inf_nan=False), _Sized]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0), _Sized]
NonNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0), _Sized]
Friction = Annotated[float, Field(strict=True, ge=0, le=LARGEST)]  # has no unit that could be changed
Count = Annotated[int, Field(strict=True, ge=1)]
Vector = tuple[Real, Real, Real]
if TYPE_CHECKING:
    IntegratorName = str
else:
    IntegratorName = Literal[(AUTO, *INTEGRATORS)]

ORIGIN: Vector = (0.0, 0.0, 0.0)


class Section(BaseModel):
    """A table of the scene file: immutable; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=False)


_STEP_KEYS = {
    "fixed_dt": None,
    "target_dx": "auto",
    "cfl": "auto",
    "pull_fraction": "auto",
    "smoothing": "auto",
    "velocity_limit": "every-body",
}  # keys of [time] that set the step, with the values that leave it free
_UNCONTROLLED = ("euler", "leapfrog-dkd", "wisdom-holman")  # integrators that no look ahead is made for


class Time(Section):
    """[time]: the duration, and how the step is chosen."""

    duration: Positive = Field(10.0, description="s, simulated time; more than 0")
    max_dt: Positive = Field(1.0, description="s, largest step; more than 0")
    target_dx: Positive | Literal["auto"] = Field(
        "auto",
        description="m, largest distance that an acceleration may move a body from rest in a step; "
        '"auto" is a fraction of the smallest radius, smaller for fewer bodies, and no limit where nothing can touch',
    )
    cfl: Positive | Literal["auto"] = Field(
        "auto",
        description="largest distance that a body may move in a step, as a fraction of its own radius; more than 0; "
        '"auto" is 0.5, 1 where impacts are resolved at their own times and nothing presses contacts together, and '
        "no limit where nothing can touch",
    )
    pull_fraction: Annotated[Positive, Field(le=1)] | Literal["auto"] = Field(
        "auto",
        description="step as a fraction of the shortest time in which a pull changes the motion of a pair, "
        'r/√(v² + G(m_i + m_j)/r); more than 0, at most 1; "auto" is 0.01 where bodies pull each other and cannot '
        "touch (with more than 100 bodies 0.02, from the largest acceleration), and no limit elsewhere or with a "
        "target_dx",
    )
    smoothing: Annotated[Positive, Field(le=1)] | Literal["auto"] = Field(
        "auto",
        description="weight of the new step in the moving average; more than 0; 1 is no smoothing; "
        '"auto" is 0.2, and 1 where only pull_fraction limits the step',
    )
    velocity_limit: Literal["every-body", "fastest-body"] = Field(
        "every-body", description="bodies whose radius and speed limit the step: all, or only the fastest"
    )
    fixed_dt: Positive | None = Field(None, description="s, constant step in place of the adaptive one")
    accuracy: Annotated[Positive, Field(le=1e-2)] | None = Field(
        None,
        description="relative error to keep, in place of a step: of positions over the size of the system, and of "
        "times of impact over the duration; more than 0, at most 0.01; impacts then happen at their own times",
    )
    integrator: IntegratorName = Field(
        AUTO,
        description=f"{described()}; auto is Gauss–Radau where up to 100 bodies pull each other and cannot touch, "
        "Wisdom–Holman where they go around a dominant one 1000 times or more on orbits apart, Yoshida's where such a "
        "scene also sets its step, otherwise leapfrog",
    )
    encounters: Literal["resolve", "ignore"] = Field(
        "resolve",
        description="wisdom-holman only: whether close encounters of light bodies are left to Gauss–Radau, which then "
        "integrates all bodies, or pass unresolved, for many bodies of negligible masses",
    )

    @model_validator(mode="after")
    def _an_accuracy_sets_the_step(self) -> Self:
        if self.accuracy is None:
            return self
        for key, default in _STEP_KEYS.items():
            if getattr(self, key) != default:
                raise ValueError(
                    f"{key} = {getattr(self, key)} with accuracy = {self.accuracy:g}, which sets the step; remove one "
                    f"of them (--set time.{key}= removes it)"
                )
        if self.integrator in _UNCONTROLLED:
            raise ValueError(
                f'integrator = "{self.integrator}" with accuracy = {self.accuracy:g}, which needs its error; take '
                '"leapfrog", "yoshida4", "gauss-radau15" or "auto"'
            )
        return self


class Promise(Section):
    """[promise]: what a run needs to keep time.accuracy; carom finds it and writes it into the recorded scene."""

    refinement: Positive = Field(
        description="longest useful steps over those of the run; for gauss-radau15, its usual ones; more than 0"
    )
    until: Positive = Field(description="s, the part of the run that was looked ahead; more than 0")
    horizon: NonNegative | None = Field(
        None, description="s, time up to which the accuracy is kept; none: as far as was looked; not negative"
    )
    lyapunov: Real = Field(description="1/s, largest Lyapunov exponent, over the time that was looked ahead")
    error: Annotated[tuple[NonNegative, ...], Field(min_length=1)] = Field(
        description="expected error of positions over the size of the system, at equally spaced times up to `until`"
    )

    @property
    def kept_until(self) -> float:
        """The time in s up to which the accuracy is kept."""
        return self.until if self.horizon is None else self.horizon

    def error_at(self, time: float) -> float:
        """Return the expected error at a time in s, over the size of the system."""
        place = min(time / self.until, 1.0) * len(self.error)
        k = min(int(place), len(self.error) - 1)
        before = self.error[k - 1] if k > 0 else 0.0
        return before + (place - k) * (self.error[k] - before)


class Gravity(Section):
    """[gravity]: the gravity of the bodies on each other, and a uniform field."""

    constant: NonNegative = Field(
        6.6743e-11, description="m³ kg⁻¹ s⁻², gravitational constant; 0 is no gravity; not negative"
    )
    method: Literal["auto", "direct", "tree", "none"] = Field(
        "auto", description="how gravity is summed; auto takes a tree for 5000 bodies or more"
    )
    opening_angle: Positive = Field(
        0.5,
        le=1,
        description="rad, tree only: boxes with a smaller angular radius pull as a whole; more than 0, at most 1",
    )
    quadrupoles: Annotated[bool, Field(strict=True)] = Field(
        True, description="tree only: false treats distant boxes as points, which is faster and less accurate"
    )
    softening: NonNegative = Field(0.0, description="m, Plummer softening length; not negative")
    uniform: Vector = Field(ORIGIN, description="m/s², a uniform field [x, y, z]")


class Drag(Section):
    """[drag]: Stokes' drag in a medium, a = -(v - u)/τ."""

    relaxation_time: Positive = Field(
        description="s, τ, in which the velocity relative to the medium falls to 1/e; more than 0"
    )
    medium_velocity: Vector = Field(ORIGIN, description="m/s, u, the velocity [x, y, z] of the medium")

    @model_validator(mode="after")
    def _the_push_of_the_medium_is_a_number(self) -> Self:
        largest = max(map(abs, self.medium_velocity))
        if largest > LARGEST * self.relaxation_time:
            raise ValueError(
                f"medium_velocity / relaxation_time is more than {LARGEST:g} m/s²; raise relaxation_time, or choose "
                "other units"
            )
        return self


class Material(NamedTuple):
    """Coefficients of the contact law: from [contact] between bodies, from [[plane]] at that plane."""

    restitution: float
    static_friction: float
    kinetic_friction: float


class Contact(Section):
    """[contact]: how contacts are modelled."""

    enabled: Annotated[bool, Field(strict=True)] = Field(True, description="false: spheres pass through each other")
    restitution: _AnyReal = Field(
        0.5, ge=0, le=1, description="rebound speed over approach speed, from 0 (no bounce) to 1 (elastic)"
    )
    static_friction: Friction = Field(0.6, description="Coulomb coefficient of a sticking contact; not negative")
    kinetic_friction: Friction = Field(
        0.4, description="Coulomb coefficient of a sliding contact, from 0 to static_friction"
    )
    solver: Literal["lasting", "staged"] = Field(
        "lasting",
        description="solver of resting contacts: warm-started impulses (lasting), or impulses that start from 0 "
        "in every step (staged)",
    )
    colouring: Literal["contacts", "bodies"] = Field(
        "contacts", description="graph colouring that finds contacts to solve in parallel: of contacts or of bodies"
    )
    stabilisation: Literal["split", "baumgarte", "none"] = Field(
        "split",
        description="how overlaps are corrected: bodies are moved (split), a velocity bias (baumgarte), or not (none)",
    )
    timing: Literal["auto", "end-of-step", "time-of-impact"] = Field(
        "auto",
        description="when impacts are resolved: at the end of their step, or at their own times within it; auto is "
        "time-of-impact unless the bodies' own gravity presses contacts together",
    )
    search: Literal["grid", "k-d-tree"] = Field(
        "grid", description="broad phase: a hierarchical grid, or a k-d tree with the same result, 2 to 8 times slower"
    )
    sweeps: Literal["auto"] | Annotated[Count, Field(le=10_000)] = Field(
        "auto",
        description="solver iterations in a step: as many as the contacts need (auto), or at most this many",
    )
    allow_overlap: Annotated[bool, Field(strict=True)] = Field(
        False, description="true: explicit bodies may overlap at the start"
    )

    @model_validator(mode="before")
    @classmethod
    def _follow_the_given_friction(cls, data: Any) -> Any:
        """Adapt the default of one coefficient if it contradicts the other, which is given."""
        if not isinstance(data, dict):
            return data
        static, kinetic = data.get("static_friction"), data.get("kinetic_friction")
        if isinstance(static, (int, float)) and kinetic is None:
            return {**data, "kinetic_friction": min(0.4, static)}
        if isinstance(kinetic, (int, float)) and static is None:
            return {**data, "static_friction": max(0.6, kinetic)}
        return data

    @model_validator(mode="after")
    def _sliding_is_not_harder_than_starting(self) -> Self:
        if self.kinetic_friction > self.static_friction:
            raise ValueError(
                f"kinetic_friction = {self.kinetic_friction:g} is above static_friction = {self.static_friction:g}; "
                "a sliding contact cannot resist more than a sticking one, so kinetic_friction must be the smaller"
            )
        return self

    @property
    def material(self) -> Material:
        """The coefficients between bodies."""
        return Material(self.restitution, self.static_friction, self.kinetic_friction)


class Domain(Section):
    """[domain]: the space around the bodies."""

    boundary: Literal["open", "periodic", "walls"] = Field(
        "open", description="open space, a periodic box, or a box with walls"
    )
    size: tuple[Positive, Positive, Positive] | None = Field(
        None, description="m, [x, y, z] of the box about the origin; needed unless the boundary is open"
    )

    @model_validator(mode="after")
    def _a_box_has_a_size(self) -> Self:
        if self.boundary != "open" and self.size is None:
            raise ValueError(f'boundary = "{self.boundary}" needs size = [x, y, z] in metres')
        return self


def _one_as_several(value: Any) -> Any:
    """Read a single name as a list of one."""
    return [value] if isinstance(value, str) else value


class Model(Section):
    """[model]: parts to model even though the scene does not require them."""

    force: Annotated[tuple[Annotated[str, Field(strict=True)], ...], BeforeValidator(_one_as_several)] = Field(
        (), description="parts to switch on, by the names that `carom explain` prints; one, or a list"
    )

    @field_validator("force")
    @classmethod
    def _parts_are_known(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if name not in PARTS:
                raise ValueError(unknown(name))
        return names


class Record(Section):
    """[record]: how often frames are recorded and the energy is checked. It never changes the physics."""

    every: Literal["auto", "step"] | Positive = Field(
        "auto", description='"auto", "step", or seconds of simulated time between frames'
    )
    colour_by: Literal["auto", "group", "speed", "graph", "island"] = Field(
        "auto",
        description="what tells bodies apart in the viewer: group, speed, their colour in the collision graph, or the "
        'bodies that touch each other; "auto": group, or graph with contact.colouring = "bodies"',
    )
    impacts: Literal["auto", "all", "none"] = Field(
        "auto",
        description="impacts, and what contacts did, in the recording: all while they take at most a fifth of the "
        'file, else the largest between frames ("auto"); "all"; or "none"',
    )
    check_every: Count = Field(
        100,
        validation_alias=AliasChoices("check_every", "log_freq"),
        description="steps between energy checks, in addition to those at frames; 1 or more",
    )
    energy_tolerance: Positive = Field(
        1e-3, description="rise of the energy, relative to the energy scale, that causes a warning"
    )

    @model_validator(mode="before")
    @classmethod
    def _has_one_name_of_each_key(cls, given: Any) -> Any:
        if isinstance(given, dict) and "log_freq" in given and "check_every" in given:
            raise ValueError("log_freq is the old name of check_every: give one of the two")
        return given

    @property
    def log_freq(self) -> int:
        """The old name of ``check_every``."""
        warnings.warn("Record.log_freq is now called check_every", DeprecationWarning, stacklevel=2)
        return self.check_every


def _constant_as_range(value: Any) -> Any:
    """Read a single number as a range of zero width."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return {"min": value, "max": value}
    return value


class RadiusRange(Section):
    """Radii of a group: one number, or a range with its distribution."""

    min: Positive = Field(description="m, smallest radius; more than 0")
    max: Positive = Field(description="m, largest radius; more than 0")
    distribution: Literal["uniform", "log-uniform", "power-law"] = Field("uniform", description="of the radii")
    exponent: Real = Field(-3.5, description="of the power law, dN/dr ∝ r^exponent")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min > self.max:
            raise ValueError(f"min = {self.min:g} is above max = {self.max:g}; exchange them")
        if abs(self.exponent + 1.0) * math.log10(self.max / self.min) > STEEPEST:
            raise ValueError(
                f"exponent = {self.exponent:g} is too steep for such different radii; lower it or their ratio"
            )
        return self


class Region(Section):
    """Where the bodies of a group are placed; every sphere lies entirely inside."""

    shape: Literal["ball", "box"] = Field("ball", description="shape of the region")
    radius: Positive | None = Field(None, description="m, of a ball; more than 0")
    size: tuple[Positive, Positive, Positive] | None = Field(None, description="m, [x, y, z] of a box")
    centre: Vector = Field(ORIGIN, description="m, [x, y, z]")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.shape == "ball" and (self.radius is None or self.size is not None):
            raise ValueError('shape = "ball" needs radius = … in metres, and no size')
        if self.shape == "box" and (self.size is None or self.radius is not None):
            raise ValueError('shape = "box" needs size = [x, y, z] in metres, and no radius')
        return self


class Velocity(Section):
    """Velocities of a group: Maxwellian about a mean."""

    mean: Vector = Field(ORIGIN, description="m/s, [x, y, z]")
    dispersion: NonNegative = Field(0.0, description="m/s, standard deviation of each component; not negative")


class Spin(Section):
    """Spins of a group: Maxwellian about its bulk rotation."""

    dispersion: NonNegative = Field(0.0, description="rad/s, standard deviation of each component; not negative")


class Matter(Section):
    """Matter of a sphere: a density or a mass, not both."""

    density: Positive | None = Field(None, description="kg/m³, 1000 unless mass is given; more than 0")
    mass: Positive | None = Field(None, description="kg, of each body, in place of a density; more than 0")
    inertia_factor: Positive = Field(
        0.4, le=2 / 3, description="moment of inertia over m r²: 2/5 for a solid sphere, 2/3 for a thin shell"
    )

    @model_validator(mode="after")
    def _density_or_mass(self) -> Self:
        if self.density is not None and self.mass is not None:
            raise ValueError("density and mass are both given; leave one out")
        return self


class Group(Matter):
    """[[group]]: many bodies at random positions, without overlaps."""

    name: str = Field("", description="shown in the recording")
    count: Count = Field(100, description="number of bodies; 1 or more")
    radius: Annotated[RadiusRange, BeforeValidator(_constant_as_range)] = Field(
        RadiusRange(min=1.0, max=1.0), description="m, one number or { min, max, distribution }"
    )
    region: Region | None = Field(
        None, description="where the bodies are placed; by default a ball that is one tenth full"
    )
    velocity: Velocity = Field(Velocity(), description="{ mean, dispersion } in m/s")
    spin: Spin = Field(Spin(), description="{ dispersion } in rad/s")
    bulk_rotation: Vector = Field(
        ORIGIN, description="rad/s, [x, y, z], rigid rotation of the whole group about its centre"
    )


class Body(Matter):
    """[[body]]: one body."""

    name: str = Field("", description="shown in the recording and in warnings")
    position: Vector = Field(ORIGIN, description="m, [x, y, z] of the centre")
    velocity: Vector = Field(ORIGIN, description="m/s, [x, y, z]")
    angular_velocity: Vector = Field(ORIGIN, description="rad/s, [x, y, z]")
    radius: Positive = Field(1.0, description="m; more than 0")
    fixed: Annotated[bool, Field(strict=True)] = Field(
        False, description="true: the body neither moves nor turns, whatever acts on it"
    )

    @model_validator(mode="after")
    def _a_fixed_body_does_not_move(self) -> Self:
        if self.fixed and (any(self.velocity) or any(self.angular_velocity)):
            raise ValueError(
                "fixed = true with a velocity or an angular_velocity; leave them out, or set fixed = false"
            )
        return self


class Plane(Section):
    """[[plane]]: a static half-space; the normal points out of the solid."""

    name: str = Field("", description="shown in warnings")
    point: Vector = Field(ORIGIN, description="m, [x, y, z] of any point of the surface")
    normal: tuple[_AnyReal, _AnyReal, _AnyReal] = Field(
        (0.0, 0.0, 1.0), description="[x, y, z], direction out of the solid; any length but 0"
    )
    restitution: _AnyReal | None = Field(None, ge=0, le=1, description="as in [contact], whose value is the default")
    static_friction: Friction | None = Field(None, description="as in [contact], whose value is the default")
    kinetic_friction: Friction | None = Field(
        None, description="as in [contact], whose value is the default; at most static_friction"
    )

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not any(self.normal):
            raise ValueError(
                "normal = [0, 0, 0] is no direction; give the direction out of the solid, such as [0, 0, 1]"
            )
        return self

    @model_validator(mode="after")
    def _sliding_is_not_harder_than_starting(self) -> Self:
        static, kinetic = self.static_friction, self.kinetic_friction
        if static is not None and kinetic is not None and kinetic > static:
            raise ValueError(
                f"kinetic_friction = {kinetic:g} is above static_friction = {static:g}; it must be the smaller"
            )
        return self

    def material(self, contact: Contact) -> Material:
        """Return the coefficients at the plane; a missing coefficient of friction adapts to the one that is given."""
        static, kinetic = self.static_friction, self.kinetic_friction
        if static is None:
            static = contact.static_friction if kinetic is None else max(kinetic, contact.static_friction)
        if kinetic is None:
            kinetic = min(static, contact.kinetic_friction)
        restitution = contact.restitution if self.restitution is None else self.restitution
        return Material(restitution, static, kinetic)


ABOUT_THE_END = ("final_kinetic", "impacts")  # promises that apply only to a run of the promised duration


class Expect(Section):
    """[expect]: promises that are checked at the end; a run that misses one says so and exits with 1."""

    energy_error: NonNegative | None = Field(
        None,
        description="largest |integration error| over the energy scale, or energy put in by contacts if that is more",
    )
    energy_gain: NonNegative | None = Field(
        None, description="largest rise of the total energy above its lowest so far, over the energy scale, at frames"
    )
    momentum_error: NonNegative | None = Field(None, description="largest change of momentum over its scale")
    angular_momentum_error: NonNegative | None = Field(
        None, description="largest change of angular momentum over its scale"
    )
    max_overlap: NonNegative | None = Field(None, description="deepest overlap over the smaller radius")
    final_kinetic: NonNegative | None = Field(
        None, description="kinetic energy at the end, of motion and spin, over the energy scale"
    )
    impacts: Count | None = Field(None, description="smallest number of impacts; 1 or more")
    contact_audit: NonNegative | None = Field(
        None,
        description="largest change of a speed or of the ledger in a step that impulses and forces do not explain",
    )
    duration: Positive | None = Field(
        None,
        description="s, the duration for which final_kinetic, impacts and warned are promised; default: that of [time]",
    )
    warned: tuple[Literal["energy-rise", "energy-ledger", "energy-lost", "limit"], ...] = Field(
        (), description='kinds of warnings that the run must give, such as "energy-lost"'
    )


def _values_by_key(given: Any) -> Any:
    """Read the varied values: lists as they are, text in the syntax of `--vary`."""
    if not isinstance(given, dict):
        return given
    found: dict[str, Values] = {}
    count = 0
    for key, value in flattened(given).items():
        found[key] = (
            values_of(value) if isinstance(value, str) else alike(value if isinstance(value, list) else [value])
        )
        count += len(found[key])
        if count > MOST_RUNS:
            raise ValueError(f"more than {MOST_RUNS} values; give fewer")
    return found


class Sweep(Section):
    """[sweep]: what `carom sweep` varies; `carom run` ignores it."""

    vary: Annotated[dict[str, Values], BeforeValidator(_values_by_key)] = Field(
        {}, description='values by key: a list, or text such as "0.1:0.9:5" or "1e-3:1:4log"'
    )
    seeds: Count | None = Field(
        None, description="runs of each combination, with seeds counted up from the scene's own; 1 or more"
    )
    zip: Annotated[bool, Field(strict=True)] = Field(
        False,
        description="true: combine the first values of all keys, then the second, …; false: combine each with each",
    )


class Scene(Section):
    """What to simulate: validated, complete, immutable.

    Examples
    --------
    >>> scene = Scene.from_dict({"body": [{"radius": 1.0}], "time": {"duration": 1.0}})
    >>> scene.time.max_dt
    1.0
    """

    title: str = Field("Untitled scene", description="one line; shown everywhere")
    description: str = Field("", description="what to look for, shown in the recording")
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = Field(
        0, description="seed of the random start; 0 or more, below 2**63"
    )
    time: Time = Field(Time(), description="the duration, and how the step is chosen")
    gravity: Gravity = Field(Gravity(), description="gravity of the bodies on each other, and a uniform field")
    drag: Drag | None = Field(None, description="Stokes' drag in a medium; none by default")
    contact: Contact = Field(Contact(), description="how contacts are modelled")
    domain: Domain = Field(Domain(), description="the space around the bodies")
    model: Model = Field(Model(), description="parts to model even though the scene does not require them")
    record: Record = Field(Record(), description="how often frames are recorded and the energy is checked")
    group: tuple[Group, ...] = Field((), description="many bodies at random positions")
    body: tuple[Body, ...] = Field((), description="single bodies")
    plane: tuple[Plane, ...] = Field((), description="static half-spaces")
    expect: Expect = Field(Expect(), description="promises that are checked at the end")
    sweep: Sweep = Field(Sweep(), description="what `carom sweep` varies")
    promise: Promise | None = Field(None, description="what time.accuracy takes; written by carom, not by hand")

    _toml: str = PrivateAttr("")

    @property
    def toml(self) -> str:
        """The scene as TOML: the text it was loaded from with overrides applied, or one written from its values."""
        return self._toml

    @property
    def refinement(self) -> float:
        """The refinement that the accuracy takes; 1 where none is asked for."""
        return 1.0 if self.promise is None else self.promise.refinement

    @property
    def count(self) -> int:
        """Number of bodies."""
        return len(self.body) + sum(group.count for group in self.group)

    @property
    def anchored(self) -> bool:
        """Whether there are planes, walls or fixed bodies, which take up momentum."""
        return bool(self.plane) or self.domain.boundary == "walls" or any(body.fixed for body in self.body)

    @classmethod
    def load(cls, source: str | Path, overrides: list[str] | None = None) -> Scene:
        """Load a TOML file, or a bundled scene by its name; see `carom.scene.load.load_scene`."""
        from carom.scene.load import load_scene  # noqa: PLC0415 - load needs Scene

        return load_scene(source, overrides or [])

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Scene:
        """Build a scene from the same keys as a TOML file; raises `SceneError` like `load`."""
        from carom.scene.load import scene_from_dict  # noqa: PLC0415 - load needs Scene

        return scene_from_dict(data)

    @model_validator(mode="after")
    def _has_a_body(self) -> Self:
        if self.count == 0:
            raise ValueError("no bodies; add a [[body]] or a [[group]]")
        return self

    @model_validator(mode="after")
    def _an_accuracy_needs_times_of_impact(self) -> Self:
        if self.time.accuracy is not None and self.contact.timing == "end-of-step":
            raise ValueError(
                f'contact.timing = "end-of-step" with time.accuracy = {self.time.accuracy:g}: impacts would be late by '
                "up to a step; remove one of them (--set contact.timing= removes it)"
            )
        return self

    @model_validator(mode="after")
    def _promises_what_was_asked(self) -> Self:
        if self.promise is not None and self.time.accuracy is None:
            raise ValueError("a [promise] without time.accuracy; carom writes it, so remove it")
        return self

    @model_validator(mode="after")
    def _periodic_space_has_no_uniform_field(self) -> Self:
        if self.domain.boundary == "periodic" and any(self.gravity.uniform):
            raise ValueError(
                'domain.boundary = "periodic" with gravity.uniform: bodies would fall through the box for ever, and '
                "the potential of the field is not periodic; set gravity.uniform = [0, 0, 0]"
            )
        return self

    @model_validator(mode="after")
    def _periodic_space_has_no_planes(self) -> Self:
        if self.domain.boundary == "periodic" and self.plane:
            raise ValueError(
                'domain.boundary = "periodic" with a [[plane]]: a periodic space cannot contain planes; use '
                'boundary = "walls" or "open", or remove the plane'
            )
        return self

    @model_validator(mode="after")
    def _periodic_space_has_no_self_gravity(self) -> Self:
        pulls = self.gravity.constant > 0 and self.gravity.method != "none"
        if self.domain.boundary == "periodic" and pulls:
            raise ValueError(
                'domain.boundary = "periodic" with self-gravity: the sum over infinitely many images does not '
                "converge, so there is no right answer to compute; set gravity.constant = 0"
            )
        return self
