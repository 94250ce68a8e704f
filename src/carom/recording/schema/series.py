"""The scalars of every frame: the table behind the encoder, the plots, the inventory and docs/recording.md.

To add a scalar, add a `Series` here, and its row to the table in docs/recording.md. ``record.series`` of a scene
adds series of installed packages, and ``[forces]`` adds the series of installed forces. The inventory at the end lists
all entities that a recording of a scene has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from carom import registry
from carom.arrays import FloatArray
from carom.contact_table import IMPACT_MODE
from carom.plan.features import Requirements
from carom.recording.schema import palette, paths
from carom.recording.schema.header import RECORDED_PARTS, Header, flag_of
from carom.recording.schema.palette import LINES
from carom.recording.schema.paths import ENERGY, STEPS
from carom.scene.extensions import names_of
from carom.scene.forces import FORCES, ForceKind, kind_called
from carom.state.checkpoint import Checkpoint, ContactCheckpoint
from carom.state.energies import Energy
from carom.state.frame import Frame

BLUE, RED, GREEN, PURPLE, GREY, ORANGE = (LINES[name] for name in ("blue", "red", "green", "purple", "grey", "orange"))
THIN, THICK = 2.0, 4.0  # widths of curves in screen points; thinner curves would blend with the background


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot of series with the same unit."""

    title: str
    unit: str

    def name_in(self, header: Header) -> str:
        """Return the title of the plot, with its unit."""
        unit, title = header.plot_unit(self.unit), self.title
        if header.engine and self == _TAKEN:
            title = "Energy lost while touching"
        return title if unit == "1" else f"{title} ({unit})"


PLOTS = (  # plots from left to right; the plots of a column are tabs
    (Plot("Energy", "J"),),
    (Plot("Energy lost", "J"), Plot("Relative error", "1")),
    (Plot("Contacts", "1"), Plot("Contact force", "N"), Plot("Impacts", "1/s"), Plot("Solver", "1")),
    (Plot("Overlap / radius", "1"), Plot("dt", "s"), Plot("Piston", "m")),
)
(_ENERGY,), (_TAKEN, _ERROR), (CONTACTS, _FORCE, _IMPACTS, _SOLVER), (_OVERLAP, _DT, _PISTON) = PLOTS
_OUTFLOW = Plot("Outflow", "1/s")  # exists only in scenes with outlets
_TABLE = "record.impacts"  # key of the scene that must not be "none" for series of the contact table
# sources of work on bodies: their work is recorded, although they are not parts of the model
_DRIVES = ("wall.motion", "piston", "release", "driving-field", "shear")
# Component of a series or impact: the value in the unit of its plot. The viewer cannot scale a curve (Rerun 0.41), so
# scaled values are also recorded if the scene has a section [units].
IN_PLOT = "in_plot"
IMPULSES = Plot("Impulse of impacts", "N s")  # has one point for each recorded impact, read from the row of the impact


class Sample(NamedTuple):
    """The arguments from which a scalar is computed."""

    frame: Frame
    before: Frame | Checkpoint | None  # the previous frame; None for the first frame
    overlap: float  # m, deepest overlap of the frame's contacts; 0 without contacts
    relative_overlap: float  # largest overlap, relative to the smaller radius of its two bodies
    colours: float  # number of colours that contacts have
    energy: Energy  # energies of the frame, J
    mass: FloatArray  # (n,) kg
    radius: FloatArray  # (n,) m


@dataclass(frozen=True, slots=True)
class Series:
    """One scalar of every frame."""

    path: str
    unit: str
    legend: str  # name in the legend of the plot
    colour: int  # 0xRRGGBBAA
    plot: Plot | None  # one of `PLOTS`; None if the series is recorded, but not plotted
    value: Callable[[Sample], float]
    meaning: str  # meaning, for docs/recording.md
    # part of the model (`carom explain`) that the series requires; None means that the series is always recorded
    part: str | None = None
    width: float = THIN
    inside: bool = False  # whether the series describes carom's own solver, so that runs of other engines lack it
    # whether a constant series is not plotted; a series of zeros is never plotted
    flat_is_dull: bool = False

    def name_in(self, header: Header) -> str:
        """Return the name in the legend of a plot, with the unit."""
        unit = header.plot_unit(self.unit)
        return self.legend if unit == "1" else f"{self.legend} ({unit})"

    def __post_init__(self) -> None:
        if self.path.partition("/")[0] not in (ENERGY, STEPS):
            raise ValueError(f"the series {self.path}: its path must begin with {ENERGY}/ or {STEPS}/")
        if self.part is not None and self.part not in RECORDED_PARTS and self.part not in registry.installed("forces"):
            raise ValueError(f"the series {self.path}: no part {self.part}; use one of {', '.join(RECORDED_PARTS)}")


def _impact_rate(sample: Sample) -> float:
    """Return the impacts per simulated time (1/s) since the previous frame."""
    frame, before = sample.frame, sample.before
    if before is None or frame.time <= before.time:
        return 0.0
    return (frame.books.moments.impacts - before.books.moments.impacts) / (frame.time - before.time)


def _largest_force(sample: Sample) -> float:
    """Return the largest normal force (N) of a lasting contact: its impulse divided by the step."""
    rows, dt = sample.frame.contact_rows, sample.frame.dt
    if rows is None or dt <= 0.0:
        return 0.0
    return float(rows["normal_impulse"][rows["mode"] != IMPACT_MODE].max(initial=0.0)) / dt


def _energy_of(kind: ForceKind) -> Series:
    """Return the series of a force: its potential energy or, without a potential, the energy that it has removed."""
    path, plot, value = f"{ENERGY}/ledger/{kind.loss}", _TAKEN, lambda s: s.energy.ledger.entry(kind.loss)
    if kind.potential:
        path, plot, value = f"{ENERGY}/{kind.potential}", _ENERGY, lambda s: s.energy.term(kind.potential)
    return Series(path, "J", kind.legend, LINES[kind.colour], plot, value, kind.meaning, kind.recorded_with)


def _piston(state: Frame | Checkpoint, number: int) -> FloatArray:
    """Return the row of a piston in `PistonMotion.state`, (3,)."""
    pistons = _contacts_of(state).pistons
    assert pistons is not None, "the scene has a piston"
    return np.asarray(pistons[number])


def _contacts_of(state: Frame | Checkpoint) -> ContactCheckpoint:
    memory: ContactCheckpoint | None = getattr(state, "memory" if hasattr(state, "memory") else "contacts")
    assert memory is not None, "contacts last in the scene"
    return memory


def _force_on_piston(sample: Sample, number: int) -> float:
    """Return the mean force (N) by which bodies pressed a piston since the previous frame."""
    frame, before = sample.frame, sample.before
    if before is None or frame.time <= before.time:
        return 0.0
    return float(_piston(frame, number)[2] - _piston(before, number)[2]) / (frame.time - before.time)


def _rate_through(outlet: int, column: int) -> Callable[[Sample], float]:
    """Return the rate (1/s or kg/s) through an outlet since the previous frame, as a function of a sample."""

    def rate(sample: Sample) -> float:
        frame, before = sample.frame, sample.before
        if before is None or frame.time <= before.time:
            return 0.0
        now, then = (_contacts_of(state).release for state in (frame, before))
        assert now is not None and then is not None, "the scene has outlets"
        return float(now.totals[outlet, column] - then.totals[outlet, column]) / (frame.time - before.time)

    return rate


def _of_piston(number: int) -> Iterator[Series]:
    """Yield the series of a piston; the first piston has number 0, and its series have names without a number."""
    after, called = (f"_{number}", f"piston {number}") if number else ("", "piston")
    colours = list(LINES.values())
    blue, orange = (colours[(colours.index(first) + number) % len(colours)] for first in (BLUE, ORANGE))
    yield Series(
        f"step/piston{after}_position",
        "m",
        called,
        blue,
        _PISTON,
        lambda s: float(_piston(s.frame, number)[0]),
        f"displacement of the {called} along its normal",
        "piston",
    )
    yield Series(
        f"step/piston{after}_velocity",
        "m/s",
        called,
        blue,
        None,
        lambda s: float(_piston(s.frame, number)[1]),
        f"velocity of the {called} along its normal",
        "piston",
    )
    yield Series(
        f"step/piston{after}_force",
        "N",
        f"on the {called}",
        orange,
        _FORCE,
        lambda s: _force_on_piston(s, number),
        f"mean force of the bodies on the {called} since the previous frame",
        "piston",
    )


def piston_series(count: int) -> Iterator[Series]:
    """Yield the series of all pistons but the first, whose series are in `SERIES`."""
    for number in range(1, count):
        yield from _of_piston(number)


def outlet_series(names: Iterable[str]) -> Iterator[Series]:
    """Yield the series of outlets, given their names."""
    for k, name in enumerate(names):
        colour = list(LINES.values())[k % len(LINES)]
        rate, mass = _rate_through(k, 0), _rate_through(k, 1)
        yield Series(f"step/outlet_{k}", "1/s", name, colour, _OUTFLOW, rate, f"bodies that left by {name}", "release")
        yield Series(f"step/outlet_{k}_mass", "kg/s", name, colour, None, mass, f"mass that left by {name}", "release")


# A table with two lines for each series: first name and style, then value, meaning and part of the model.
# fmt: off
SERIES = (
    Series("energy/translational", "J", "translational", BLUE, _ENERGY,
           lambda s: s.energy.translational, "Σ ½ m v²"),
    Series("energy/rotational", "J", "rotational", RED, _ENERGY,
           lambda s: s.energy.rotational, "Σ ½ I ω²", "spin"),
    *(_energy_of(kind) for kind in FORCES if kind.potential),
    Series("energy/total", "J", "total", GREY, _ENERGY,
           lambda s: s.energy.total, "sum of the energies above", width=THICK),
    Series("energy/ledger/restitution", "J", "restitution", palette.IMPACTS, _TAKEN,
           lambda s: s.energy.ledger.restitution, "removed by normal impulses since the start", "contact"),
    Series("energy/ledger/friction", "J", "friction", palette.FRICTION, _TAKEN,
           lambda s: s.energy.ledger.friction, "removed by tangential impulses since the start", "friction",
           inside=True),
    Series("energy/ledger/stabilisation", "J", "stabilisation (put in)", GREEN, _TAKEN,
           lambda s: s.energy.ledger.stabilisation, "added by the correction of overlaps since the "
               "start", "stabilisation"),
    *(_energy_of(kind) for kind in FORCES if kind.loss),
    Series("energy/ledger/walls", "J", "moving walls", palette.SLATE, _TAKEN,
           lambda s: s.energy.ledger.entry("walls"), "removed by moving walls since the start; negative if they drive "
               "the bodies", "wall.motion"),
    Series("energy/ledger/driving_field", "J", "driving field", GREY, _TAKEN,
           lambda s: s.energy.ledger.entry("driving_field"), "removed by the uniform field along periodic axes since "
               "the start; negative if it drives the bodies", "driving-field"),
    Series("energy/ledger/shear", "J", "shear", palette.SLATE, _TAKEN,
           lambda s: s.energy.ledger.entry("shear"), "removed by the shear of a periodic box since the start; negative "
               "if it drives the bodies", "shear"),
    Series("energy/ledger/passage", "J", "bodies that leave", PURPLE, _TAKEN,
           lambda s: s.energy.ledger.entry("passage"), "removed by bodies that leave since the start; negative if "
               "bodies that enter bring more", "release"),
    Series("energy/integration_error", "J", "integration error", RED, None,
           lambda s: s.energy.integration_error, "change of the total that the ledger does not explain"),
    Series("energy/relative_error", "1", "integration error / energy scale", RED, _ERROR,
           lambda s: s.energy.relative_change(s.energy.integration_error), "integration error over the energy scale; "
               "0 within the rounding of the total"),
    Series("step/dt", "s", "dt", palette.SLATE, _DT,
           lambda s: s.frame.dt, "length of the step; 0 at step 0", flat_is_dull=True),
    Series("step/error", "1", "expected error / size", PURPLE, _ERROR,
           lambda s: s.frame.expected_error, "expected error of positions over the size of the system", "accuracy"),
    Series("step/contacts", "1", "contacts", palette.CONTACTS, CONTACTS,
           lambda s: len(s.frame.contacts.pairs), "contacts in the step", "contact"),
    Series("step/contact_force", "N", "largest force of a contact", palette.CONTACTS, _FORCE,
           _largest_force, "largest normal force of a contact other than an impact: its impulse over the step",
           _TABLE, inside=True),
    Series("step/impact_rate", "1/s", "impacts", palette.IMPACTS, _IMPACTS,
           _impact_rate, "impacts since the previous frame, per time", "contact"),
    Series("step/colours", "1", "colours (stages)", PURPLE, _SOLVER,
           lambda s: s.colours, "colours of the contacts in the step", "contact", inside=True),
    Series("step/sweeps", "1", "sweeps", GREEN, _SOLVER,
           lambda s: s.frame.sweeps, "passes of the solver over the contacts in the step", "contact", inside=True),
    Series("step/overlap", "m", "deepest overlap", PURPLE, None,
           lambda s: s.overlap, "deepest overlap of a contact", "contact"),
    Series("step/relative_overlap", "1", "deepest overlap / smaller radius", palette.SLATE, _OVERLAP,
           lambda s: s.relative_overlap, "largest overlap over the smaller radius of the pair", "contact"),
    *_of_piston(0),
    Series("step/present", "1", "bodies", BLUE, None,
           lambda s: len(s.mass) - (0 if s.frame.waits is None else int(np.count_nonzero(s.frame.waits))),
           "bodies that do not wait to enter, and have not left", "release"),
)
# fmt: on


# Legends and meanings, by path, for other engines, since their impulses are unknown.
OF_ENGINES = {
    "energy/ledger/restitution": (
        "lost while touching",
        "lost since the start by touching bodies, to contacts and through errors of the engine",
    ),
    "energy/integration_error": (
        "changed without contact",
        "change of the total without contact, and gains in contact beyond earlier losses",
    ),
    "energy/relative_error": (
        "energy changed without contact / scale",
        "change without contact over the energy scale",
    ),
}


def all_series(extensions: Mapping[str, str]) -> tuple[Series, ...]:
    """Return carom's own series, and the series of installed extensions that a scene uses; see `extensions_of`."""
    forces = [name for name in names_of("forces", extensions) if name in registry.installed("forces")]
    others = [name for name in names_of("series", extensions) if name in registry.installed("series")]
    energies = (_energy_of(kind_called(name)) for name in forces)
    return (*SERIES, *energies, *(registry.load("series", name) for name in others))


def all_plots(series: Iterable[Series]) -> tuple[tuple[Plot, ...], ...]:
    """Return the plots that contain the given series, from left to right; plots of extensions are the last tabs."""
    known = {plot for column in PLOTS for plot in column}
    others = dict.fromkeys(each.plot for each in series if each.plot is not None and each.plot not in known)
    return (*PLOTS[:-1], (*PLOTS[-1], *others))


def recorded(header: Header) -> Iterator[Series]:
    """Return the series that a recording of this scene has."""
    for series in SERIES if header.engine else _possible(header):
        if (series.inside and header.engine) or not (series.part is None or header.models(series.part)):
            continue
        if header.engine and series.path in OF_ENGINES:
            legend, meaning = OF_ENGINES[series.path]
            yield replace(series, legend=legend, meaning=meaning)
        else:
            yield series


def _possible(header: Header) -> tuple[Series, ...]:
    return (*all_series(header.extensions), *piston_series(len(header.pistons)), *outlet_series(header.outlets))


def names_below(root: str) -> list[str]:
    """Return the last parts of the paths of all series below a root, in order."""
    return [series.path.rpartition("/")[2] for series in SERIES if series.path.startswith(f"{root}/")]


def is_recorded(root: str, name: str, properties: Mapping[str, Any]) -> bool:
    """Return whether a recording with these properties has a series, given the first and last name in its path."""
    rows = [row for row in SERIES if row.path.startswith(f"{root}/") and row.path.endswith(f"/{name}")]
    rows = [row for row in rows if not (row.inside and properties.get("engine"))]
    return any(row.part is None or bool(properties.get(flag_of(row.part))) for row in rows)


ONCE = "once, however long it is"

# entity → part of the model that it requires
_PARTS = {paths.CONTACTS: "contact", paths.TORQUE: "torque", paths.ANGULAR_ACCELERATION: "torque"}
_ALWAYS = {  # entity → reason why it is always recorded
    paths.DT_LIMIT: "adaptive or not",
    paths.PHASE: "where it changes",
    paths.EVENTS: "where something happens",
    paths.FINGERPRINT: "the bits of every frame",
    paths.MOMENTUM: "momentum",
    paths.CHECKPOINT: "the exact state, at times",
    paths.STATIC_STATE: ONCE,
    paths.ABOUT: ONCE,
    paths.LEGEND: ONCE,
    paths.SCENE: ONCE,
    paths.SCENE_TOML: ONCE,
    paths.WORLD: ONCE,
}


class Content(NamedTuple):
    """An entity: whether a recording of the scene contains it, and why."""

    path: str
    recorded: bool
    why: str


def _contact_data(header: Header) -> Iterator[Content]:
    records, without = header.records_contacts, 'record.impacts = "none"' if header.collides else "no contact"
    kept = "all" if header.record_impacts == "all" else "at most a fifth of the file, else the largest"
    table = [(series.path, "contact") for series in SERIES if series.part == _TABLE]
    for path, why in (*table, (paths.IMPACTS, kept), (paths.FORCE_NORMAL, "the largest impulses")):
        yield Content(path, records, why if records else without)
    spins, rubs = records and header.spins, records and header.has_friction
    turns = records and header.has_torque
    without_spins, without_friction = without if header.spins else "no spin", "no friction" if records else without
    for path in paths.OF_IMPACTS:
        yield Content(path, turns, "of the bodies that meet" if turns else "no torque" if records else without)
    yield Content(paths.IMPACT_SPINS, spins, "of the bodies that meet" if spins else without_spins)
    yield Content(paths.FORCE_FRICTION, rubs, "the same contacts" if rubs else without_friction)


def contents(header: Header, needs: Requirements) -> Iterator[Content]:
    """Return every entity that a recording may have."""
    parts = {part.name: part.modelled for part in needs.parts}
    yield Content(paths.BODIES, True, "centres and quaternions" if header.has_orientation else "centres")
    needed = [*_PARTS.items(), *((series.path, series.part) for series in _possible(header))]
    for path, name in needed:
        if name == _TABLE:  # listed in `_contact_data`
            continue
        there = name is None or (header.models(name) if name in _DRIVES else parts[name])
        yield Content(path, there, (name or "always") if there else f"no {name}")
    yield from _contact_data(header)
    for path, why in _ALWAYS.items():
        yield Content(path, True, why)
    moving = header.drives
    yield Content(paths.MOVING, moving, "planes and walls, each" if moving else "no motion")
    for path, part, without in (
        (paths.PLANES, header.planes, "no planes"),
        (paths.WALLS, header.walls, "no walls"),
        (paths.SHAPES, header.shapes, "no [[wall]]"),
        (paths.PERIODIC_BOX, header.box, "no periodic box"),
    ):
        yield Content(path, part is not None, without if part is None else ONCE)
