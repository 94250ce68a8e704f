"""The results of a run: its extremes as closing properties, and the verdicts on the promises in [expect]."""

from __future__ import annotations

from dataclasses import dataclass

from carom.physics.diagnostics.extremes import Extreme, Extremes
from carom.recording.schema.header import Scalar
from carom.scene.schema import Scene
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem


@dataclass(frozen=True, slots=True)
class Verdict:
    """A promise: its limit, the measured value, and the worst time.

    A promise about the end is not judged in a run of another length, and counts as met.
    """

    name: str
    limit: float
    measured: float
    worst: Extreme | None = None  # None if no extreme corresponds to it
    at_least: bool = False  # whether the limit is a lower bound
    note: str = ""  # explains the measured quantity if the name does not
    promised_at: float | None = None  # s, the promised end, if the run ended at another time

    @property
    def judged(self) -> bool:
        """Whether the promise applies to this run."""
        return self.promised_at is None

    @property
    def met(self) -> bool:
        """Whether the promise was kept or is not judged; NaN counts as broken."""
        if not self.judged:
            return True
        return self.measured >= self.limit if self.at_least else self.measured <= self.limit

    @property
    def bound(self) -> str:
        """The kind of bound, in words."""
        return "at least" if self.at_least else "at most"

    def __str__(self) -> str:
        return self.text(SI)

    def text(self, units: UnitSystem) -> str:
        """Describe the promise and the measurement, with times in the units of the scene."""
        missed = "" if self.met else "; missed"
        if self.promised_at is not None:
            missed = f" at t = {units.text(self.promised_at, TIME)}; not judged"
        note = f", {self.note}" if self.note else ""
        return f"{self.name}: {self.measured:.3g}{note} ({self.bound} {self.limit:.3g}{missed})"


def judge(scene: Scene, extremes: Extremes, time: float) -> list[Verdict]:
    """Compare every promise of a scene with the extremes of its run, which ended at ``time`` (s).

    A quantity that the scene does not conserve, such as angular momentum in a periodic box or any momentum where
    something is fixed, counts as infinitely wrong. The final kinetic energy is judged only if the run ends at the
    promised time; the number of impacts and the warnings are also judged if it ends later.
    """
    expect, end = scene.expect, scene.expect.duration or scene.time.duration
    elsewhere = {"final_kinetic": end if time != end else None, "impacts": end if time < end else None}
    measured = {
        "energy_error": (_value(extremes.energy_fault), extremes.energy_fault),
        "energy_gain": (extremes.energy_gain.value, extremes.energy_gain),
        "momentum_error": (_or_infinite(extremes.momentum_error), extremes.momentum_error),
        "angular_momentum_error": (_or_infinite(extremes.angular_momentum_error), extremes.angular_momentum_error),
        "max_overlap": (_value(extremes.overlap), extremes.overlap),
        "final_kinetic": (extremes.kinetic.value, extremes.kinetic),
        "impacts": (extremes.impacts, None),
        "contact_audit": (_or_infinite(extremes.contact_audit), extremes.contact_audit),
    }
    gained = extremes.energy_fault is not None and extremes.energy_fault is not extremes.energy_error
    notes = {"energy_error": "added by contact impulses"} if gained else {}
    verdicts = [
        Verdict(
            name,
            limit,
            value,
            worst,
            at_least=name == "impacts",
            note=notes.get(name, ""),
            promised_at=elsewhere.get(name),
        )
        for name, (value, worst) in measured.items()
        if (limit := getattr(expect, name)) is not None
    ]
    return verdicts + [
        Verdict(f"warned_{kind}", 1.0, float(kind in extremes.warned), at_least=True, promised_at=elsewhere["impacts"])
        for kind in expect.warned
    ]


def _or_infinite(error: Extreme | None) -> float:
    return float("inf") if error is None else error.value


def _value(extreme: Extreme | None) -> float:
    return extreme.value if extreme else 0.0


def closing_of(extremes: Extremes) -> dict[str, Scalar]:
    """Return the extremes of a run, with the names of bodies and planes, under the dotted keys of `outcome`."""
    summary: dict[str, Scalar] = {
        "contacts.total": extremes.total_contacts,
        "contacts.impacts": extremes.impacts,
    }
    if extremes.momentum_error is not None:
        summary["momentum.max_error"] = extremes.momentum_error.value
    if extremes.angular_momentum_error is not None:
        summary["angular_momentum.max_error"] = extremes.angular_momentum_error.value
    if extremes.energy_error is not None:
        summary["energy.max_error"] = extremes.energy_error.value
    summary["energy.reference"] = extremes.energy_scale  # J; the viewer cannot load the key "energy.scale"
    summary["energy.contact_gain"] = extremes.contact_gain.value
    if extremes.overlap is not None:
        summary["contacts.max_overlap"] = extremes.overlap.value
    for name in ("energy_error", "impact", "overlap", "contacts"):
        moment: Extreme | None = getattr(extremes, name)
        if moment is not None:
            key = f"moments.{name}"
            summary |= {f"{key}.value": moment.value, f"{key}.step": moment.step, f"{key}.time": moment.time}
            summary[f"{key}.bodies"] = ",".join(map(str, moment.bodies))
            summary[f"{key}.planes"] = ",".join(map(str, moment.planes))
            summary[f"{key}.between"] = moment.between
    return summary
