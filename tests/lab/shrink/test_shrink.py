"""Reduction of a scene to the smallest that still fails: conditions, passes, the whole."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from carom.arrays import FloatArray
from carom.errors import ExperimentError
from carom.lab.run_summary import Expression, Observation, Touches, UnknownNameError
from carom.lab.shrink import _lines
from carom.lab.shrink.condition import condition_from
from carom.lab.shrink.leave_out import cones, digits_of, fewest, rounded
from carom.lab.shrink.literal import Document
from carom.lab.shrink.reducer import Reducer, Reduction
from carom.lab.shrink.shrunk_file import commented
from carom.lab.shrink.trials import Judges, OutOfTime, Task, Trials
from carom.lab.shrink.whole_run import IMAGES, INVARIANCES, CommandShows, Image, Varies
from carom.physics.diagnostics.bookkeeper import BalanceAudit
from carom.physics.space import Space
from carom.runs.workers import Ended
from carom.scene.load import Scene, scene_from_text
from carom_command import carom

GAS: dict[str, Any] = {  # a dozen spheres that meet within a second
    "title": "Twelve spheres",
    "group": [{"count": 12, "radius": 0.3, "region": {"radius": 1.5}, "velocity": {"dispersion": 1.0}}],
    "gravity": {"constant": 0.0},
    "contact": {"restitution": 0.7, "static_friction": 0.0},
    "time": {"duration": 1.0},
    "expect": {"energy_error": 1e-6},
}


@pytest.fixture
def ledger_without_contacts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plant a fault: the ledger leaves out the energy that contacts absorb."""
    monkeypatch.setattr(BalanceAudit, "book", lambda audit, work: None)


def reduced(scene: dict[str, Any], condition: str | None = None) -> Reduction:
    return Reducer(condition_from(condition)).reduce(Scene.from_dict(scene))


@pytest.mark.usefixtures("ledger_without_contacts")
def test_a_missed_promise_shrinks_to_two_bodies_and_few_steps() -> None:
    result = reduced(GAS)
    assert result.minimal
    assert result.bodies == 2 and result.steps <= 2
    assert "energy_error" in result.said
    assert result.document["expect"] == GAS["expect"]
    assert len(commented(result.document, ["x"]).splitlines()) <= 25


@pytest.mark.usefixtures("ledger_without_contacts")
def test_the_reduced_file_runs_and_misses_the_same_promise(tmp_path: Path) -> None:
    (tmp_path / "gas.toml").write_text(Scene.from_dict(GAS).toml)
    made = carom("shrink", "gas.toml", "--while", "energy.max_error > 1e-6", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert "runs the scene tens to hundreds of times" in made.stderr
    text = (tmp_path / "gas-small.toml").read_text()
    assert "# Asked for: energy.max_error > 1e-6" in text and ", minimal" in text
    assert scene_from_text(text, "gas-small.toml").count == 2
    ran = carom("run", "gas-small.toml", "-o", "small.rrd", "--json", cwd=tmp_path)
    assert '"energy_error"' in ran.stdout
    again = carom("shrink", "gas.toml", "--while", "energy.max_error > 1e-6", cwd=tmp_path)
    assert "already the smallest scene" in again.stdout


@pytest.mark.usefixtures("ledger_without_contacts")
def test_a_recording_shrinks_like_its_scene(tmp_path: Path) -> None:
    (tmp_path / "gas.toml").write_text(Scene.from_dict(GAS).toml)
    carom("run", "gas.toml", "-o", "gas.rrd", cwd=tmp_path)
    made = carom("shrink", "gas.rrd", "-o", "small.toml", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert len(tomllib.loads((tmp_path / "small.toml").read_text())["body"]) == 2


@pytest.mark.usefixtures("ledger_without_contacts")
def test_a_spent_budget_leaves_a_scene_from_which_the_same_command_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gas.toml").write_text(Scene.from_dict(GAS).toml)
    shows = Trials.shows

    def shows_a_few(trials: Trials, document: Document, steps: int | None = None) -> Observation | None:
        if trials.count == 5:
            raise OutOfTime("the budget was spent")
        return shows(trials, document, steps)

    with monkeypatch.context() as patch:
        patch.setattr(Trials, "shows", shows_a_few)
        cut = carom("shrink", "gas.toml", cwd=tmp_path)
    assert "Not finished" in cut.stdout and ", unfinished" in (tmp_path / "gas-small.toml").read_text()
    carom("shrink", "gas.toml", cwd=tmp_path)
    text = (tmp_path / "gas-small.toml").read_text()
    assert ", minimal" in text and "of 12, " in text


@pytest.mark.usefixtures("ledger_without_contacts")
def test_materials_stay_only_where_the_failure_needs_them() -> None:
    hard = {"name": "hard", "restitution": 1.0}
    scene = GAS | {"material": [hard, {"name": "soft"}], "group": [GAS["group"][0] | {"material": "soft"}]}
    assert "material" not in reduced(scene).document


def test_an_impact_keeps_the_two_bodies_by_their_names() -> None:
    scene = GAS | {"group": [GAS["group"][0] | {"name": "ball"}]}
    space = Space(Scene.from_dict(scene), threads=1, record_contacts=True)
    rows = np.concatenate([frame.impacts for frame in space.run() if frame.impacts is not None])
    i, j = int(rows["i"][-1]), int(rows["j"][-1])
    result = reduced(scene, f"impact of {i} and ball {j}")
    assert [body["name"] for body in result.document["body"]] == [f"ball {i}", f"ball {j}"]


def test_an_exception_of_the_engine_shrinks_to_what_raises_it(monkeypatch: pytest.MonkeyPatch) -> None:
    book = BalanceAudit.book

    def raises_at_an_impact(audit: BalanceAudit, work: Any) -> None:
        if np.any(work):
            raise IndexError("index 7 is out of bounds")
        book(audit, work)

    monkeypatch.setattr(BalanceAudit, "book", raises_at_an_impact)
    result = reduced(GAS)
    assert result.bodies == 2 and result.said == "IndexError: index 7 is out of bounds"


def test_a_command_that_exits_with_0_keeps_a_scene(tmp_path: Path) -> None:
    (tmp_path / "gas.toml").write_text(Scene.from_dict(GAS).toml)
    made = carom("shrink", "gas.toml", "--while-command", "grep -q 'group 0 5' {}", cwd=tmp_path)
    assert "exited with 1; 0 means that the scene shows the failure" in made.stderr
    named = {"body": [{"name": "odd one"}, {"position": [9.0, 0.0, 0.0]}], "time": {"duration": 0.2, "fixed_dt": 0.05}}
    (tmp_path / "named.toml").write_text(Scene.from_dict(named | {"contact": {"enabled": False}}).toml)
    made = carom("shrink", "named.toml", "--while-command", "grep -q 'odd one'", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert len(tomllib.loads((tmp_path / "named-small.toml").read_text())["body"]) == 1


LONG: dict[str, Any] = {  # 64 steps
    "body": [{"name": "one"}, {"name": "two", "position": [9.0, 0.0, 0.0]}],
    "gravity": {"constant": 0.0},
    "time": {"duration": 64.0, "fixed_dt": 1.0},
    "record": {"every": "step"},
}
LASTS = "awk '/^duration/ {exit !($3 > 3.5)}' {}"  # exits with 0 if a scene lasts for more than 3.5 s


def stopped_after(candidates: int, monkeypatch: pytest.MonkeyPatch) -> Reduction:
    """Shrink what a command sees, until some candidates have run."""
    shows = Trials.shows

    def shows_a_few(trials: Trials, document: Document, steps: int | None = None) -> Observation | None:
        if trials.count == candidates:
            raise OutOfTime("the budget was spent")
        return shows(trials, document, steps)

    monkeypatch.setattr(Trials, "shows", shows_a_few)
    return Reducer(CommandShows(LASTS)).reduce(Scene.from_dict(LONG))


def test_the_time_that_a_command_needs_is_found_by_bisection(monkeypatch: pytest.MonkeyPatch) -> None:
    made = stopped_after(9, monkeypatch)  # the scene with its bodies written out, and log2(64) + 2 shorter ones
    assert made.steps == 4 and made.document["time"]["duration"] == 4.0
    assert made.candidates == 9 and 2 <= made.kept < 9 and not made.minimal


def test_a_spent_budget_keeps_the_smallest_scene_that_a_command_has_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    made = stopped_after(1, monkeypatch)
    assert (made.bodies, made.steps, made.kept) == (2, 64, 1) and made.stopped == "the budget was spent"
    with pytest.raises(ExperimentError, match="the scene fails, but the budget was spent after 0 smaller scenes"):
        stopped_after(0, monkeypatch)


def test_time_is_cut_from_both_ends_where_a_command_needs_the_middle(tmp_path: Path) -> None:
    """A ball passes x = 20 m between 20 and 21 s; the command wants a scene that begins before that and ends after."""
    ball = LONG["body"][0] | {"velocity": [1.0, 0.0, 0.0]}
    passes = tmp_path / "passes.py"
    passes.write_text(
        "import sys, tomllib\n"
        "scene = tomllib.load(open(sys.argv[1], 'rb'))\n"
        "x = scene['body'][0].get('position', [0.0])[0]\n"
        "sys.exit(not x < 20.5 < x + scene['time']['duration'])\n"
    )
    asked = CommandShows(f"{sys.executable} -S {passes}")
    made = Reducer(asked, keep=lambda document, said: None).reduce(Scene.from_dict(LONG | {"body": [ball]}))
    (body,), duration = made.document["body"], made.document["time"]["duration"]
    assert body["position"][0] < 20.5 < body["position"][0] + duration
    assert made.steps <= 2 and made.candidates < 60


def test_a_result_of_more_steps_is_not_called_a_part_of_fewer() -> None:
    made = Reduction({}, "it fails", 3, 76, (5, 72), [], 1.0, 9, 4)
    said = "\n".join(_lines(made, Path("small.toml")))
    assert "3 of 5 bodies are left, and 72 steps became 76: it fails" in said and "9 candidates, 4 kept, in 1 s" in said


def test_a_flaky_command_is_found_by_running_it_twice(tmp_path: Path) -> None:
    (tmp_path / "gas.toml").write_text(Scene.from_dict(GAS | {"time": {"duration": 0.05}}).toml)
    flaky = "test -e seen && exit 3; touch seen; true"
    made = carom("shrink", "gas.toml", "--while-command", flaky, cwd=tmp_path)
    assert made.returncode == 2 and "flaky" in made.stderr and not (tmp_path / "gas-small.toml").exists()


def test_bits_that_depend_on_the_threads_shrink_like_any_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    fingerprint = Space.fingerprint
    monkeypatch.setattr(Space, "fingerprint", lambda space: fingerprint(space) + (space.threads > 1))
    result = reduced(GAS, "replay differs")
    assert result.bodies == 1 and result.said == "a run on two threads ends with different bits"


@pytest.mark.slow
def test_impacts_at_the_end_of_long_steps_shrink_to_two_bodies_that_overlap_less_in_shorter_ones() -> None:
    late = GAS | {"contact": GAS["contact"] | {"timing": "end-of-step"}, "time": {"duration": 1.0, "fixed_dt": 0.2}}
    result = reduced(late, "shorter steps differ")
    assert result.bodies <= 2 and " with shorter steps" in result.said


@pytest.mark.parametrize(
    ("condition", "said"),
    [
        (None, r"nothing to shrink: every promise is kept: energy_error: .* \(at most 1e-06\)"),
        ("energy.max_error > 1e-3", r"nothing to shrink: energy.max_error is \d"),
        ("energy.max_eror > 1e-3", r'the summary has no energy.max_eror; did you mean "energy.max_error"\?'),
        ("expect.energy_eror", r'no promise energy_eror; did you mean "energy_error"\?'),
        ("impact of 3 and 99", "no body 99; there are 12, from 0 on"),
        ("impact of 3 and group 0 x", 'no body "group 0 x"; did you mean "group 0'),
        ("PhysicsError", "nothing to shrink: the run reached its end"),
        ("warning energy-rose", 'no warning energy-rose; did you mean "energy-rise"'),
        ("replay differs", "nothing to shrink: runs on two threads, .* have the same bits"),
        ("shorter steps differ", "nothing to shrink: shorter steps tell the same story"),
        ("warning limit", "nothing to shrink: the run gave none of these warnings"),
    ],
)
def test_a_condition_that_does_not_hold_is_refused_with_what_the_run_shows(condition: str | None, said: str) -> None:
    with pytest.raises(ExperimentError, match=said):
        reduced(GAS, condition)


@pytest.mark.parametrize("text", ["__import__('os')", "energy.max_error >", "1 < 2", "a.b[0] > 1", "(lambda: 1)() > x"])
def test_an_expression_is_a_comparison_of_names_and_nothing_else(text: str) -> None:
    with pytest.raises(ExperimentError, match=r"expected a condition such as energy\.max_error > 1e-3"):
        Expression(text)


def test_an_expression_compares_and_joins_the_numbers_of_a_summary() -> None:
    summary = {"energy": {"max_error": 2e-3}, "bodies": 4, "momentum": {"max_error": None}, "outcome": "completed"}
    assert Expression("energy.max_error > 1e-3 and not bodies == 5").holds(summary)
    assert Expression("1 < bodies <= 2 * 2 or false").holds(summary)
    assert Expression('outcome == "completed"').holds(summary)
    assert not Expression("momentum.max_error > 0").holds(summary)
    assert Expression("energy.max_error / bodies > 1").measured(summary) == "energy.max_error is 0.002, bodies is 4"
    with pytest.raises(UnknownNameError):
        Expression("energy.gain > 0").holds(summary)


def test_delta_debugging_leaves_items_of_which_none_can_be_left_out() -> None:
    def first(parts: list[list[int]]) -> int | None:
        return next((k for k, items in enumerate(parts) if {3, 17, 40} <= set(items)), None)

    assert fewest(range(64), first) == [3, 17, 40]


class Processes:
    """Judge documents that say whether they fail, and remember what they were sent; a verdict of None never comes."""

    def __init__(self) -> None:
        self.sent: dict[int, Document] = {}
        self.ready: list[Ended] = []
        self.dropped = False

    def send(self, function: Any, tasks: dict[int, Task]) -> None:
        self.sent |= {key: task.document for key, task in tasks.items()}
        told = {key: task.document["fails"] for key, task in tasks.items()}
        self.ready += [Ended(key, fails) for key, fails in told.items() if fails is not None]

    def ended(self, seconds: float) -> list[Ended]:
        ready, self.ready = self.ready[::-1], []  # in another order than they were sent
        return ready

    def drop(self) -> None:
        self.dropped = True


def judging(processes: Processes) -> Judges:
    judges = Judges(2)
    judges._workers = cast(Any, processes)
    return judges


def test_of_candidates_on_workers_the_first_in_order_is_taken_and_those_ahead_are_dropped() -> None:
    processes, condition = Processes(), condition_from("bodies > 1")
    documents: list[Document] = [{"fails": fails} for fails in (False, True, True)]
    assert judging(processes).first([*documents, *documents, *documents], condition, 10, lambda: None) == 1
    assert len(processes.sent) == 5 and processes.dropped  # two a worker are sent ahead


def test_a_spent_budget_ends_the_wait_for_a_worker() -> None:
    def spent() -> None:
        raise OutOfTime("the budget was spent")

    processes = Processes()
    with pytest.raises(OutOfTime):
        judging(processes).first([{"fails": None}] * 3, condition_from("bodies > 1"), 10, spent)
    assert processes.dropped


@pytest.mark.slow
def test_several_processes_find_the_scene_that_one_process_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carom.lab.shrink.trials.START", -1.0)
    monkeypatch.setattr("carom.lab.shrink.trials.MIN_SECONDS_TO_SEND", -1.0)
    asked: list[int] = []
    first = Judges.first

    def counted(judges: Judges, documents: Sequence[Document], *given: Any) -> int | None:
        asked.append(len(documents))
        return first(judges, documents, *given)

    monkeypatch.setattr(Judges, "first", counted)
    scene, condition = Scene.from_dict(GAS), condition_from("contacts.impacts > 2")
    alone, together = (Reducer(condition, workers=count).reduce(scene) for count in (1, 2))
    assert together.document == alone.document and together.minimal
    assert asked


def test_the_backward_cone_has_what_led_to_a_contact_and_not_what_followed() -> None:
    steps = [[(0, 1)], [(1, 2), (5, 6)], [(2, 3)], [(3, 4)]]
    *_, cone = cones({2, 3}, steps[:3], count=7)
    assert cone == {0, 1, 2, 3}


def test_rounding_finds_the_digits_that_a_number_needs() -> None:
    assert [digits_of(value) for value in (0.0, 1.0, -2.5, 0.1, 1 / 3)] == [0, 1, 2, 1, 16]
    assert rounded(1234.5, 2) == 1200.0 and rounded(-0.04, 0) == 0.0


IN_CM = """
[units]
length = "cm"
time = "ms"
[time]
duration = 2000
fixed_dt = 10
[gravity]
constant = 0.0
[contact]
restitution = 1.0
[[body]]
position = [-300, 0, 0]
velocity = ["1 m/s", 0, 0]
radius = 10
[[body]]
position = ["0 m", "5 cm", 0]
"""


def said_of(name: str, text: str = IN_CM) -> str:
    space = Space(scene_from_text(text, ""), threads=1)
    return Varies(f"invariance {name}", name).said(Observation(space, 0.0, 1, [], Touches(space)))


@pytest.mark.parametrize("name", INVARIANCES)
def test_an_image_of_a_scene_with_units_runs_alike(name: str) -> None:
    assert said_of(name) == ""


def test_a_scene_with_an_accuracy_takes_the_same_steps_in_other_units() -> None:
    """The promise of carom is scaled, too."""
    assert said_of("scaling", "body = [{}]\n[time]\nduration = 2e6\nmax_dt = 6e6\naccuracy = 1e-8\n") == ""


def test_bodies_of_drawn_radii_may_take_other_steps_than_arrays_of_the_same_bodies() -> None:
    """The steps follow from the smallest radius that may be drawn, and of arrays from the smallest that is there."""
    falling = (
        "[gravity]\nconstant = 0.0\nuniform = [0, 0, -9.8]\n[[plane]]\npoint = [0, 0, -10]\n[time]\nduration = 0.1\n"
    )
    drawn = '[[group]]\ncount = 4\nradius = {min = 0.1, max = 0.4}\nregion = {shape = "ball", radius = 4.0}\n'
    assert said_of("arrays", falling + drawn) == ""
    assert said_of("arrays", falling + drawn.replace("{min = 0.1, max = 0.4}", "0.1")) == ""


def test_an_image_that_does_not_run_alike_is_told_in_the_units_of_the_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    class Elsewhere(Image):
        def positions(self, position: FloatArray, time: float) -> FloatArray:
            return position + 0.5

    monkeypatch.setitem(IMAGES, "rotation", lambda space: Elsewhere(exact=False))
    assert said_of("rotation").startswith("a position differs by 50 cm, and rounding explains only ")
