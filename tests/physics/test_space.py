"""One step after the other: conservation, rest, determinism, and the reference engine's public calls."""

from __future__ import annotations

import re
import sys
import threading
from collections.abc import Callable
from itertools import islice
from types import FrameType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carom.errors import PhysicsError
from carom.physics.space import Space
from carom.physics.step_rule import LIMIT_NAMES
from carom.scene.integrators import INTEGRATORS
from carom.scene.load import Scene
from carom.scene.schema.settings import LARGEST_ACCURACY
from carom.state.frame import Frame
from seeds import examples
from small_scenes import cloud, momentum_of, pair, scene_of

TOUCHING = [{"position": [-1, 0, 0], "mass": 1.0}, {"position": [1, 0, 0], "mass": 1.0}]

TraceFunction = Callable[[FrameType, str, object], Any]


def last(space: Space) -> Frame:
    *_, frame = space.run()
    return frame


def separation(space: Space) -> float:
    return float(np.linalg.norm(space.state.position[1] - space.state.position[0]))


def test_a_run_that_is_stopped_hands_out_its_last_step_once() -> None:
    for every_step in (True, False):
        space = Space(pair(record={"every": "step" if every_step else 0.05}))
        steps = []
        for frame in space.run():
            steps.append(frame.step)
            if len(steps) == 3:
                space.stop()
        assert steps == sorted(set(steps)) and steps[-1] == space.step


def test_after_a_run_that_was_stopped_the_next_one_goes_on() -> None:
    space, whole = Space(pair()), Space(pair())
    next(run := space.run())
    space.stop()
    list(run)
    assert space.time < 1.0
    for _ in space.run():
        space.stop()
        break  # before the run has seen it
    space.reach(1.0)
    last = list(space.run(until=2.0))[-1]
    whole.reach(1.0)
    assert space.time == last.time == 2.0
    assert last.fingerprint == list(whole.run(until=2.0))[-1].fingerprint


def test_a_run_that_is_stopped_before_it_begins_ends_with_its_first_frame() -> None:
    space = Space(pair())
    space.stop()
    assert [frame.step for frame in space.run()] == [0]


def test_frame_0_is_the_scene_as_written() -> None:
    scene = cloud()
    frame = next(Space(scene).run())
    start = Space(scene).state
    assert (frame.step, frame.time, frame.phase) == (0, 0.0, "warm-up")
    assert np.array_equal(frame.position, start.position)
    assert frame.orientation is not None
    assert np.array_equal(frame.orientation, np.tile([0.0, 0.0, 0.0, 1.0], (40, 1)))
    assert frame.energy.integration_error == 0.0 and len(frame.contacts) == 0


def test_the_warm_up_fills_the_accelerations_and_finds_the_first_step() -> None:
    frames = list(islice(Space(cloud()).run(), 2))
    assert np.abs(frames[0].checkpoint.acceleration).max() > 0.0
    assert frames[1].dt_limit in ("velocity", "acceleration", "cap"), "not growth from a tiny step"


def test_a_run_ends_at_its_duration_exactly() -> None:
    assert last(Space(cloud())).time == 3.0


@pytest.mark.parametrize("stabilisation", ["split", "baumgarte", "none"])
@pytest.mark.parametrize("colouring", ["contacts", pytest.param("bodies", marks=pytest.mark.slow)])
def test_momentum_and_angular_momentum_survive_a_collapse(stabilisation: str, colouring: str) -> None:
    space = Space(cloud(contact={"stabilisation": stabilisation, "colouring": colouring}))
    last(space)
    assert space.extremes.total_contacts > 100
    assert space.extremes.momentum_error is not None and space.extremes.momentum_error.value <= 1e-12
    assert space.extremes.angular_momentum_error is not None
    assert space.extremes.angular_momentum_error.value <= 1e-12


@pytest.mark.parametrize("stabilisation", ["split", "baumgarte", "none"])
def test_the_ledger_closes_over_a_collapse(stabilisation: str) -> None:
    space = Space(cloud(contact={"stabilisation": stabilisation}))
    last(space)
    assert space.extremes.energy_error is not None
    assert space.extremes.energy_error.value <= 1e-3


def test_the_integration_error_of_a_collapse_falls_with_the_square_of_the_step() -> None:
    # Leapfrog is of order 2. Without contacts, softened, so that no encounter dominates: error over dt² is constant.
    errors = []
    for dt in (0.02, 0.01, 0.005):
        scene = cloud(time={"fixed_dt": dt, "duration": 1.0}, contact={"enabled": False}, gravity={"softening": 0.5})
        space = Space(scene)
        last(space)
        assert space.extremes.energy_error is not None
        errors.append(space.extremes.energy_error.value)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(
    ("integrator", "order"), [(name, each.order) for name, each in INTEGRATORS.items() if each.substeps]
)
def test_each_integrator_has_its_order(integrator: str, order: int) -> None:
    errors = []
    for steps in (400, 800):
        scene = scene_of(
            [
                {"mass": 1.0, "radius": 0.1},
                {"mass": 1e-9, "radius": 0.1, "position": [1, 0, 0], "velocity": [0, 1.1, 0]},
            ],
            gravity={"constant": 1.0},
            contact={"enabled": False},
            time={"duration": 4.0, "fixed_dt": 4.0 / steps, "integrator": integrator},
        )
        time = scene.time.model_copy(update={"fixed_dt": 1e-3, "integrator": "yoshida4"})
        fine = scene.model_copy(update={"time": time})
        coarse_space, fine_space = Space(scene), Space(fine)
        last(coarse_space), last(fine_space)
        errors.append(np.linalg.norm(coarse_space.state.position[1] - fine_space.state.position[1]))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)


@pytest.mark.slow
def test_two_touching_spheres_do_not_sink() -> None:
    # The free-fall time of the pair is about 1.1 √(R³/GM) ≈ 1.6 s: a thousand of them.
    space = Space(scene_of(TOUCHING, gravity={"constant": 1.0}, time={"duration": 1600.0, "max_dt": 0.1}, record={}))
    for _ in space.run():
        assert abs(separation(space) - 2.0) <= 1e-6
    energy = space.energy()
    assert energy.translational <= 1e-20
    assert abs(energy.integration_error) <= 1e-12


def test_the_ledger_of_a_gas_below_restitution_1_is_its_loss() -> None:
    space = Space(gas(duration=2.0, restitution=0.8, static_friction=0.5))
    before, after = space.energy(), last(space).energy
    lost = after.ledger.restitution + after.ledger.friction
    assert lost > 0.1 * before.total
    assert before.total - after.total == pytest.approx(lost, rel=1e-12)


def gas(duration: float, count: int = 300, **contact: Any) -> Scene:
    return Scene.from_dict(
        {
            "seed": 2,
            "time": {"duration": duration, "max_dt": 0.1},
            "gravity": {"constant": 0.0},
            "contact": {"restitution": 1.0, "static_friction": 0.0, **contact},
            "domain": {"boundary": "periodic", "size": [9.0, 9.0, 9.0]},
            "record": {"every": 0.1, "check_every": 10},
            "group": [
                {
                    "count": count,
                    "radius": 0.5,
                    "mass": 1.0,
                    "region": {"shape": "box", "size": [9.0, 9.0, 9.0]},
                    "velocity": {"dispersion": 1.0},
                }
            ],
        }
    )


@pytest.mark.slow
def test_an_elastic_gas_keeps_its_kinetic_energy_through_100000_collisions() -> None:
    space = Space(gas(duration=160.0))
    before = space.energy().translational
    after = last(space).energy
    assert space.extremes.impacts >= 100_000
    assert after.translational == pytest.approx(before, rel=1e-12)
    assert after.ledger.restitution == pytest.approx(0.0, abs=1e-12 * before)
    assert space.extremes.momentum_error is not None and space.extremes.momentum_error.value <= 1e-12


def test_the_cradle_sends_out_as_many_as_came_in() -> None:
    space = Space(Scene.load("newtons-cradle"))
    last(space)
    speed = space.state.velocity[:, 0]
    assert np.allclose(speed, [0, 0, 0, 0, 0, 1, 1], rtol=0, atol=1e-14)


def test_threads_change_no_bit_of_a_run() -> None:
    alone, four = ([frame.fingerprint for frame in Space(big(), threads).run()] for threads in (1, 4))
    assert four == alone


def big() -> Scene:
    """Enough bodies that the kernels run in parallel, colliding from the start."""
    group = {
        "count": 2200,
        "radius": {"min": 0.2, "max": 0.5},
        "region": {"radius": 7.5},
        "velocity": {"dispersion": 1.0},
    }
    return Scene.from_dict(
        {
            "gravity": {"constant": 0.01},
            "time": {"duration": 0.15, "cfl": 0.2},
            "record": {"every": "step"},
            "group": [group],
        }
    )


def test_a_run_repeats_bit_for_bit() -> None:
    first, again = ([frame.fingerprint for frame in Space(cloud()).run()] for _ in range(2))
    assert first == again and len(set(first)) == len(first)


def test_recording_more_or_less_often_changes_no_bit() -> None:
    sparse = Space(cloud(record={"every": 1.0, "check_every": 1000}))
    dense = Space(cloud(record={"every": "step", "check_every": 1}))
    last(sparse), last(dense)
    assert sparse.fingerprint() == dense.fingerprint()


def test_stepping_by_hand_is_running() -> None:
    scene = cloud()
    by_hand, running = Space(scene), Space(scene)
    frames = list(islice(running.run(), 31))
    for iteration in range(1, 31):
        by_hand.compute_dynamics(iteration)
    assert by_hand.fingerprint() == frames[-1].fingerprint


def test_frames_are_copies() -> None:
    space = Space(cloud())
    frames = list(islice(space.run(), 3))
    kept = frames[1].position.copy()
    space.state.position[:] = 0.0
    assert np.array_equal(frames[1].position, kept)


def test_frames_come_at_the_first_step_past_each_multiple() -> None:
    times = [frame.time for frame in Space(cloud(record={"every": 0.5})).run()]
    assert len(times) == 7 and times[-1] == 3.0
    for k, time in enumerate(times):
        assert 0.5 * k <= time < 0.5 * k + 0.02


@examples(16)
@given(seed=st.integers(0, 10**6), e=st.floats(0, 1), mu=st.floats(0, 1.5))
def test_any_collapse_keeps_momentum_and_gains_no_energy(seed: int, e: float, mu: float) -> None:
    scene = cloud(seed=seed, count=15, contact={"restitution": e, "static_friction": mu, "kinetic_friction": mu / 2})
    space = Space(scene)
    *_, frame = space.run()
    assert np.isfinite(frame.position).all()
    assert space.extremes.momentum_error is not None and space.extremes.momentum_error.value <= 1e-12
    assert space.extremes.angular_momentum_error is not None
    assert space.extremes.angular_momentum_error.value <= 1e-12
    assert frame.energy.integration_error <= 1e-2 * frame.energy.scale


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), power=st.integers(-30, 30))
def test_scaling_all_lengths_by_a_power_of_two_scales_the_bits(seed: int, power: int) -> None:
    # x → s x, v → s v, m → m: every operation of a frictional gas is exact under a power of two.
    s = 2.0**power
    rng = np.random.default_rng(seed)
    position, velocity = rng.uniform(-3, 3, (12, 3)), rng.uniform(-1, 1, (12, 3))
    spaces = []
    for scale in (1.0, s):
        bodies = [
            {"position": list(x * scale), "velocity": list(v * scale), "radius": 0.9 * scale, "mass": 1.0}
            for x, v in zip(position, velocity, strict=True)
        ]
        contact = {"allow_overlap": True, "restitution": 0.5}
        spaces.append(
            Space(
                scene_of(bodies, gravity={"constant": 0.0}, contact=contact, time={"duration": 1.0, "fixed_dt": 0.02})
            )
        )
        last(spaces[-1])
    assert np.array_equal(spaces[0].state.position * s, spaces[1].state.position)
    assert np.array_equal(spaces[0].state.angular_velocity, spaces[1].state.angular_velocity)


def test_a_boost_changes_nothing_but_the_frame_of_reference() -> None:
    at_rest, moving = Space(pair(offset=0.5)), Space(pair(offset=0.5))
    boost = np.array([4.0, -2.0, 8.0])
    moving.state.velocity[:] += boost
    last(at_rest), last(moving)
    assert np.allclose(moving.state.velocity - boost, at_rest.state.velocity, rtol=0, atol=1e-13)
    assert np.allclose(moving.state.angular_velocity, at_rest.state.angular_velocity, rtol=0, atol=1e-12)


def test_permuting_the_bodies_of_separate_collisions_permutes_the_result() -> None:
    rng = np.random.default_rng(1)
    bodies: list[dict[str, Any]] = []
    for k in range(6):
        x, offset = 10.0 * k, rng.uniform(-1, 1)
        bodies.append({"position": [x - 2, 0, 0], "velocity": [1, 0, 0], "mass": 1.0 + k})
        bodies.append({"position": [x + 2, offset, 0], "velocity": [-1, 0, 0], "mass": 2.0})
    order = rng.permutation(12)
    time = {"duration": 3.0, "fixed_dt": 0.01}
    first = Space(scene_of(bodies, gravity={"constant": 0.0}, time=time))
    other = Space(scene_of([bodies[k] for k in order], gravity={"constant": 0.0}, time=time))
    last(first), last(other)
    # i and j may change places in a pair, which reverses the normal: the last bits may differ.
    assert np.allclose(other.state.velocity, first.state.velocity[order], rtol=0, atol=1e-14)


def test_a_uniform_field_is_a_parabola_and_its_momentum_is_accounted_for() -> None:
    body = {"position": [1, 2, 3], "velocity": [1, 0, 5], "mass": 2.0}
    space = Space(scene_of([body], gravity={"uniform": [0, 0, -9.81]}, time={"duration": 2.0, "fixed_dt": 0.01}))
    frame = last(space)
    assert np.allclose(frame.position[0], [3, 2, 3 + 10 - 0.5 * 9.81 * 4], rtol=0, atol=1e-12)
    assert frame.momentum_error is not None and frame.momentum_error <= 1e-13
    assert frame.angular_momentum_error is not None and frame.angular_momentum_error <= 1e-13
    assert abs(frame.energy.integration_error) <= 1e-13 * frame.energy.scale


@pytest.mark.parametrize("restitution", [0.0, 1.0])
def test_bodies_are_wrapped_into_the_periodic_box(restitution: float) -> None:
    space = Space(gas(duration=20.0, count=100, restitution=restitution))
    frame = last(space)
    assert np.abs(frame.position).max() <= 4.5
    assert frame.angular_momentum_error is None
    assert np.linalg.norm(momentum_of(space.state)) > 0.0


FLOOR: dict[str, Any] = {"plane": [{}], "gravity": {"constant": 0.0, "uniform": [0, 0, -9.81]}}
FALLING: dict[str, Any] = {"gravity": {"constant": 1e-3, "uniform": [0, 0, -9.81]}}
WALL: dict[str, Any] = {**FLOOR, "plane": [{"normal": [1, 0, 0]}]}


@pytest.mark.parametrize(
    ("moving", "bodies", "sections"),
    [
        (True, [{"position": [1, 0, 0]}], WALL),  # falls along a wall
        (True, [{"position": [0, 0, 0]}, {"position": [2, 0, 0]}], FALLING),  # fall together
        (True, [{"position": [-x, 0, 1], "velocity": [-x, 0, 0]} for x in (-1.0, 1.0)], FLOOR),  # roll away
        (False, [{"position": [-1, 0, 1]}, {"position": [1, 0, 1]}], FLOOR),
        (False, [{"position": [-1, 0, 0], "velocity": [5, 0, 0]}, {"position": [1, 0, 0], "velocity": [5, 0, 0]}], {}),
    ],
)
def test_a_body_that_falls_or_rolls_away_has_not_settled(
    moving: bool, bodies: list[dict[str, Any]], sections: dict[str, Any]
) -> None:
    sections = {"gravity": {"constant": 1e-3}, **sections, "time": {"duration": 0.5, "max_dt": 0.01}}
    frame = last(Space(scene_of(bodies, **sections)))
    assert len(frame.contacts) > 0 and (frame.phase == "settled") is not moving


def test_a_state_that_is_not_finite_stops_the_run_and_names_the_body() -> None:
    space = Space(pair(time={"fixed_dt": 0.01, "duration": 1.0}))
    frames = space.run()
    next(frames)
    space.state.velocity[1, 0] = np.nan
    with pytest.raises(PhysicsError, match=r"no longer finite at step 1,.*of body 1$"):
        next(frames)


def test_a_state_that_is_not_finite_is_named_among_many_bodies_too() -> None:
    space = Space(Scene.load("elastic-gas"))
    frames = space.run()
    next(frames)
    space.state.velocity[5, 0] = np.nan
    with pytest.raises(PhysicsError, match=r'no longer finite at step 1,.*body 5 "molecule 5"'):
        next(frames)


def test_too_few_sweeps_are_said_once_and_enough_are_not() -> None:
    texts = [event.text for frame in Space(pair(contact={"sweeps": 1})).run() for event in frame.events]
    assert not any("still closing" in text for text in texts), "one sweep resolves one contact"
    row: list[dict[str, Any]] = [
        {"position": [1.99 * k, 0, 0], "velocity": [float(k == 5), 0, 0], "mass": 1.0} for k in range(6)
    ]
    row[5]["velocity"] = [-1.0, 0, 0]
    # Contacts are resolved from the near end; the impulse comes from the far end and needs a sweep for each.
    chain = scene_of(
        row,
        gravity={"constant": 0.0},
        contact={"sweeps": 1, "restitution": 0.0, "static_friction": 0.0, "allow_overlap": True},
        time={"duration": 0.2, "fixed_dt": 0.01},
    )
    texts = [event.text for frame in Space(chain).run() for event in frame.events]
    assert len([text for text in texts if "still closing" in text]) == 1


def test_an_energy_error_is_the_same_however_the_scene_moves() -> None:
    errors = []
    for boost in (0.0, 1e4):
        bodies: list[dict[str, Any]] = [
            {"mass": 1.0, "radius": 0.1, "velocity": [boost, 0, 0]},
            {"mass": 1.0, "radius": 0.1, "position": [1, 0, 0], "velocity": [boost, 1.0, 0]},
        ]
        time = {"duration": 5.0, "fixed_dt": 0.02}
        space = Space(scene_of(bodies, gravity={"constant": 1.0}, contact={"enabled": False}, time=time))
        last(space)
        assert space.extremes.energy_error is not None
        errors.append(space.extremes.energy_error.value)
    # Speeds of 10⁴ m/s squared, 10⁸ J, are rounded to 10⁻⁸ J: of a scale of 2 J.
    assert errors[1] == pytest.approx(errors[0], abs=1e-7)


def test_frames_fall_on_the_multiples_of_a_fixed_step() -> None:
    scene = pair(time={"duration": 1.0, "fixed_dt": 0.01}, record={"every": 0.1})
    assert [frame.step for frame in Space(scene).run()] == list(range(0, 101, 10))


def test_a_step_that_no_longer_moves_the_clock_stops_the_run() -> None:
    space = Space(pair(time={"fixed_dt": 1e-9, "duration": 1e9}))
    space._world.clock.time = 5e8
    with pytest.raises(PhysicsError, match="no longer moves the clock"):
        list(islice(space.run(), 2))


@pytest.mark.parametrize("constant", [0.0, 1.0])
@pytest.mark.parametrize("time", [{"accuracy": 1e-3}, {"accuracy": LARGEST_ACCURACY}, {"fixed_dt": 0.1}, {}], ids=str)
def test_a_scene_can_follow_the_advice_for_a_clock_that_stands_still(time: dict[str, float], constant: float) -> None:
    scene = pair(gravity={"constant": constant}, time={"duration": 5.0, **time})
    clock = Space(scene)._world.clock
    values: dict[str, float | str] = {"time.accuracy": 2e-3, "contact.enabled": "true"}
    for limit in (*LIMIT_NAMES, "error", "impact", "orbit"):
        with pytest.raises(PhysicsError) as error:
            clock.advance(1, 1.0, 1.0, 1e-17, limit)
        keys = re.findall(r"[a-z]+\.[a-z]+[a-z_]*", str(error.value).split(";")[1])
        assert keys
        for key in keys:
            scene.changed([f"{key}={values.get(key, 0.5)}"])  # which refuses what contradicts another key


def test_a_fixed_step_that_does_not_move_the_clock_is_to_be_raised() -> None:
    clock = Space(pair(time={"fixed_dt": 0.1}))._world.clock
    with pytest.raises(PhysicsError, match=r"\(limit: fixed\); raise time\.fixed_dt$"):
        clock.advance(1, 1.0, 1.0, 1e-17, "fixed")


def test_the_first_contact_is_an_event() -> None:
    events = [event for frame in Space(pair()).run() for event in frame.events]
    assert [event.text for event in events] == ["First contact: body 0 and body 1."]


def test_energy_that_baumgarte_creates_is_reported_with_the_bodies_that_collided_before() -> None:
    bodies = [{"name": "a", "mass": 1.0}, {"name": "b", "mass": 1.0, "position": [1.0, 0, 0]}]
    contact = {"allow_overlap": True, "stabilisation": "baumgarte"}
    scene = scene_of(bodies, gravity={"constant": 1.0}, contact=contact, time={"duration": 1.0, "max_dt": 0.05})
    events = [event for frame in Space(scene).run() for event in frame.events if event.level == "WARN"]
    rises = [event.text for event in events if event.text.startswith("Energy rose")]
    assert rises and "from stabilisation" in rises[0]
    for part in ("Collisions in step 1", 'body 0 "a": v = (', 'body 1 "b": v = (', "ω = (", "added +"):
        assert part in rises[0]


def test_the_display_data_are_copies_of_the_right_shapes() -> None:
    for space in (Space(cloud()), Space(pair(contact={"static_friction": 0}))):
        n = len(space.bodies)
        shapes = [array.shape for array in space.get_body_data_for_display()]
        assert shapes == [(n, 3), (n, 4), (n, 3), (n, 3)]


def test_torques_are_the_change_of_spin_over_the_step() -> None:
    space = Space(cloud())
    for iteration in range(1, 200):
        before = space.state.angular_velocity.copy()
        space.compute_dynamics(iteration)
        change = space.state.inertia[:, None] * (space.state.angular_velocity - before)
        # Round-off of the spins.
        assert np.allclose(space.state.torque * space.dt, change, rtol=0, atol=1e-14 * (1 + np.abs(before).max()))
        alpha = space.state.torque / space.state.inertia[:, None]
        assert np.array_equal(space.state.angular_acceleration, alpha)


def test_the_profile_accounts_for_every_part_of_the_step() -> None:
    space = Space(cloud())
    last(space)
    assert {"timestep", "integrate", "search", "gravity", "response", "energy"} <= set(space.profile.seconds())


@pytest.mark.slow
def test_every_status_that_another_thread_reads_is_that_of_a_finished_step() -> None:
    scene = cloud(time={"duration": 6.0, "cfl": 0.05}, record={"check_every": 7, "every": 0.1})
    alone = Space(scene)
    published = [alone.status]

    def note(step: int, before: float, time: float) -> bool:
        published.append(alone.status)
        return step % 11 == 0

    bits = [frame.fingerprint for frame in alone.run(schedule=note)]
    published.append(alone.status)
    space, ended = Space(scene), threading.Event()
    read = [space.status]
    faults: list[Exception] = []

    def reader() -> None:
        while not ended.is_set():
            try:
                status = space.status
                if status[:5] != read[-1][:5]:  # without the energy, which is slow to compare
                    read.append(status)
            except Exception as fault:
                faults.append(fault)

    interval, thread = sys.getswitchinterval(), threading.Thread(target=reader)
    sys.setswitchinterval(1e-6)  # s: threads take turns within every step
    thread.start()
    try:
        beside = [frame.fingerprint for frame in space.run(schedule=lambda step, before, time: step % 11 == 0)]
    finally:
        ended.set()
        sys.setswitchinterval(interval)
        thread.join()
    assert not faults
    assert len(read) > 10, "the reader gets its turn"
    assert {repr(status) for status in read} <= {repr(status) for status in published}
    assert beside == bits


def test_between_any_two_instructions_of_a_step_the_status_is_that_of_a_finished_one() -> None:
    # What another thread may see at worst, which chance seldom shows: a trace looks at every instruction of the Space.
    scene = cloud(time={"duration": 0.5}, record={"check_every": 3})
    alone = Space(scene)
    published = [alone.status, *(alone.status for _ in alone.run())]
    space, here = Space(scene), Space.run.__code__.co_filename
    read, looks = [space.status], 0

    def look(frame: FrameType, event: str, argument: object) -> TraceFunction | None:
        nonlocal looks
        if frame.f_code.co_filename != here:
            return None
        frame.f_trace_opcodes = True
        looks += 1
        status, last = space.status, read[-1]
        if status[:5] != last[:5] or status.energy is not last.energy:
            read.append(status)
        return look

    before = sys.gettrace()
    sys.settrace(look)
    try:
        for _ in space.run():
            pass
    finally:
        sys.settrace(before)
    assert looks > 100 * len(published)
    assert [repr(status) for status in read] == [repr(status) for status in published[1:]]


def test_a_status_read_during_a_step_is_that_of_the_step_before() -> None:
    space = Space(cloud(time={"duration": 0.5}))
    read = []

    def between(step: int, before: float, time: float) -> bool:
        read.append((step, before, space.status))  # the clock already shows the end of this step
        return False

    for _ in space.run(schedule=between):
        pass
    assert len(read) > 10
    assert all((status.step, status.time) == (step - 1, before) for step, before, status in read)
    assert (space.status.step, space.status.time, space.status.dt) == (space.step, 0.5, space.dt)
    assert space.status.contacts == len(space.contacts)
    assert space.status.energy_error == space.frame().energy.relative_error


@pytest.mark.parametrize("iteration", ["x", None, 1.5])
def test_a_step_without_a_whole_number_is_refused_by_name(iteration: Any) -> None:
    space = Space(scene_of([{"radius": 1.0}]))
    with pytest.raises(TypeError, match=r"iteration: expected the number of the step, got "):
        space.compute_dynamics(iteration)
