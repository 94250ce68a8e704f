"""Many steps in one call have the bits of single steps, in every number that a run yields.

A flight of one step is a call, too: runs are compared with steps that no flight takes.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from carom import registry
from carom.errors import PhysicsError
from carom.physics.contact.events import steady_steps
from carom.physics.contact.events.steady_steps import PATIENCE
from carom.physics.jit.decorators import WORTH_COMPILING, compiling_all
from carom.physics.schedule import Schedule, every
from carom.physics.space import Space
from carom.scene.load import Scene
from carom.state.frame import Frame


def one_by_one(schedule: Schedule) -> Schedule:
    """Return a schedule that is asked after every step, so that a run takes single steps."""

    def asked(step: int, before: float, time: float) -> bool:
        return schedule(step, before, time)

    return asked


def few_bodies(count: int = 3, **sections: dict[str, Any]) -> Scene:
    """Let bodies of unequal masses, one of them fixed, pull each other where nothing can touch."""
    rng = np.random.default_rng(count)
    bodies = [
        {"mass": 0.5 + k, "position": (3.0 * x).tolist(), "velocity": (0.3 * v).tolist(), "radius": 0.1}
        for k, (x, v) in enumerate(rng.normal(size=(count, 2, 3)))
    ]
    bodies[-1] |= {"angular_velocity": [0.1, 0.2, 2.0]}
    document: dict[str, Any] = {
        "time": {"duration": 3.0, "max_dt": 0.01, "integrator": "leapfrog"},
        "gravity": {"constant": 1.0},
        "contact": {"enabled": False},
        "record": {"every": 0.7, "check_every": 37},
        "body": bodies,
    }
    return Scene.from_dict(
        {key: document.get(key, {}) | sections.get(key, {}) for key in {**document, **sections} if key != "body"}
        | {"body": bodies}
    )


def bits(frame: Frame) -> tuple[Any, ...]:
    """Return all that a frame holds; arrays as bytes."""
    energy, memory = frame.energy, frame.memory
    arrays = (
        *(frame.momentum, frame.angular_momentum, frame.position, frame.velocity, frame.acceleration),
        *(frame.orientation, frame.angular_velocity, frame.torque, frame.angular_acceleration),
        *(frame.contacts.pairs, frame.contacts.normals, frame.contacts.overlaps, frame.contacts.colours),
    )
    return (
        *(frame.step, frame.time, frame.dt, frame.dt_limit, frame.previous_dt, frame.fingerprint, frame.phase),
        *(energy.translational, energy.gravitational, energy.field, energy.integration_error, energy.scale),
        *(energy.ledger, frame.momentum_error, frame.angular_momentum_error, frame.expected_error),
        *(frame.events, frame.books, frame.sweeps),
        None if memory is None else (memory.dt, memory.kick, memory.pairs.tobytes(), memory.impulse.tobytes()),
        *(None if array is None else array.tobytes() for array in arrays),
        *(None if rows is None else rows.tolist() for rows in (frame.contact_rows, frame.impacts)),  # not their padding
    )


def space_of(scene: Scene, flies: bool) -> Space:
    """Make a space that records contacts; one that does not fly takes each step by its parts."""
    space = Space(scene, threads=1, record_contacts=True)
    space.check_interval = None  # at the frames: 600 checks would cut flights of so few steps short
    if not flies:
        setattr(space._stepper, "_flight", None)  # noqa: B010 - a stepper has no such option
    return space


def same_run(scene: Scene) -> tuple[Space, int]:
    """Compare the frames of a run with those of single steps; return its space and the number of calls."""
    interval = scene.record.every
    assert isinstance(interval, float)
    together, alone, calls = space_of(scene, flies=True), space_of(scene, flies=False), 0
    advance = together._stepper.advance

    def counted(*asked: Any) -> bool:
        nonlocal calls
        calls += 1
        return advance(*asked)

    setattr(together._stepper, "advance", counted)  # noqa: B010 - mypy knows no methods that are replaced
    with compiling_all():
        frames = [bits(frame) for frame in together.run(schedule=every(interval))]
    assert frames == [bits(frame) for frame in alone.run(schedule=every(interval))]
    assert together.extremes == alone.extremes
    return together, calls


def assert_same_run(scene: Scene, least: float = 5.0) -> Space:
    """Compare the frames of a run with those of single steps; a call takes at least so many steps on average."""
    together, calls = same_run(scene)
    assert calls * least < together.step, "many steps in a call"
    return together


def assert_same_steps(scene: Scene) -> None:
    """Compare the frames of all steps with those of steps that no flight takes."""
    frames = [bits(frame) for frame in space_of(scene, flies=True).run(schedule=one_by_one(every(0.0)))]
    assert frames == [bits(frame) for frame in space_of(scene, flies=False).run(schedule=every(0.0))]


@pytest.mark.parametrize("integrator", ["euler", "leapfrog", "leapfrog-dkd", "yoshida4"])
def test_steps_by_the_shortest_time_of_a_pair_are_those_of_single_steps(integrator: str) -> None:
    assert_same_run(few_bodies(time={"integrator": integrator}))


@pytest.mark.parametrize(
    "rule",
    [
        {"fixed_dt": 0.0123},
        {"target_dx": 1e-4, "smoothing": 0.3},
        {"cfl": 0.05, "smoothing": 0.2},
        {"cfl": 0.05, "velocity_limit": "fastest-body"},
        {"target_dx": 1e-5, "cfl": 0.01, "pull_fraction": 0.02, "smoothing": 0.05},
    ],
    ids=" ".join,
)
def test_steps_by_any_limit_are_those_of_single_steps(rule: dict[str, Any]) -> None:
    assert_same_run(few_bodies(time=rule))


def test_steps_in_a_uniform_field_beside_a_fixed_body_are_those_of_single_steps() -> None:
    assert_same_run(few_bodies(gravity={"uniform": [0.0, -1.0, 0.5], "softening": 0.2}))
    scene = few_bodies(4)
    held = tuple(body.model_copy(update={"fixed": k == 1}) for k, body in enumerate(scene.body))
    assert_same_run(scene.model_copy(update={"body": held}))


def test_steps_without_forces_are_those_of_single_steps() -> None:
    assert_same_run(few_bodies(gravity={"constant": 0.0}, time={"fixed_dt": 0.003}))


def test_a_clock_that_stands_still_ends_the_run_with_the_message_of_single_steps() -> None:
    scene = few_bodies(time={"fixed_dt": 1e-3, "duration": 1e16})
    said = []
    for schedule in (every(1e15), one_by_one(every(1e15))):
        space = Space(scene, threads=1)
        space._world.clock.time = 1e15
        with pytest.raises(PhysicsError) as error:
            list(space.run(schedule=schedule))
        said.append(str(error.value))
    assert said[0] == said[1] and "no longer moves the clock" in said[0]


def test_a_run_that_is_continued_from_a_frame_between_calls_has_the_same_bits() -> None:
    scene = few_bodies(time={"target_dx": 1e-4, "smoothing": 0.3})
    whole = list(Space(scene, threads=1).run(schedule=every(0.7)))
    resumed = Space(scene, threads=1)
    resumed.restore(whole[2].checkpoint)
    assert [bits(frame) for frame in resumed.run(schedule=every(0.7))][1:] == [bits(frame) for frame in whole[3:]]


WALLS = {"boundary": "walls", "size": [5.0, 5.0, 5.0]}


def billiards(count: int = 5, domain: dict[str, Any] = WALLS, **sections: dict[str, Any]) -> Scene:
    """Let spheres collide with each other, and with what the domain has around them."""
    velocities = (3.0 * np.random.default_rng(3).normal(size=(5, 3))).tolist()
    places = [[-1.5, -1.5, 0.0], [1.5, -1.4, 0.1], [0.0, 0.1, 0.2], [-1.5, 1.5, -0.2], [1.4, 1.5, 0.0]]
    body = [
        {"mass": 1.0 + k, "position": x, "velocity": v, "radius": 0.2 + 0.1 * (k % 3)}
        for k, (x, v) in enumerate(zip(places, velocities, strict=True))
    ]
    document: dict[str, Any] = {
        "time": {"duration": 1.5, "max_dt": 0.004},
        "gravity": {"constant": 0.0},
        "contact": {"restitution": 0.9},
        "record": {"every": 0.11, "check_every": 50},
    }
    merged = {key: document.get(key, {}) | sections.get(key, {}) for key in {**document, **sections}}
    return Scene.from_dict({**merged, "domain": domain, "body": body[:count]})


@pytest.mark.parametrize("timing", ["time-of-impact", "end-of-step"])
@pytest.mark.parametrize("boundary", ["walls", "periodic"])
def test_steps_between_collisions_are_those_of_single_steps(boundary: str, timing: str) -> None:
    scene = billiards(domain=WALLS | {"boundary": boundary}, contact={"timing": timing})
    assert assert_same_run(scene, least=3.0).extremes.contacts is not None


@pytest.mark.parametrize("integrator", ["euler", "leapfrog", "yoshida4"])
def test_steps_of_bodies_that_fall_onto_each_other_are_those_of_single_steps(integrator: str) -> None:
    scene = billiards(
        domain={"boundary": "open"}, gravity={"constant": 20.0}, time={"integrator": integrator, "target_dx": 1e-3}
    )
    assert assert_same_run(scene, least=1.0).extremes.contacts is not None


@pytest.mark.parametrize("solver", ["lasting", "staged"])
def test_steps_of_balls_that_come_to_rest_on_a_floor_are_those_of_single_steps(solver: str) -> None:
    time = {"max_dt": 0.02, "target_dx": 1e-3, "duration": 4.0}
    scene = billiards(
        3, gravity={"uniform": [0.0, 0.0, -9.81]}, contact={"restitution": 0.3, "solver": solver}, time=time
    )
    assert_same_run(scene, least=1.0)


@pytest.mark.parametrize("domain", [WALLS, WALLS | {"boundary": "periodic"}, {"boundary": "open"}], ids=str)
def test_a_call_that_takes_one_step_has_its_bits(domain: dict[str, Any]) -> None:
    assert_same_steps(billiards(domain=domain, time={"duration": 0.6}))


def test_a_scene_with_a_fast_small_body_meets_all_that_single_steps_meet() -> None:
    scene = billiards()
    fast = scene.body[0].model_copy(update={"velocity": (190.0, 41.0, 13.0), "radius": 0.01, "mass": 1e-3})
    assert_same_run(scene.model_copy(update={"body": (fast, *scene.body[1:])}), least=1.0)


WIND: dict[str, dict[str, Any]] = {"drag": {"relaxation_time": 0.4, "medium_velocity": [0.3, -0.2, 0.1]}}
FIELD: dict[str, dict[str, Any]] = {"gravity": {"constant": 1.0, "uniform": [0.0, -1.0, 0.5]}}


@pytest.mark.parametrize(
    "sections",
    [
        WIND | {"time": {"target_dx": 1e-3, "smoothing": 0.3}} | FIELD,
        WIND | {"time": {"fixed_dt": 0.003}, "gravity": {"constant": 0.0}},
        {"drag": {"relaxation_time": 1e3}, "time": {"fixed_dt": 0.003}, "gravity": {"constant": 0.0}},
    ],
    ids=["gravity, a field and a wind", "a wind alone", "a medium at rest"],
)
def test_steps_in_a_medium_are_those_of_single_steps(sections: dict[str, dict[str, Any]]) -> None:
    scene = few_bodies(4, **sections)
    held = tuple(body.model_copy(update={"fixed": k == 1}) for k, body in enumerate(scene.body))
    assert_same_run(scene)
    assert_same_run(scene.model_copy(update={"body": held}))


# 5.0 s, 0.02 s and 0.2 ms: a step is 0.0008, 0.2 and 20 times as long
@pytest.mark.parametrize(
    ("falls", "relaxation_time"),
    [
        (True, 5.0),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in [(False, 0.02), (True, 0.02), (False, 2e-4)]),
    ],
)
def test_steps_in_a_medium_between_collisions_are_those_of_single_steps(falls: bool, relaxation_time: float) -> None:
    drag = {"relaxation_time": relaxation_time, "medium_velocity": [2.0, 1.0, 0.0]}
    field = [0.0, 0.0, -9.81 if falls else 0.0]
    time = {"duration": 0.4} if relaxation_time < 1e-3 else {}  # most of these steps are single ones, at the walls
    scene = billiards(drag=drag, gravity={"uniform": field}, time=time)
    assert assert_same_run(scene, least=1.0).extremes.contacts is not None


def test_a_run_in_a_medium_that_is_continued_between_calls_has_the_same_bits() -> None:
    scene = few_bodies(drag=WIND["drag"])
    whole = list(Space(scene, threads=1).run(schedule=every(0.7)))
    resumed = Space(scene, threads=1)
    resumed.restore(whole[2].checkpoint)
    assert [bits(frame) for frame in resumed.run(schedule=every(0.7))][1:] == [bits(frame) for frame in whole[3:]]


def in_contact(bodies: list[dict[str, Any]], floor: bool = True, **sections: dict[str, Any]) -> Scene:
    """Lay spheres of 1 m on a floor, or let them attract each other where there is none."""
    field, constant = ([0.0, 0.0, -9.81], 0.0) if floor else ([0.0, 0.0, 0.0], 1e-3)
    document: dict[str, Any] = {
        "time": {"duration": 1.0} | ({} if "time" in sections else {"fixed_dt": 1e-3}),
        "gravity": {"constant": constant, "uniform": field},
        "contact": {"restitution": 0.3, "static_friction": 0.6, "kinetic_friction": 0.4},
        "record": {"every": 0.21, "check_every": 100},
    }
    merged = {key: document.get(key, {}) | sections.get(key, {}) for key in document | sections}
    spheres = [{"mass": 1.0 + k, "radius": 0.5} | body for k, body in enumerate(bodies)]
    return Scene.from_dict({**merged, "plane": [{"point": [0.0, 0.0, 0.0]}] if floor else [], "body": spheres})


ON_A_FLOOR: dict[str, list[dict[str, Any]]] = {
    "at rest": [{"position": [0.0, 0.0, 0.5]}],
    "slides, then rolls": [{"position": [0.0, 0.0, 0.5], "velocity": [2.0, 0.5, 0.0]}],
    "rolls": [{"position": [0.0, 0.0, 0.5], "velocity": [1.0, 0.0, 0.0], "angular_velocity": [0.0, 2.0, 0.0]}],
    "rolls against another": [
        {"position": [0.0, 0.0, 0.5], "velocity": [1.0, 0.0, 0.0], "angular_velocity": [0.0, 2.0, 0.0]},
        {"position": [1.5, 0.0, 0.5]},
    ],
    "is hit from above": [{"position": [0.0, 0.0, 0.5]}, {"position": [0.1, 0.0, 3.0]}],
    "a pile": [
        *({"position": [x, y, 0.5]} for x, y in ((0.0, 0.0), (1.0, 0.0), (0.5, 0.75**0.5))),
        {"position": [0.5, 12.0**-0.5, 0.5 + (2.0 / 3.0) ** 0.5]},
    ],
}


@pytest.mark.parametrize("motion", ON_A_FLOOR)
def test_steps_with_lasting_contacts_are_those_of_single_steps(motion: str) -> None:
    assert_same_run(in_contact(ON_A_FLOOR[motion]), least=2.0 if motion == "is hit from above" else 10.0)


def test_frames_between_lasting_contacts_cost_a_single_step_each() -> None:
    # of 20 steps to a frame, a call makes 19
    scene = in_contact(ON_A_FLOOR["slides, then rolls"], record={"every": 0.02, "check_every": 1000})
    assert_same_run(scene, least=9.0)


def test_steps_of_two_balls_that_touch_at_rest_beside_a_third_are_those_of_single_steps() -> None:
    touching = [{"position": [x, y, 0.0]} for x, y in ((0.0, 0.0), (1.0, 0.0), (0.0, 5.0))]
    assert_same_run(in_contact(touching, floor=False), least=20.0)


@pytest.mark.parametrize("solver", ["lasting", "staged"])
def test_steps_of_balls_that_touch_without_a_force_are_those_of_single_steps(solver: str) -> None:
    bodies: list[dict[str, Any]] = [{"position": [x, 0.0, 0.0]} for x in (0.0, 1.0, 3.0)]
    bodies[2]["velocity"] = [0.0, 0.5, 0.0]  # without it, no contact would be modelled
    scene = in_contact(bodies, floor=False, gravity={"constant": 0.0}, contact={"solver": solver})
    space = assert_same_run(scene, least=20.0)
    assert space.extremes.contacts is not None


@pytest.mark.parametrize(
    "sections",
    [
        {"time": {"max_dt": 0.01, "target_dx": 1e-4, "smoothing": 0.3}},
        {"contact": {"kinetic_friction": 0.0, "static_friction": 0.0}},
        {"contact": {"sweeps": 3}},
        {"domain": {"boundary": ["periodic", "periodic", "open"], "size": [2.2, 2.0, 1.0]}},
        pytest.param(  # which compiles the kernel for other types
            {
                "drag": {"relaxation_time": 0.5, "medium_velocity": [2.0, 1.0, 0.0]},
                "contact": {"law": "rolling_resistance", "rolling_resistance": {"rolling_friction": 0.02}},
            },
            marks=[pytest.mark.slow, pytest.mark.nightly],
        ),
    ],
    ids=str,
)
def test_steps_with_lasting_contacts_have_the_bits_of_single_steps_with_other_settings(
    sections: dict[str, dict[str, Any]],
) -> None:
    assert_same_run(in_contact(ON_A_FLOOR["slides, then rolls"], floor=True, **sections), least=3.0)


def test_contacts_last_in_a_medium_in_which_a_step_has_many_relaxation_times() -> None:
    # The acceleration along a path then has a factor, which only single steps know.
    scene = in_contact(ON_A_FLOOR["slides, then rolls"], drag={"relaxation_time": 1e-4})
    assert_same_run(scene, least=0.5)


def test_a_run_that_is_continued_among_lasting_contacts_has_the_same_bits() -> None:
    scene = in_contact(ON_A_FLOOR["a pile"])
    whole = list(Space(scene, threads=1).run(schedule=every(0.21)))
    resumed = Space(scene, threads=1)
    resumed.restore(whole[2].checkpoint)
    with compiling_all():
        frames = [bits(frame) for frame in resumed.run(schedule=every(0.21))]
    assert frames[1:] == [bits(frame) for frame in whole[3:]]


def test_a_short_run_does_not_wait_for_the_kernel_that_a_long_one_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, asked = in_contact(ON_A_FLOOR["at rest"]), list[float]()

    def decide(function: object, calls: float, *arguments: object) -> None:
        asked.append(calls)

    monkeypatch.setattr(steady_steps, "entry_if_worthwhile", decide)
    space = Space(scene, threads=1)
    for _ in space.run(schedule=every(0.21)):
        pass
    assert len(asked) == space.step // PATIENCE
    left = [space.step - k * PATIENCE for k in range(1, len(asked) + 1)]
    assert all(0.4 * most < calls < most for calls, most in zip(asked, left, strict=True)), "at least every other step"
    assert max(asked) < WORTH_COMPILING


def test_without_the_kernel_for_lasting_contacts_a_scene_takes_single_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = in_contact(ON_A_FLOOR["at rest"])
    whole = [bits(frame) for frame in Space(scene, threads=1).run(schedule=every(0.5))]
    rows = {name: row for name, row in registry.HOUSE["model"].items() if name != "steady-steps"}
    monkeypatch.setattr(registry, "HOUSE", {**registry.HOUSE, "model": rows})
    with compiling_all():
        assert [bits(frame) for frame in Space(scene, threads=1).run(schedule=every(0.5))] == whole


def drawn(seed: int) -> Scene:
    """Draw spheres that rest, slide, roll or drift side by side, with or without forces, walls and friction."""
    rng = np.random.default_rng(seed)

    def choice(*values: Any) -> Any:
        return values[rng.integers(len(values))]

    speed, floor = choice(0.0, 0.0, 0.3), bool(rng.integers(3))
    places = np.cumsum([choice(1.0, 1.0, 1.2) for _ in range(rng.integers(1, 5))])
    bodies = [{"position": [float(x), 0.0, 0.5], "velocity": (speed * rng.normal(size=3)).tolist()} for x in places]
    bodies[-1] |= {"angular_velocity": [0.0, choice(0.0, 1.0), 0.0]}
    if len(bodies) > 1 and choice(False, False, True):
        bodies[0] = {"position": bodies[0]["position"], "fixed": True}
    field = choice([0.0, 0.0, -9.81], [1.0, 0.0, -9.0], [0.0, 0.0, 0.0])
    constant, size, friction = choice(0.0, 1e-3), {"size": [12.0, 2.0, 3.0]}, choice(0.0, 0.3)
    boundary = choice({}, {"boundary": ["open", "periodic", "open"]} | size, {"boundary": "walls"} | size)
    return in_contact(
        bodies,
        floor,
        gravity={"constant": 0.0 if "open" in boundary.get("boundary", "") else constant, "uniform": field},
        contact={
            "restitution": choice(0.0, 0.5),
            "static_friction": friction,
            "kinetic_friction": friction,
            "solver": choice("lasting", "lasting", "staged"),
            "stabilisation": choice("split", "split", "none"),
            "sweeps": choice("auto", "quick", 3),
        },
        domain=boundary,
        time={"duration": 0.25} | choice({"fixed_dt": 1e-3}, {}, {"max_dt": 2e-3, "target_dx": 1e-5, "cfl": 0.05}),
        record={"every": 0.03, "check_every": choice(7, 100)},
    )


def assert_same_drawn_runs(seeds: Iterable[int]) -> None:
    """Compare drawn runs with single steps; altogether, a third of the calls are saved."""
    steps = calls = 0
    for seed in seeds:
        try:
            together, called = same_run(drawn(seed))
        except Exception as error:
            error.add_note(f"scene {seed}")
            raise
        steps, calls = steps + together.step, calls + called
    assert 3 * calls < 2 * steps


def test_drawn_scenes_have_the_bits_of_single_steps() -> None:
    assert_same_drawn_runs(range(6))


@pytest.mark.slow
def test_many_drawn_scenes_have_the_bits_of_single_steps() -> None:
    assert_same_drawn_runs(range(6, 40))
