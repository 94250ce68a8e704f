"""The scene: everything a run depends on, as validated data. Units stand in each description.

The names are the ones that a person writes in the TOML file. Every section and key is optional but a body or a
group; unknown keys are refused.
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

LARGEST = 1e100  # so that cubes and most products are numbers
SMALLEST = 1e-100
STEEPEST = 300  # decades that a power of radii may span


def _refuse_extremes(value: float) -> float:
    """Refuse what is so large or so small that powers of it are no numbers; 0 is one."""
    if value != 0.0 and not SMALLEST <= abs(value) <= LARGEST:
        raise ValueError(f"{value:g} is not between {SMALLEST:g} and {LARGEST:g} in size; choose other units")
    return value


_Sized = AfterValidator(_refuse_extremes)
_AnyReal = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Real = Annotated[float, Field(strict=True, allow_inf_nan=False), _Sized]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0), _Sized]
NonNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0), _Sized]
Friction = Annotated[float, Field(strict=True, ge=0, le=LARGEST)]  # without a unit: there are no others to choose
Count = Annotated[int, Field(strict=True, ge=1)]
Vector = tuple[Real, Real, Real]
if TYPE_CHECKING:
    IntegratorName = str
else:
    IntegratorName = Literal[(AUTO, *INTEGRATORS)]

ORIGIN: Vector = (0.0, 0.0, 0.0)


class Section(BaseModel):
    """A table of the scene file: immutable, and without keys that nobody knows."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=False)


class Time(Section):
    """[time]: how long, and how the step is chosen."""

    duration: Positive = Field(10.0, description="s, simulated time; more than 0")
    max_dt: Positive = Field(1.0, description="s, largest step; more than 0")
    target_dx: Positive | Literal["auto"] = Field(
        "auto",
        description="m, farthest that the largest acceleration may move a body in a step; "
        '"auto" is a part of the smallest radius, the smaller the fewer bodies there are, and no limit where nothing '
        "can touch",
    )
    cfl: Positive | Literal["auto"] = Field(
        "auto",
        description="fraction of its own radius that a body may cross in a step, more than 0; "
        '"auto" is 0.5, and 1 where impacts are resolved at their own moments and nothing presses contacts together; '
        "no limit where nothing can touch",
    )
    pull_fraction: Annotated[Positive, Field(le=1)] | Literal["auto"] = Field(
        "auto",
        description="step as a fraction of the shortest time in which a pull changes the motion of a pair, "
        'r/√(v² + G(m_i + m_j)/r), more than 0, at most 1; "auto" is 0.01 where bodies pull each other and cannot '
        "touch (0.02 of more than 100 bodies, from their accelerations), and no limit elsewhere or with a target_dx",
    )
    smoothing: Annotated[Positive, Field(le=1)] | Literal["auto"] = Field(
        "auto",
        description="weight of the new dt in the moving average, above 0; 1 is no smoothing; "
        '"auto" is 0.2, and 1 where the pull alone limits the step',
    )
    velocity_limit: Literal["every-body", "fastest-body"] = Field(
        "every-body", description="the bodies whose radius and speed limit the step: all, or the fastest body alone"
    )
    fixed_dt: Positive | None = Field(None, description="s, a constant step in place of the adaptive one")
    integrator: IntegratorName = Field(
        AUTO,
        description=f"{described()}; auto is Yoshida's where up to 100 bodies pull each other and cannot touch, "
        "else leapfrog",
    )


class Gravity(Section):
    """[gravity]: what pulls."""

    constant: NonNegative = Field(6.6743e-11, description="m³ kg⁻¹ s⁻², 0 is no gravity; not negative")
    method: Literal["auto", "direct", "tree", "none"] = Field(
        "auto", description="how the pull is summed; auto takes a tree for many bodies"
    )
    opening_angle: Positive = Field(
        0.5, le=1, description="rad, tree only: what looks smaller pulls as a whole; more than 0, at most 1"
    )
    quadrupoles: Annotated[bool, Field(strict=True)] = Field(
        True, description="tree only: false takes what is far for a point, cheaper and less accurate"
    )
    softening: NonNegative = Field(0.0, description="m, Plummer softening length; not negative")
    uniform: Vector = Field(ORIGIN, description="m/s², a uniform field [x, y, z]")


class Drag(Section):
    """[drag]: a medium that slows bodies down, a = -(v - u)/τ (Stokes)."""

    relaxation_time: Positive = Field(
        description="s, τ: in it the velocity relative to the medium falls to 1/e; more than 0"
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
    """The coefficients of the contact law: those of [contact] between bodies, those of a [[plane]] at that plane."""

    restitution: float
    static_friction: float
    kinetic_friction: float


class Contact(Section):
    """[contact]: what happens where spheres touch."""

    enabled: Annotated[bool, Field(strict=True)] = Field(True, description="false: spheres pass through each other")
    restitution: _AnyReal = Field(
        0.5, ge=0, le=1, description="fraction of the approach speed kept, from 0 (no bounce) to 1 (elastic)"
    )
    static_friction: Friction = Field(0.6, description="Coulomb coefficient while the contact sticks; not negative")
    kinetic_friction: Friction = Field(
        0.4, description="Coulomb coefficient while the contact slides, from 0 to static_friction"
    )
    solver: Literal["lasting", "staged"] = Field(
        "lasting",
        description="solver of resting contacts: warm-started impulses (lasting), or impulses that start from 0 "
        "in every step (staged)",
    )
    colouring: Literal["contacts", "bodies"] = Field(
        "contacts", description="what is coloured to find contacts that can be solved in parallel: contacts or bodies"
    )
    stabilisation: Literal["split", "baumgarte", "none"] = Field(
        "split", description="how overlaps are undone: by moving positions (split), or by a velocity bias (baumgarte)"
    )
    timing: Literal["auto", "end-of-step", "time-of-impact"] = Field(
        "auto",
        description="when an impact is resolved: up to a step late, or at its own moment, whatever the speed; auto is "
        "the latter unless the bodies' own gravity presses contacts together",
    )
    search: Literal["grid", "k-d-tree"] = Field(
        "grid", description="broad phase: a hierarchical grid, or a k-d tree with the same result, 2 to 8 times slower"
    )
    sweeps: Literal["auto"] | Annotated[Count, Field(le=10_000)] = Field(
        "auto",
        description="passes over the contacts in a step: as many as they need (`auto`), or at most this many",
    )
    allow_overlap: Annotated[bool, Field(strict=True)] = Field(
        False, description="true: explicit bodies may overlap at the start"
    )

    @model_validator(mode="before")
    @classmethod
    def _follow_the_given_friction(cls, data: Any) -> Any:
        """Let the coefficient that is not given follow the one that is, where its default would contradict it."""
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
                "a sliding contact cannot hold more than a sticking one, so kinetic_friction must be the smaller"
            )
        return self

    @property
    def material(self) -> Material:
        """The coefficients between bodies."""
        return Material(self.restitution, self.static_friction, self.kinetic_friction)


class Domain(Section):
    """[domain]: the space around the bodies."""

    boundary: Literal["open", "periodic", "walls"] = Field("open", description="what is at the edge")
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
    """[model]: what is modelled though the scene does not require it."""

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
    """[record]: how often something is written down. It never changes the physics."""

    every: Literal["auto", "step"] | Positive = Field(
        "auto", description='"auto", "step", or seconds of simulated time between frames'
    )
    check_every: Count = Field(
        100,
        validation_alias=AliasChoices("check_every", "log_freq"),
        description="steps between energy checks, besides those of frames; 1 or more",
    )
    energy_tolerance: Positive = Field(
        1e-3, description="rise of the energy, over the energy scale, that logs a warning"
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
    """Read a single number as a range of no width."""
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
                f"exponent = {self.exponent:g} is too steep for radii so different; lower it or their ratio"
            )
        return self


class Region(Section):
    """Where the bodies of a group are placed; whole spheres lie inside it."""

    shape: Literal["ball", "box"] = Field("ball", description="ball or box")
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
    """What a sphere is made of: a density or a mass, not both."""

    density: Positive | None = Field(None, description="kg/m³, 1000 unless mass is given; more than 0")
    mass: Positive | None = Field(None, description="kg of each body, in place of density; more than 0 and finite")
    inertia_factor: Positive = Field(
        0.4, le=2 / 3, description="moment of inertia over m r²: 2/5 for a full sphere, 2/3 for a shell"
    )

    @model_validator(mode="after")
    def _density_or_mass(self) -> Self:
        if self.density is not None and self.mass is not None:
            raise ValueError("density and mass are both given; leave one out")
        return self


class Group(Matter):
    """[[group]]: many bodies at random, never overlapping."""

    name: str = Field("", description="shown in the recording")
    count: Count = Field(100, description="number of bodies; 1 or more")
    radius: Annotated[RadiusRange, BeforeValidator(_constant_as_range)] = Field(
        RadiusRange(min=1.0, max=1.0), description="m, one number or { min, max, distribution }"
    )
    region: Region | None = Field(None, description="where; a ball one tenth full unless given")
    velocity: Velocity = Field(Velocity(), description="{ mean, dispersion } in m/s")
    spin: Spin = Field(Spin(), description="{ dispersion } in rad/s")
    bulk_rotation: Vector = Field(ORIGIN, description="rad/s, the group turning as one about its centre")


class Body(Matter):
    """[[body]]: one body."""

    name: str = Field("", description="shown in the recording and in warnings")
    position: Vector = Field(ORIGIN, description="m, [x, y, z] of the centre")
    velocity: Vector = Field(ORIGIN, description="m/s, [x, y, z]")
    angular_velocity: Vector = Field(ORIGIN, description="rad/s, [x, y, z]")
    radius: Positive = Field(1.0, description="m; more than 0")
    fixed: Annotated[bool, Field(strict=True)] = Field(
        False, description="true: held where it is, whatever pulls or hits it; it neither moves nor turns"
    )

    @model_validator(mode="after")
    def _what_is_fixed_does_not_move(self) -> Self:
        if self.fixed and (any(self.velocity) or any(self.angular_velocity)):
            raise ValueError(
                "fixed = true with a velocity or an angular_velocity; leave them out, or set fixed = false"
            )
        return self


class Plane(Section):
    """[[plane]]: a static half-space, solid on the side that its normal leaves."""

    name: str = Field("", description="shown in warnings")
    point: Vector = Field(ORIGIN, description="m, [x, y, z] of any point of the surface")
    normal: tuple[_AnyReal, _AnyReal, _AnyReal] = Field(
        (0.0, 0.0, 1.0), description="direction out of the solid; of any length but 0"
    )
    restitution: _AnyReal | None = Field(
        None, ge=0, le=1, description="as in [contact], whose value holds unless given"
    )
    static_friction: Friction | None = Field(None, description="as in [contact], whose value holds unless given")
    kinetic_friction: Friction | None = Field(
        None, description="as in [contact], whose value holds unless given; at most the static one"
    )

    @model_validator(mode="after")
    def _has_a_direction(self) -> Self:
        if not any(self.normal):
            raise ValueError("normal = [0, 0, 0] is no direction; give the way out of the solid, such as [0, 0, 1]")
        return self

    @model_validator(mode="after")
    def _sliding_is_not_harder_than_starting(self) -> Self:
        static, kinetic = self.static_friction, self.kinetic_friction
        if static is not None and kinetic is not None and kinetic > static:
            raise ValueError(
                f"kinetic_friction = {kinetic:g} is above static_friction = {static:g}; kinetic_friction must be the "
                "smaller"
            )
        return self

    def material(self, contact: Contact) -> Material:
        """Return the coefficients at the plane; a friction not given follows the one that is."""
        static, kinetic = self.static_friction, self.kinetic_friction
        if static is None:
            static = contact.static_friction if kinetic is None else max(kinetic, contact.static_friction)
        if kinetic is None:
            kinetic = min(static, contact.kinetic_friction)
        restitution = contact.restitution if self.restitution is None else self.restitution
        return Material(restitution, static, kinetic)


ABOUT_THE_END = ("final_kinetic", "impacts")  # promises that only a run of the promised duration can keep or break


class Expect(Section):
    """[expect]: promises checked at the end; a run that misses one exits 1 and says so."""

    energy_error: NonNegative | None = Field(
        None,
        description="largest |integration error| over the energy scale, or what impulses of contacts put in if more",
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
    impacts: Count | None = Field(None, description="fewest contacts that close faster than at rest; 1 or more")
    duration: Positive | None = Field(
        None,
        description="s, the duration for which final_kinetic, impacts and warned are promised; default: that of [time]",
    )
    warned: tuple[Literal["energy-rise", "energy-ledger", "energy-lost", "limit"], ...] = Field(
        (), description='kinds of warnings that the run must give, such as "energy-lost"'
    )


def _values_by_key(given: Any) -> Any:
    """Read what varies: lists as they are, text as `--vary` takes it."""
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
    """[sweep]: what `carom sweep` varies, and what `carom run` leaves alone."""

    vary: Annotated[dict[str, Values], BeforeValidator(_values_by_key)] = Field(
        {}, description='values by key, a list or text such as "0.1:0.9:5" or "1e-3:1:4log"'
    )
    seeds: Count | None = Field(None, description="runs of each with seeds from the scene's own on; 1 or more")
    zip: Annotated[bool, Field(strict=True)] = Field(
        False, description="true: the values of all keys go side by side; false: each with each"
    )


class Scene(Section):
    """What to simulate: validated, complete, immutable.

    Examples
    --------
    >>> scene = Scene.from_dict({"body": [{"radius": 1.0}], "time": {"duration": 1.0}})
    >>> scene.time.max_dt
    1.0
    """

    title: str = Field("Untitled scene", description="one line, shown everywhere")
    description: str = Field("", description="what to look for, shown in the recording")
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = Field(
        0, description="of the random start; 0 or more, below 2**63"
    )
    time: Time = Field(Time(), description="how long, and how the step is chosen")
    gravity: Gravity = Field(Gravity(), description="what pulls")
    drag: Drag | None = Field(None, description="a medium that slows bodies down; none unless given")
    contact: Contact = Field(Contact(), description="what happens where spheres touch")
    domain: Domain = Field(Domain(), description="the space around the bodies")
    model: Model = Field(Model(), description="what is modelled though the scene does not require it")
    record: Record = Field(Record(), description="how often something is written down")
    group: tuple[Group, ...] = Field((), description="many bodies at random")
    body: tuple[Body, ...] = Field((), description="single bodies")
    plane: tuple[Plane, ...] = Field((), description="static half-spaces")
    expect: Expect = Field(Expect(), description="promises checked at the end")
    sweep: Sweep = Field(Sweep(), description="what `carom sweep` varies")

    _toml: str = PrivateAttr("")

    @property
    def toml(self) -> str:
        """The scene as TOML: the text it was loaded from with overrides applied, or one written from its values."""
        return self._toml

    @property
    def count(self) -> int:
        """Number of bodies."""
        return len(self.body) + sum(group.count for group in self.group)

    @property
    def anchored(self) -> bool:
        """Whether something does not move: planes, walls or fixed bodies, which take momentum out of the scene."""
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
    def _periodic_space_has_no_uniform_field(self) -> Self:
        if self.domain.boundary == "periodic" and any(self.gravity.uniform):
            raise ValueError(
                'domain.boundary = "periodic" with gravity.uniform: bodies would fall through the box for ever, and a '
                "potential that repeats does not exist; set gravity.uniform = [0, 0, 0]"
            )
        return self

    @model_validator(mode="after")
    def _periodic_space_has_no_planes(self) -> Self:
        if self.domain.boundary == "periodic" and self.plane:
            raise ValueError(
                'domain.boundary = "periodic" with a [[plane]]: a plane has no place in a space that repeats; use '
                'boundary = "walls" or "open", or leave the plane out'
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
