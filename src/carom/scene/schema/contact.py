"""[contact], [[material]], [[pair]], [gravity], [drag] and [forces]: how bodies act on each other.

Contacts are modelled with the coefficients of their materials.
"""

from __future__ import annotations

import json
import re
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from carom import registry
from carom.scene.contact_laws import DEFAULT_LAW, functions_of, geometric_mean
from carom.scene.schema.quantity import (
    LARGEST,
    ORIGIN,
    AnyReal,
    Count,
    Friction,
    NonNegative,
    Positive,
    Section,
    SectionError,
    Vector,
)
from carom.scene.units.dimension import ACCELERATION, DENSITY, GRAVITATIONAL_CONSTANT, LENGTH, TIME, VELOCITY
from carom.scene.wording import suggestion

DEFAULT = "default"  # name of the material that [contact] describes
STATIC, KINETIC = 0.6, 0.4  # default coefficients of friction, roughly for dry stone
BODY_COLOURS = ("sky-blue", "clay", "indigo", "mint", "olive", "sage", "rose")  # colours that no arrow and no edge has
COLOURS = (*BODY_COLOURS, "orange", "green", "yellow", "blue", "vermilion", "purple", "grey", "white")
_HEX = re.compile(r"#[0-9a-fA-F]{6}")


class Gravity(Section):
    """[gravity]: the gravity between bodies, and a uniform field."""

    constant: Annotated[NonNegative, GRAVITATIONAL_CONSTANT] = Field(
        6.6743e-11, description="m³ kg⁻¹ s⁻², gravitational constant; 0 for no gravity; not negative"
    )
    method: Literal["auto", "direct", "tree", "fast-multipole", "none"] = Field(
        "auto",
        description="how gravity is summed; auto uses a tree for 5000 bodies or more; fast-multipole conserves "
        "momentum and is faster at small errors",
    )
    opening_angle: Positive = Field(
        0.5,
        le=1,
        description="radians; with a tree, a box whose angular radius is smaller attracts as a whole; with "
        "fast-multipole, two boxes whose radii together subtend a smaller angle do; more than 0, at most 1",
    )
    quadrupoles: Annotated[bool, Field(strict=True)] = Field(
        True, description="tree only: false treats distant boxes as points, which is faster and less accurate"
    )
    softening: Annotated[NonNegative, LENGTH] = Field(0.0, description="m, Plummer softening length; not negative")
    uniform: Annotated[Vector, ACCELERATION] = Field(ORIGIN, description="m/s², a uniform field [x, y, z]")


class Drag(Section):
    """[drag]: Stokes' drag in a medium, a = -(v - u)/τ."""

    relaxation_time: Annotated[Positive, TIME] = Field(
        description="s, τ, time in which the velocity relative to the medium falls to 1/e, the same for all bodies; "
        "m/(6π η r) for a sphere of mass m and radius r in a fluid of viscosity η; more than 0"
    )
    medium_velocity: Annotated[Vector, VELOCITY] = Field(
        ORIGIN, description="m/s, u, the velocity [x, y, z] of the medium"
    )

    @model_validator(mode="after")
    def _the_push_of_the_medium_is_a_number(self) -> Self:
        largest = max(map(abs, self.medium_velocity))
        if largest > LARGEST * self.relaxation_time:
            raise ValueError(
                f"medium_velocity / relaxation_time is more than {LARGEST:g}; raise relaxation_time, or choose other "
                "units"
            )
        return self


class InstalledForces(Section):
    """[forces]: the forces of installed packages, with a section for each force that acts."""

    @property
    def given(self) -> dict[str, Any]:
        """The scene's sections of forces by name, in alphabetical order."""
        return {name: section for name, section in sorted(self) if section is not None}


class _NotLoaded(Section):
    """A section of a force or a contact law that cannot be loaded."""

    @model_validator(mode="before")
    @classmethod
    def _say_why(cls, given: Any) -> Any:
        raise ValueError(cls.__doc__)


class Forces(Section):
    """The keys of the forces in a scene."""

    gravity: Gravity = Field(Gravity(), description="gravity between bodies, and a uniform field")
    drag: Drag | None = Field(None, description="Stokes' drag in a medium; none by default")
    forces: InstalledForces = Field(
        InstalledForces(), description="forces of installed packages, with a section for each"
    )


def section_of(kind: str, name: str) -> Any:
    """Return the model of the section for a part of an installed package; it states why a part cannot be loaded."""
    try:
        section = registry.load(kind, name).section
        if section is not None and not (isinstance(section, type) and issubclass(section, Section)):
            raise registry.ExtensionError(
                f'the {registry.KINDS[kind]} "{name}" of the package {registry.source_of(kind, name)} has an object of '
                f"type {type(section).__name__} as its section, instead of a `carom.extend.Section`"
            )
        return section
    except registry.ExtensionError as error:
        return type("NotLoaded", (_NotLoaded,), {"__doc__": str(error), "__module__": __name__})


class Coefficients(NamedTuple):
    """Coefficients of the contact law."""

    restitution: float
    static_friction: float
    kinetic_friction: float


def combined(one: Coefficients, other: Coefficients) -> Coefficients:
    """Return the coefficients of a contact of two materials: the smaller restitution, the mean friction.

    The mean is geometric, as in Box2D: friction is 0 if one of the two is smooth. In contacts of a material with
    itself, its own coefficients apply to the last bit.
    """
    if one == other:
        return one
    return Coefficients(
        min(one.restitution, other.restitution),
        geometric_mean(one.static_friction, other.static_friction),
        geometric_mean(one.kinetic_friction, other.kinetic_friction),
    )


class Surface(Section):
    """Coefficients of the contact law, each of which may be missing."""

    restitution: AnyReal | None = Field(
        None,
        ge=0,
        le=1,
        description="speed of rebound over speed of approach, from 0 to 1; by default the value in [contact]",
    )
    static_friction: Friction | None = Field(
        None, description="Coulomb coefficient of a sticking contact; by default the value in [contact]"
    )
    kinetic_friction: Friction | None = Field(
        None,
        description="Coulomb coefficient of a sliding contact, at most static_friction; by default as in [contact]",
    )

    @model_validator(mode="after")
    def _sliding_is_not_harder_than_starting(self) -> Self:
        static, kinetic = self.static_friction, self.kinetic_friction
        if static is not None and kinetic is not None and kinetic > static:
            raise ValueError(
                f"kinetic_friction = {kinetic:g} is above static_friction = {static:g}; it must be the smaller"
            )
        return self

    @property
    def given(self) -> list[str]:
        """The coefficients and the sections of contact laws that are given."""
        return [name for name in (*Coefficients._fields, *KNOWN_LAWS) if getattr(self, name, None) is not None]

    def completed(self, default: Coefficients) -> Coefficients:
        """Return all coefficients; a missing coefficient of friction adapts to the given coefficient."""
        static, kinetic = self.static_friction, self.kinetic_friction
        if static is None:
            static = default.static_friction if kinetic is None else max(kinetic, default.static_friction)
        if kinetic is None:
            kinetic = min(static, default.kinetic_friction)
        restitution = default.restitution if self.restitution is None else self.restitution
        return Coefficients(restitution, static, kinetic)


def _known_colour(colour: str) -> str:
    if not _HEX.fullmatch(colour) and colour not in COLOURS:
        raise ValueError(f'"{colour}" is not "#rrggbb"; {suggestion(colour, COLOURS)}')
    return colour


class Material(Surface):
    """[[material]]: a material of bodies, groups and planes, which refer to it by ``material``."""

    name: str = Field(
        min_length=1, description='name by which bodies, groups, planes and pairs refer to it; not "default"'
    )
    density: Annotated[Positive, DENSITY] | None = Field(
        None, description="kg/m³, density of bodies without a mass of their own; more than 0"
    )
    inertia_factor: Positive | None = Field(
        None, le=2 / 3, description="moment of inertia over m r²: 2/5 for a solid sphere, 2/3 for a thin shell"
    )
    colour: Annotated[str, AfterValidator(_known_colour)] | None = Field(
        None,
        description=f"colour in the viewer: {', '.join(BODY_COLOURS)}, which no arrow and no edge has; "
        f'{", ".join(COLOURS[len(BODY_COLOURS) :])}; or "#rrggbb"',
    )

    @model_validator(mode="after")
    def _is_not_the_default(self) -> Self:
        if self.name == DEFAULT:
            raise ValueError(f'name = "{DEFAULT}" is the material of [contact]; choose another')
        return self


class MaterialPair(Surface):
    """[[pair]]: the coefficients of contacts between two materials, instead of the combined ones."""

    materials: tuple[str, str] = Field(
        description='names of two materials, or one name twice for contacts of a material with itself; "default" is '
        "the material of [contact]"
    )

    @model_validator(mode="after")
    def _gives_a_coefficient(self) -> Self:
        if not self.given:
            raise ValueError(f"gives none of {', '.join(Coefficients._fields)}; add one, or remove the pair")
        return self


Sweeps = Literal["auto", "converged", "as-needed", "quick"]


def _known_law(law: str | list[str]) -> str | list[str]:
    known = registry.names("contact_laws")
    for name in [law] if isinstance(law, str) else law:
        if name not in known:
            raise ValueError(f'no contact law "{name}"; {suggestion(name, known)}')
    if not law:
        raise ValueError(f'names no law; remove it for "{DEFAULT_LAW}"')
    return law


class Sleep(Section):
    """[contact.sleep]: islands at rest are not computed until something disturbs them."""

    speed: Annotated[Positive, VELOCITY] = Field(
        description="m/s; bodies that move at most this fast, and whose surfaces rotate at most ten times as fast, "
        "may fall asleep"
    )
    after: Annotated[Positive, TIME] = Field(
        0.5, description="s, time for which all bodies of an island must be no faster than `speed`"
    )


class ContactSettings(Section):
    """[contact]: how contacts are modelled."""

    enabled: Annotated[bool, Field(strict=True)] = Field(True, description="false: spheres pass through each other")
    law: Annotated[str | list[str], AfterValidator(_known_law)] = Field(
        DEFAULT_LAW,
        description="contact law: coulomb, rolling_resistance, viscoelastic, power_law, restitution_table, walton, or "
        "one of an installed package, with its coefficients in [contact.NAME]; or a list of laws that define different "
        'impulses, such as ["viscoelastic", "rolling_resistance"]',
    )
    restitution: AnyReal = Field(
        0.5, ge=0, le=1, description="rebound speed over approach speed, from 0 (no bounce) to 1 (elastic)"
    )
    static_friction: Friction = Field(
        STATIC,
        description="Coulomb coefficient of a sticking contact; not negative; if only kinetic_friction is given, at "
        "least that",
    )
    kinetic_friction: Friction = Field(
        KINETIC,
        description="Coulomb coefficient of a sliding contact, from 0 to static_friction; if only static_friction is "
        "given, at most that",
    )
    solver: Literal["lasting", "staged"] = Field(
        "lasting",
        description="solver of resting contacts: with impulses that start from the previous step (lasting) "
        "or from 0 (staged)",
    )
    colouring: Literal["contacts", "bodies"] = Field(
        "contacts", description="what is coloured to find independent contacts: the contacts or the bodies"
    )
    stabilisation: Literal["split", "baumgarte", "none"] = Field(
        "split",
        description="how overlaps are corrected: by moving the bodies (split), by a velocity bias (baumgarte), or not "
        "at all (none)",
    )
    timing: Literal["auto", "end-of-step", "time-of-impact"] = Field(
        "auto",
        description="when impacts are resolved: at the end of their step, or at their exact times within it; auto is "
        "time-of-impact, unless a step of the integrator is more than one drift (yoshida4, leapfrog-dkd)",
    )
    search: Literal["grid", "k-d-tree"] = Field(
        "grid", description="broad phase: a hierarchical grid, or a k-d tree with the same result, 2 to 8 times slower"
    )
    sweeps: Sweeps | Annotated[Count, Field(le=10_000)] = Field(
        "auto",
        description="solver iterations in a step: until the impulses converge, but in heaps of more than 1024 contacts "
        "until no contact changes by 3e-6 of a radius (auto); until they converge everywhere, up to three times as "
        "slow for heaps (converged); until no contact changes by 3e-6 of a radius (as-needed); at most four of these, "
        "cheaper for falling heaps, with deeper overlaps (quick); or at most this number, up to 10000",
    )
    sleep: Sleep | None = Field(
        None, description="skip islands at rest on something fixed until something disturbs them; none by default"
    )
    allow_overlap: Annotated[bool, Field(strict=True)] = Field(
        False, description="true: explicit bodies may overlap at the start"
    )

    @model_validator(mode="before")
    @classmethod
    def _follow_the_given_friction(cls, data: Any) -> Any:
        """Adapt the default of one coefficient if it contradicts the given coefficient."""
        if not isinstance(data, dict):
            return data
        static, kinetic = data.get("static_friction"), data.get("kinetic_friction")
        if isinstance(static, (int, float)) and kinetic is None:
            return {**data, "kinetic_friction": min(KINETIC, static)}
        if isinstance(kinetic, (int, float)) and static is None:
            return {**data, "static_friction": max(STATIC, kinetic)}
        return data

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if self.kinetic_friction > self.static_friction:
            raise ValueError(
                f"kinetic_friction = {self.kinetic_friction:g} is above static_friction = {self.static_friction:g}; "
                "a sliding contact cannot resist more than a sticking one, so kinetic_friction must be the smaller"
            )
        if self.sleep is not None and self.solver != "lasting":
            raise ValueError(
                f'sleep needs impulses that last; remove it, or set solver = "lasting" instead of "{self.solver}"'
            )
        # laws that are not chosen have no sections; a law whose coefficients all have defaults needs none
        for name in law_sections(self):
            if name not in self.laws:
                raise SectionError((name,), f'needs contact.law = "{name}"; set it, or remove this section')
        for name in self.laws:
            try:
                _ = self.law_section(name)
            except ValidationError as error:
                needed = ", ".join(str(each["loc"][-1]) if each["loc"] else each["msg"] for each in error.errors())
                raise SectionError(
                    ("law",), f'"{name}" needs the section [contact.{name}] with {needed}; add it, or remove the law'
                ) from None
        try:
            functions_of(self.laws)
        except ValueError as error:
            raise SectionError(("law",), str(error)) from None
        return self

    @property
    def laws(self) -> tuple[str, ...]:
        """The names of the contact laws, without Coulomb's; empty if only Coulomb's law applies."""
        names = [self.law] if isinstance(self.law, str) else self.law
        return tuple(name for name in dict.fromkeys(names) if name != DEFAULT_LAW)

    @property
    def law_key(self) -> str:
        """The key ``law`` and its value, for messages."""
        return f"contact.law = {json.dumps(self.law)}"

    def law_section(self, name: str) -> Any:
        """Return the coefficients of a law for bodies and planes without a material; None if it has none."""
        kind = section_of("contact_laws", name)
        given = None if kind is None else getattr(self, name, None)
        return kind() if kind is not None and given is None else given

    @property
    def coefficients(self) -> Coefficients:
        """Coefficients of bodies and planes without a material."""
        return Coefficients(self.restitution, self.static_friction, self.kinetic_friction)


KNOWN_LAWS: list[str] = []  # contact laws that have a section; see `know_installed_parts`


def law_sections(holder: Surface | ContactSettings) -> list[str]:
    """Return the names of the contact laws that have a section in ``holder``."""
    return [name for name in KNOWN_LAWS if getattr(holder, name, None) is not None]
