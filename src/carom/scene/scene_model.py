"""The scene: all data that a run depends on, validated."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, Self, cast

from pydantic import Field, PrivateAttr, model_validator
from pydantic.fields import FieldInfo

from carom import registry
from carom.scene.data.body_columns import BodyColumns
from carom.scene.data.body_sources import HeldBodies
from carom.scene.integrators import AUTO
from carom.scene.pistons import pistons_of, sides_of_face
from carom.scene.scene_file import KeyPath, KeyPlaces
from carom.scene.schema.body import Body, BodyData, BodyGroup, SolidPlane
from carom.scene.schema.contact import (
    DEFAULT,
    KNOWN_LAWS,
    ContactSettings,
    Forces,
    InstalledForces,
    Material,
    MaterialPair,
    law_sections,
    section_of,
)
from carom.scene.schema.promise import Expect, Promise, Sweep
from carom.scene.schema.quantity import Section, SectionError
from carom.scene.schema.release import Outlet
from carom.scene.schema.settings import Domain, ForcedParts, Heading, Record
from carom.scene.schema.wall import KNOWN_SHAPES, Wall
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wall_shapes import shape_called
from carom.scene.wording import suggestion


class SceneModel(Forces, Heading):
    """The sections of a scene and the checks across them: validated, complete, immutable.

    `carom.Scene` adds the methods that make a scene from a file, a dictionary or arrays.
    """

    contact: ContactSettings = Field(ContactSettings(), description="how contacts are modelled")
    domain: Domain = Field(Domain(), description="the space around the bodies")
    model: ForcedParts = Field(ForcedParts(), description="parts to model although the scene does not require them")
    record: Record = Field(Record(), description="how often frames are recorded and the energy is checked")
    group: tuple[BodyGroup, ...] = Field((), description="many bodies at random positions")
    body: tuple[Body, ...] = Field((), description="single bodies")
    bodies: tuple[BodyData, ...] = Field((), description="many bodies, from data files or arrays")
    plane: tuple[SolidPlane, ...] = Field((), description="half-spaces that are solid")
    wall: tuple[Wall, ...] = Field((), description="walls of other shapes")
    outlet: tuple[Outlet, ...] = Field((), description="where bodies leave")
    material: tuple[Material, ...] = Field((), description="what bodies, groups, planes and walls may be made of")
    pair: tuple[MaterialPair, ...] = Field(
        (), description="coefficients of two materials, instead of the combined ones"
    )
    expect: Expect = Field(Expect(), description="promises that are checked at the end")
    sweep: Sweep = Field(Sweep(), description="what `carom sweep` varies")
    promise: Promise | None = Field(None, description="how a run keeps time.accuracy; written by carom, not by hand")

    _toml: str = PrivateAttr("")
    _unit_system: UnitSystem = PrivateAttr(SI)
    _held: HeldBodies | None = PrivateAttr(None)
    _places: KeyPlaces | None = PrivateAttr(None)

    @property
    def toml(self) -> str:
        """The scene as TOML: its original text with overrides applied, or a text written from its values."""
        return self._toml

    @property
    def unit_system(self) -> UnitSystem:
        """The units in which the scene is written, simulated and printed."""
        return cast("UnitSystem", self._private("_unit_system"))

    @property
    def places(self) -> KeyPlaces | None:
        """The places of the scene's keys; None if the scene was not read from a text."""
        return cast("KeyPlaces | None", self._private("_places"))

    @property
    def refinement(self) -> float:
        """The refinement that the accuracy needs; 1 without an accuracy."""
        return 1.0 if self.promise is None else self.promise.refinement

    @property
    def end(self) -> float:
        """s, the time at which a run ends: the duration or, if the scene requests it, the end of its accuracy."""
        ends_early = self.promise is not None and self.time.after_horizon == "end"
        return min(self.time.duration, self.promise.kept_until) if ends_early and self.promise else self.time.duration

    @property
    def count(self) -> int:
        """Number of bodies."""
        return len(self.body) + sum(map(len, self.data)) + sum(group.count for group in self.group)

    @property
    def test_particles(self) -> int:
        """Number of bodies of mass 0."""
        single = sum(body.mass == 0.0 for body in self.body)
        grouped = sum(group.count for group in self.group if group.mass == 0.0)
        return single + sum(columns.massless for columns in self.data) + grouped

    @property
    def held(self) -> HeldBodies | None:
        """The bodies of all [[bodies]] tables, and their sources."""
        return cast("HeldBodies | None", self._private("_held"))

    @property
    def data(self) -> tuple[BodyColumns, ...]:
        """The bodies of each [[bodies]] table."""
        return () if self.held is None else tuple(bodies.columns for bodies in self.held.bodies)

    @property
    def notes(self) -> list[tuple[str, ...]]:
        """Notes for each [[bodies]] table: parts of its file that are unused or reinterpreted."""
        return [] if self.held is None else [bodies.notes for bodies in self.held.bodies]

    def _private(self, name: str) -> Any:
        """Return a private attribute. Pydantic's own look-up takes 2 µs, and a starting run needs 250 look-ups."""
        assert self.__pydantic_private__ is not None, "Pydantic sets them before it validates the whole scene"
        return self.__pydantic_private__[name]

    @property
    def has_fixed_bodies(self) -> bool:
        """Whether a body is fixed."""
        return any(body.fixed for body in self.body) or any(columns.anchors for columns in self.data)

    @property
    def anchored(self) -> bool:
        """Whether something absorbs or brings momentum: planes, walls, fixed bodies, or bodies that wait."""
        return bool(self.plane or self.wall or self.domain.walled) or self.has_fixed_bodies or self.admits

    @property
    def driving_field(self) -> tuple[float, float, float]:
        """The components of `gravity.uniform` along periodic axes, m/s²; other components are 0."""
        x, y, z = (g if axis in self.domain.repeating else 0.0 for axis, g in enumerate(self.gravity.uniform))
        return x, y, z

    @property
    def translating(self) -> tuple[SolidPlane | Wall, ...]:
        """The planes and walls that change their place."""
        solids: tuple[SolidPlane | Wall, ...] = (*self.plane, *self.wall)
        return tuple(solid for solid in solids if solid.translates)

    @property
    def admits(self) -> bool:
        """Whether bodies enter or leave during the run."""
        return bool(self.outlet) or any(group.release is not None for group in self.group)

    @property
    def outlet_names(self) -> list[str]:
        """The names of the outlets."""
        return [outlet.name or f"outlet {index}" for index, outlet in enumerate(self.outlet)]

    @property
    def has_piston(self) -> bool:
        """Whether a plane is a piston."""
        return bool(pistons_of(self))

    @property
    def wall_names(self) -> list[str]:
        """The names of the walls of [[wall]]."""
        return [wall.name or f"{wall.shape} {index}" for index, wall in enumerate(self.wall)]

    def promising(self, promise: Promise) -> Self:
        """Return this scene with a promise, which its text also states."""
        values = promise.model_dump(exclude_none=True)
        lines = [f"{key} = {list(value) if isinstance(value, tuple) else value!r}\n" for key, value in values.items()]
        promised = self.model_copy(update={"promise": promise})
        promised._toml = f"{self.toml.rstrip()}\n\n[promise]\n{''.join(lines)}"
        return promised

    @model_validator(mode="after")
    def _has_bodies_and_materials(self) -> Self:
        if not (self.body or self.bodies or self.group):
            raise ValueError("no bodies; add a [[body]], a [[group]] or a [[bodies]] with a file")
        check_materials(self)
        if self.record.colour_by == "material" and not self.material:
            raise ValueError('record.colour_by = "material" without a [[material]]; add one, or set "group"')
        return self

    @model_validator(mode="after")
    def _sections_agree(self) -> Self:
        if self.time.accuracy is not None and self.contact.timing == "end-of-step":
            raise ValueError(
                f'contact.timing = "end-of-step" with time.accuracy = {self.time.accuracy:g}: impacts would be late '
                "by up to a step; remove one of them (the override contact.timing= removes the former)"
            )
        if self.contact.sleep is not None and self.drag is not None:
            raise ValueError("contact.sleep with a [drag]: a medium may move sleeping bodies; remove one of them")
        if self.promise is not None and self.time.accuracy is None:
            raise ValueError("a [promise] without time.accuracy; carom writes it, so remove it")
        # bodies that fall along a periodic axis must meet some resistance
        along = [axis for axis in self.domain.repeating if self.gravity.uniform[axis]]
        if along and not self.anchored and self.drag is None:
            if isinstance(self.domain.boundary, tuple):
                named = " and ".join("xyz"[axis] for axis in along)
                raise ValueError(
                    f'gravity.uniform along {named}, where domain.boundary is "periodic": bodies would fall '
                    "forever; set it to 0 there, or add a [drag], a plane, a wall or a fixed body that holds them back"
                )
            raise ValueError(
                'domain.boundary = "periodic" with gravity.uniform: bodies would fall through the box forever; set '
                "gravity.uniform = [0, 0, 0], or add a [drag] or a fixed body that holds them back"
            )
        return self

    @model_validator(mode="after")
    def _expected_states_are_of_single_bodies(self) -> Self:
        names = [body.name for body in self.body]
        for index, state in enumerate(self.expect.state):
            if names.count(state.body) != 1:
                known = dict.fromkeys(name for name in names if name)
                what = "several [[body]] tables have this name; rename all but one"
                if state.body not in names:
                    named = suggestion(state.body, known) if known else "no [[body]] has a name"
                    what = f"no [[body]] of that name; {named}"
                raise SectionError(("expect", "state", index, "body"), what)
        return self

    @model_validator(mode="after")
    def _planes_suit_the_space_and_its_motion(self) -> Self:
        if isinstance(self.domain.boundary, tuple):
            for axis in self.domain.repeating:
                slanted = next((k for k, plane in enumerate(self.plane) if plane.normal[axis]), None)
                if slanted is not None:
                    raise SectionError(
                        ("plane", slanted, "normal"),
                        f"its component along {'xyz'[axis]} must be 0, because space repeats along that axis",
                    )
        elif self.domain.boundary == "periodic" and self.plane:
            raise ValueError(
                'domain.boundary = "periodic" with a [[plane]]: a periodic space cannot contain planes; use '
                'boundary = "walls" or "open", or remove the plane'
            )
        refuse_what_is_not_sheared(self)
        refuse_what_has_no_piston(self)
        refuse_what_admits_no_bodies(self)
        return self

    @model_validator(mode="after")
    def _walls_and_moving_planes_are_supported(self) -> Self:
        moving = next((k for k, plane in enumerate(self.plane) if plane.translates), None)
        for what, remedy in _unsupported(self, WITHOUT_WALLS):
            if what == "time.accuracy":
                if any(wall.moves for wall in self.wall):
                    raise ValueError(f"a wall.motion with {what}, which only supports walls at rest; {remedy}")
            elif self.wall:
                raise ValueError(f"a [[wall]] with {what}, which does not support walls yet; {remedy}")
            if moving is not None and what != "contact.enabled = false":
                raise SectionError(
                    ("plane", moving, "motion"), f"with {what}, which does not support moving planes yet; {remedy}"
                )
        return self

    @model_validator(mode="after")
    def _periodic_space_has_endless_walls_and_no_self_gravity(self) -> Self:
        size = self.domain.size or (0.0, 0.0, 0.0)
        for axis in self.domain.repeating:
            for index, wall in enumerate(self.wall):
                if shape_called(wall.shape).periodic(wall.section, axis, size[axis]) is None:
                    raise SectionError(
                        ("wall", index, wall.shape),
                        f"space repeats along {'xyz'[axis]}, where this wall ends or bends; use a cylinder along that "
                        "axis, or a rectangle with a side along it that is at least as long as the box",
                    )
        if self.domain.is_periodic and self.gravity.constant > 0 and self.gravity.method != "none":
            raise ValueError(
                'domain.boundary = "periodic" with self-gravity: the sum over infinitely many images does not '
                "converge, so there is no correct result; set gravity.constant = 0"
            )
        return self


def check_materials(scene: SceneModel) -> None:
    """Refuse names of materials that are unknown or used twice, and bodies that contradict their material."""
    known: dict[str, Material | None] = {DEFAULT: None}
    twice = 'given, but material = "{}" has one; remove one of the two'

    def check_name(path: KeyPath, name: str) -> None:
        if name not in known:
            only = f'there is no [[material]], only "{DEFAULT}"'
            raise SectionError(path, f'no material "{name}"; {suggestion(name, known) if len(known) > 1 else only}')

    for index, material in enumerate(scene.material):
        if material.name in known:
            path = ("material", index, "name")
            raise SectionError(path, f'a second material "{material.name}"; rename one of the two')
        known[material.name] = material
    pairs: set[frozenset[str]] = set()
    for index, pair in enumerate(scene.pair):
        for name in pair.materials:
            check_name(("pair", index, "materials"), name)
        if frozenset(pair.materials) in pairs:
            raise SectionError(
                ("pair", index, "materials"), f"a second pair of {' and '.join(pair.materials)}; merge the two"
            )
        pairs.add(frozenset(pair.materials))
    for section, members in (("body", scene.body), ("bodies", scene.bodies), ("group", scene.group)):
        for index, matter in enumerate(members):
            if matter.material is None:
                continue
            check_name((section, index, "material"), matter.material)
            for key in ("density", "inertia_factor"):
                if getattr(matter, key) is not None and getattr(known[matter.material], key, None) is not None:
                    raise SectionError((section, index, key), twice.format(matter.material))
    solids: tuple[tuple[str, tuple[SolidPlane | Wall, ...]], ...] = (("plane", scene.plane), ("wall", scene.wall))
    for section, walls in solids:
        for index, wall in enumerate(walls):
            if wall.material is not None:
                check_name((section, index, "material"), wall.material)
                if wall.given:
                    raise SectionError((section, index, wall.given[0]), twice.format(wall.material))
    for section, surfaces in (("material", scene.material), ("pair", scene.pair), *solids):
        for index, surface in enumerate(surfaces):
            for name in law_sections(surface):
                if name not in scene.contact.laws:
                    raise SectionError(
                        (section, index, name), f'needs contact.law = "{name}"; set it, or remove this section'
                    )
    if scene.domain.material is not None:
        check_name(("domain", "material"), scene.domain.material)


# For each optional part of the model, the settings that it does not support, and their remedies; "" stands for
# REMOVE_ONE.
REMOVE_ONE = "remove one of them"
WITHOUT_SHEAR = {
    "gravity": "bodies would fall through the box without end; set it to [0, 0, 0]",
    "drag": "its medium would move past the images of the box; remove it",
    "forces": "forces do not know that images move; remove it",
    "fixed": "its images would move; set fixed = false",
    "accuracy": "errors are not compared where images move; remove it",
    "integrator": 'bodies are wrapped once a step; set "leapfrog"',
    "sleep": "nothing is at rest in a flow; remove it",
    "overlap": 'impacts at their own times push nothing apart; set it to false, or timing to "end-of-step"',
    "model": "the shear determines which parts are needed; remove it",
}
WITHOUT_PISTON = {
    **{"enabled": "", "solver": 'set "lasting"', "sleep": "", "drag": "", "accuracy": ""},
    "integrator": 'set "leapfrog"',
    "compressed": 'use another arrangement, such as "random"',
}
WITHOUT_RELEASE = {
    "attraction": "set gravity.constant = 0",
    **{"enabled": "", "solver": 'set "lasting"', "sleep": "", "shear": "", "drag": "", "forces": "", "accuracy": ""},
    "integrator": 'set "leapfrog"',
    "closed": "leave one axis open",
}
WITHOUT_WALLS = dict.fromkeys(("accuracy", "drag", "sleep", "compressed", "enabled"), "")


def _unsupported(scene: SceneModel, remedies: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Yield those settings of a scene that a part of the model does not support, each with its remedy."""
    time, contact, gravity = scene.time, scene.contact, scene.gravity
    settings = {
        "accuracy": ("time.accuracy", time.accuracy is not None),
        "attraction": ("gravity between the bodies", gravity.constant > 0.0 and gravity.method != "none"),
        "closed": ("a box that is periodic along x, y and z", len(scene.domain.repeating) == len("xyz")),
        "compressed": (
            'a group with arrangement = "compressed"',
            any(group.arrangement == "compressed" for group in scene.group),
        ),
        "drag": ("a [drag]", scene.drag is not None),
        "enabled": ("contact.enabled = false", not contact.enabled),
        "fixed": ("a fixed body", scene.has_fixed_bodies),
        "forces": ("a [forces]", bool(scene.forces.given)),
        "gravity": ("gravity.uniform", any(gravity.uniform)),
        "integrator": (f'time.integrator = "{time.integrator}"', time.integrator not in (AUTO, "leapfrog")),
        "model": ("model.force", bool(scene.model.force)),
        "overlap": ("contact.allow_overlap", contact.allow_overlap and contact.timing != "end-of-step"),
        "shear": ("domain.shear", scene.domain.shear is not None),
        "sleep": ("contact.sleep", contact.sleep is not None),
        "solver": (f'contact.solver = "{contact.solver}"', contact.solver != "lasting"),
    }
    for key, remedy in remedies.items():
        what, given = settings[key]
        if given:
            yield what, remedy or REMOVE_ONE


def refuse_what_is_not_sheared(scene: SceneModel) -> None:
    """Refuse a sheared box with parts of the model that need forces, or the velocity of something at rest.

    Nothing can be fixed in a sheared box, since its images would move. A body that overlaps another one may be pushed
    away only where contacts last.
    """
    if scene.domain.shear is not None:
        for what, why in _unsupported(scene, WITHOUT_SHEAR):
            raise ValueError(f"domain.shear with {what}, which it does not support: {why}")


def refuse_what_has_no_piston(scene: SceneModel) -> None:
    """Refuse pistons that are combined with parts that support only planes at rest, and pressures without a face."""
    for number, piston in pistons_of(scene).items():
        for what, remedy in _unsupported(scene, WITHOUT_PISTON):
            raise SectionError(("plane", number, "piston"), f"with {what}, which does not support a piston; {remedy}")
        if piston.pressure is not None:
            sides_of_face(scene, number)


def refuse_what_admits_no_bodies(scene: SceneModel) -> None:
    """Refuse bodies that enter or leave with parts of the model that need the same bodies from start to end."""
    if scene.admits:
        released = [("group", index, "release") for index, group in enumerate(scene.group) if group.release is not None]
        key: KeyPath = released[0] if released else ("outlet", 0)
        for what, remedy in _unsupported(scene, WITHOUT_RELEASE):
            raise SectionError(key, f"with {what}, which does not support it; {remedy}")


@cache
def know_installed_parts() -> None:
    """Add a field for each force, contact law and shape of walls to the models that hold its section.

    Parts are added when a scene is first used, not when this module is imported, since the modules of the parts import
    this module.
    """
    surfaces: tuple[type[Section], ...] = (ContactSettings, Material, MaterialPair, SolidPlane, Wall)
    parts: tuple[tuple[str, tuple[str, ...], tuple[type[Section], ...], list[str]], ...] = (
        ("forces", registry.installed("forces"), (InstalledForces,), []),
        ("contact_laws", registry.names("contact_laws"), surfaces, KNOWN_LAWS),
        ("walls", registry.names("walls"), (Wall,), KNOWN_SHAPES),
    )
    for kind, names, holders, known in parts:
        for name in names:
            section = section_of(kind, name)
            if section is not None:  # a law may have no coefficients
                known.append(name)
                meaning = (section.__doc__ or "").partition(": ")[2] or section.__doc__
                for model in holders:
                    model.model_fields[name] = FieldInfo(annotation=section | None, default=None, description=meaning)
    rebuilt: tuple[type[Section], ...] = (InstalledForces, *surfaces, SceneModel, *SceneModel.__subclasses__())
    for model in rebuilt:
        model.model_rebuild(force=True)
