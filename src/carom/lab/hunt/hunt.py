"""Draws scenes, checks the laws that every scene must keep, and saves each shrunk counterexample with its recording."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from carom.errors import ExperimentError, PhysicsError, SceneError
from carom.lab.hunt.alone import STEPS, Ending, difference
from carom.lab.hunt.documents import Document
from carom.lab.hunt.random_scenes import IMPACTS, SMOOTH, drawn
from carom.lab.run_summary import Observation, said_by
from carom.lab.shrink.condition import condition_from
from carom.lab.shrink.reducer import Reducer
from carom.lab.shrink.shrunk_file import key_of, text_of, write
from carom.lab.shrink.trials import Budget, Condition, OutOfTime, observe
from carom.lab.shrink.whole_run import applies, moved_by_shorter_steps
from carom.physics.space import Space
from carom.plan import auto
from carom.plan.features import Requirements, require
from carom.recording.read.recording import Recording
from carom.recording.write.whole_file import output_folder
from carom.runs.environment import Interrupts
from carom.runs.run import recording_space, simulate
from carom.scene.load import Scene, scene_from_text
from carom.scene.wording import command
from carom.sharing.report import report

LEDGER = 1e-9  # error relative to the energy scale in flight without forces: some 10⁷ roundings of 10⁻¹⁶
CONSERVED = 1e-9  # largest change of a conserved momentum, relative to the largest momentum


@dataclass(frozen=True, slots=True)
class HuntedLaw:
    """A law: its name, its statement, the condition under which a run violates it, and the scenes that it covers."""

    name: str
    says: str
    condition: str
    applies: Callable[[Scene, Requirements], bool]
    kinds: tuple[str, ...] = ()  # kinds of scenes that the law covers; empty: all kinds


def laws_of(scene: Scene, kind: str = "") -> list[HuntedLaw]:
    """Return the laws that apply to a scene of a kind."""
    needs = require(scene)
    return [law for law in LAWS if (not law.kinds or kind in law.kinds) and law.applies(scene, needs)]


def _flies_exactly(scene: Scene, needs: Requirements) -> bool:
    """Return whether the integrator's only error is rounding, so that the ledger explains all energy changes."""
    exact = not auto.integrator(scene).controls_error and _falls_exactly(scene)
    # with fixed bodies in a field, the ledger contains the work of the field only to the next order
    pushed = any(scene.gravity.uniform) and any(body.fixed for body in scene.body)
    return exact and not pushed and not needs.gravity.modelled and scene.drag is None


def _falls_exactly(scene: Scene) -> bool:
    """Return whether falling bodies conserve energy; with semi-implicit Euler, they lose ½ M g² dt² in each step."""
    return auto.integrator(scene).order > 1 or not any(scene.gravity.uniform)


def _is_free(scene: Scene, needs: Requirements) -> bool:
    """Return whether nothing fixed absorbs momentum, and forces between bodies are exactly opposite."""
    return not scene.anchored and not needs.tree.modelled


def _corrects_overlaps(scene: Scene, needs: Requirements) -> bool:
    """Return whether bodies may rest in contact, and overlaps are corrected."""
    contact = scene.contact
    corrects = contact.solver == "lasting" and contact.stabilisation == "split" and not contact.allow_overlap
    return needs.resting.modelled and corrects


def _invariance(name: str, says: str, *kinds: str) -> HuntedLaw:
    return HuntedLaw(name, says, f"invariance {name}", lambda scene, needs: applies(name, scene), kinds)


ALONE = HuntedLaw(
    "alone", "the bits do not depend on what ran before in the process", "", lambda *_: True
)  # checked only with `--alone`
REFINED = HuntedLaw(
    "shorter steps",
    "with default steps, steps a quarter as long tell the same story",
    "shorter steps differ",
    lambda *_: True,
)  # checked on the scene that `by_default` returns
ERROR = HuntedLaw("error", "a run reaches its end or reports an error", "crash", lambda *_: True)
LAWS = [
    ERROR,
    HuntedLaw("finite", "positions, velocities and the energy stay finite", "not finite", lambda *_: True),
    HuntedLaw(
        "ledger", "the ledger explains every change of the energy", f"energy.max_error > {LEDGER:g}", _flies_exactly
    ),
    HuntedLaw("momentum", "momentum is conserved", f"momentum.max_error > {CONSERVED:g}", _is_free),
    HuntedLaw(
        "angular momentum",
        "angular momentum is conserved",
        f"angular_momentum.max_error > {CONSERVED:g}",
        lambda scene, needs: (
            _is_free(scene, needs)
            and scene.domain.boundary == "open"
            and _falls_exactly(scene)
            and not auto.integrator(scene).controls_error
        ),
    ),
    HuntedLaw(
        "impulses",
        "impulses and forces explain every change of velocities and of the ledger",
        "expect.contact_audit",
        lambda scene, needs: needs.contact.modelled,
    ),
    HuntedLaw(
        "signs",
        "contacts dissipate what their laws say",
        "warning dissipation",
        lambda scene, needs: needs.impact_time.modelled and scene.time.fixed_dt is None,
    ),
    HuntedLaw("overlap", "no overlap above 5 % of a radius persists", "overlap at rest", _corrects_overlaps),
    HuntedLaw(
        "replay", "the bits do not depend on threads, checkpoints or the search", "replay differs", lambda *_: True
    ),
    _invariance("scaling", "units scaled by powers of two change no bit"),
    _invariance("mirror", "a mirror image has the same bits"),
    _invariance("arrays", "bodies given as arrays move in the same way, bit for bit"),
    _invariance("translation", "a displaced scene runs in the same way", SMOOTH, IMPACTS),
    _invariance("rotation", "a rotated scene runs in the same way", SMOOTH, IMPACTS),
    _invariance("boost", "a scene that moves as a whole runs in the same way", SMOOTH, IMPACTS),
    _invariance("numbering", "bodies in another order move in the same way", SMOOTH, IMPACTS),
    _invariance("steps", "the energy error decreases with the step as the order of the integrator predicts", SMOOTH),
]


# keys, by section, that choose a method or its steps; with their defaults, shorter steps stay within the tolerances
_METHOD = {
    "time": ("max_dt", "target_dx", "cfl", "pull_fraction", "smoothing", "velocity_limit", "fixed_dt", "integrator"),
    "contact": ("timing", "stabilisation", "sweeps", "solver", "colouring"),
}


def by_default(document: Document) -> Document | None:
    """Return a scene with the default method and steps; None if bodies overlap at the start, or an accuracy is set."""
    if document.get("contact", {}).get("allow_overlap") or "accuracy" in document["time"]:
        return None
    changed = dict(document)
    for section, keys in _METHOD.items():
        changed[section] = {key: value for key, value in document.get(section, {}).items() if key not in keys}
    return changed


AUDIT = 1e-9  # largest relative speed that impulses do not explain: some 10⁷ roundings
SHARE = 0.2  # fraction of the budget for shrinking a single miss
LONGEST = 60.0  # s, time limit for shrinking a single miss


@dataclass(frozen=True, slots=True)
class Finding:
    """A law that a scene violates."""

    law: HuntedLaw
    condition: Condition | None  # condition by which a smaller scene violates the law; None: the scene is not shrunk
    index: int  # index among all scenes of the seed
    scene: Scene
    said: str  # text about the violation


@dataclass(frozen=True, slots=True)
class Miss:
    """A finding that was saved, or counted as similar to a saved one."""

    law: str
    index: int  # index among all scenes of the seed
    said: str  # text about the violation
    path: Path | None  # path of the reduced scene; None if a similar scene was saved before
    bodies: int


@dataclass(slots=True)
class Tally:
    """The counts of a hunt so far."""

    seed: int
    scenes: int = 0
    refused: int = 0
    stated: int = 0  # number of runs that ended with a stated reason
    given_up: int = 0  # number of runs that were abandoned after too many steps
    misses: list[Miss] = field(default_factory=list)
    seconds: float = 0.0
    stopped: str = ""


@dataclass(slots=True)
class Hunt:
    """Hunts for scenes that violate a law. Raises RecordingError if its folder cannot be made."""

    seed: int
    folder: Path  # folder in which misses are saved
    seconds: float = math.inf  # s, the budget
    first: int = 0  # number of the first scene
    most: int | None = None  # the largest number of scenes
    watch: Callable[[Tally], None] = lambda tally: None  # called after each scene
    alone: bool = False  # whether each scene also runs alone in a new process
    tally: Tally = field(init=False)
    _new: bool = field(init=False)  # whether the hunt made the folder
    _ran: list[int] = field(default_factory=list)  # numbers of the scenes that ran

    def __post_init__(self) -> None:
        self.tally = Tally(self.seed)
        self._new = not self.folder.exists()
        output_folder(self.folder)

    def hunt(self) -> Tally:
        """Hunt until the budget is spent, all scenes are checked, or the user ends the hunt."""
        try:
            with Interrupts() as interrupts:
                budget = Budget(self.seconds, interrupts)
                for index in itertools.islice(itertools.count(self.first), self.most):
                    budget.check()
                    for finding in self.judge(index, budget):
                        self._file(finding)
                    self.tally.seconds = budget.spent
                    self.watch(self.tally)
        except OutOfTime as ended:
            self.tally.stopped = str(ended)
        finally:
            if self._new:
                with contextlib.suppress(OSError):  # a folder that contains misses stays
                    self.folder.rmdir()
        return self.tally

    def judge(self, index: int, budget: Budget) -> list[Finding]:
        """Draw a scene and run it; return the violated laws."""
        found = drawn(self.seed, index)
        self.tally.scenes += 1
        try:
            scene = Scene.from_dict(found.document | {"expect": {"contact_audit": AUDIT}})
            laws = laws_of(scene, found.kind)
        except SceneError:
            self.tally.refused += 1
            return []
        try:
            seen = observe(Space(scene, threads=1), budget, steps=STEPS)
            if seen is None:
                self.tally.given_up += 1
                return []
            self.tally.stated += bool(seen.error)
            found_here = self._leaks(index, scene, seen, budget) if self.alone else []
            self._ran.append(index)
            conditions = [(law, condition_from(law.condition)) for law in laws]
            found_here += self._moves(index, found.document, budget)
            return found_here + [
                Finding(law, condition, index, scene, condition.said(seen))
                for law, condition in conditions
                if condition.holds(seen)
            ]
        except (OutOfTime, ExperimentError):
            raise
        except SceneError:
            self.tally.refused += 1
            return []
        except PhysicsError:
            self.tally.stated += 1
            return []
        except Exception as error:  # an error before the first step is also a failure
            return [Finding(ERROR, condition_from(ERROR.condition), index, scene, said_by(error))]

    def _moves(self, index: int, document: Document, budget: Budget) -> list[Finding]:
        """Compare a run with default steps to a run with shorter steps."""
        changed = by_default(document)
        if changed is None:
            return []
        try:
            scene = Scene.from_dict(changed)
        except SceneError:
            return []
        if require(scene).contact.modelled and auto.timing(scene) == "end-of-step":
            return []  # the stated error of the method is of first order
        if scene.admits:
            return []  # bodies enter and leave at the beginnings of steps, so shorter steps change the run
        said = moved_by_shorter_steps(scene, STEPS, lambda status: budget.check())
        return [Finding(REFINED, condition_from(REFINED.condition), index, scene, said)] if said else []

    def _leaks(self, index: int, scene: Scene, seen: Observation, budget: Budget) -> list[Finding]:
        """Compare a run with the same run in a new process."""
        here = Ending(seen.space.step, seen.space.fingerprint(), seen.error)
        said = difference(self.seed, index, here, self._ran, budget)
        return [Finding(ALONE, None, index, scene, said)] if said else []

    def _file(self, finding: Finding) -> None:
        """Shrink a scene that violates a law, record it, and add it to the misses."""
        law, index, said, bodies = finding.law, finding.index, finding.said, finding.scene.count
        if any(miss.law == law.name for miss in self.tally.misses):
            self.tally.misses.append(Miss(law.name, index, said, None, bodies))
            return
        path = self.folder / f"{law.name.replace(' ', '-')}-{self.seed}-{index}.toml"
        small = finding.scene.toml
        try:
            if finding.condition is None:
                raise ExperimentError("it depends on the scenes before it")
            result = Reducer(finding.condition, min(LONGEST, SHARE * self.seconds)).reduce(finding.scene)
            key = key_of(small, finding.condition.text)
            how = command("hunt", "--seed", self.seed, "--from", index, "--scenes", 1)
            small = text_of(result, f"{law.name}: {law.says}", key, how)
            bodies, said = result.bodies, result.said
        except OutOfTime:
            raise
        except Exception as error:  # a fault before the first step leaves nothing to shrink
            said = f"{said} (not shrunk: {said_by(error)})"
        write(path, small)
        # record the reduced scene up to its end or failure, and pack a report, both in files beside the scene
        recorded = path.with_suffix(".rrd")
        try:
            simulate(recording_space(scene_from_text(small, str(path)), threads=1), recorded, force=True)
            report(Recording.open(recorded), path.with_suffix(".zip"))
        except Exception:  # the error itself may end the run
            for file in (recorded, path.with_suffix(".zip")):
                if not file.exists() or not file.stat().st_size:
                    file.unlink(missing_ok=True)
        self.tally.misses.append(Miss(law.name, index, said, path, bodies))


def as_document(tally: Tally) -> dict[str, Any]:
    """Return a tally as a JSON document."""
    misses = [
        {"law": m.law, "scene": m.index, "said": m.said, "file": m.path and str(m.path), "bodies": m.bodies}
        for m in tally.misses
    ]
    numbers = {name: getattr(tally, name) for name in ("seed", "scenes", "refused", "stated", "given_up", "seconds")}
    return numbers | {"stopped": tally.stopped, "misses": misses}
