"""An accuracy in place of a step: what the scene asks for is kept, up to the time that the run names."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.errors import SceneError
from carom.lab.tradeoff.event_driven_reference import solve
from carom.physics.integrators.gauss_radau.gauss_radau15 import STEP_FRACTION, GaussRadau15
from carom.physics.integrators.gauss_radau.radau_step import motion_of, tolerance
from carom.physics.integrators.gauss_radau.radau_twin import diverge
from carom.physics.jit.decorators import compiling_all
from carom.physics.look_ahead.error_growth import Scale
from carom.physics.look_ahead.find_step import with_promise
from carom.physics.look_ahead.trial_run import TrialRun, WorkBudget
from carom.physics.placement import place
from carom.physics.schedule import at, every
from carom.physics.space import Space
from carom.plan.features import require
from carom.runs.run import kept_accuracy
from carom.scene.load import Scene, scene_from_text
from small_scenes import scene_of

FloatArray = NDArray[np.float64]

NO_PULL = {"constant": 0.0}
ELASTIC = {"restitution": 1.0, "static_friction": 0.0}
SPHERES: list[dict[str, Any]] = [
    {"position": [-2.0, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0], "radius": 0.5},
    {"position": [2.0, 0.6, 0.0], "velocity": [-1.0, 0.0, 0.0], "radius": 0.5},
]


def kepler(eccentricity: float, accuracy: float, orbits: float = 10.0, touches: bool = False, **time: Any) -> Scene:
    """Return orbits of semi-major axis 1, from the apocentre on; their period is 2 π."""
    speed = math.sqrt((1.0 - eccentricity) / (1.0 + eccentricity))
    bodies = [
        {"mass": 1.0, "radius": 1e-3, "position": [0, 0, 0]},
        {"mass": 1e-12, "radius": 1e-3, "position": [1.0 + eccentricity, 0, 0], "velocity": [0, speed, 0]},
    ]
    return scene_of(
        bodies,
        time={"duration": 2.0 * math.pi * orbits, "accuracy": accuracy, "max_dt": 1e3, **time},
        gravity={"constant": 1.0},
        contact={"enabled": touches},
    )


def ball(accuracy: float, **contact: Any) -> Scene:
    """Return a ball that falls from rest on a plane 1.9 m below, for 2.4 s: three bounces."""
    return scene_of(
        [{"position": [0.0, 0.0, 2.0], "radius": 0.1}],
        time={"duration": 2.4, "accuracy": accuracy},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -10.0]},
        contact=contact,
        plane=[{}],
    )


def height(time: float, e: float) -> float:
    """Return the height of the ball above the plane at a time in s, as bounces on a point."""
    fall, speed = math.sqrt(2.0 * 1.9 / 10.0), math.sqrt(2.0 * 1.9 * 10.0)
    if time < fall:
        return 1.9 - 5.0 * time * time
    time, speed = time - fall, e * speed
    while time > 0.2 * speed:
        time, speed = time - 0.2 * speed, e * speed
    return speed * time - 5.0 * time * time


def run_to_the_end(scene: Scene, threads: int = 1) -> Space:
    space = Space(scene, threads)
    space.reach(scene.time.duration)
    return space


@pytest.mark.parametrize("accuracy", [1e-2, 1e-5, 1e-8, 1e-10])
def test_an_orbit_of_eccentricity_09_closes_within_the_accuracy(accuracy: float) -> None:
    space = run_to_the_end(kepler(0.9, accuracy))
    away = space.state.position[1] - space.state.position[0] - [1.9, 0.0, 0.0]
    assert np.linalg.norm(away) / 1.9 < accuracy
    assert space.scene.promise is not None and space.scene.promise.horizon is None


@pytest.mark.slow  # compiles for half a minute
def test_an_elastic_ball_in_a_hollow_sphere_keeps_an_accuracy_along_its_chords() -> None:
    away, speed, duration = 0.5, 1.0, 6.0  # of the path from the centre, m; m/s; the centre is within 1 m
    scene = scene_of(
        [{"position": [0.0, away, 0.0], "velocity": [speed, 0.0, 0.0], "radius": 0.1}],
        time={"duration": duration, "accuracy": 1e-6},
        gravity=NO_PULL,
        contact=ELASTIC,
        wall=[{"sphere": {"radius": 1.1}}],
    )
    space = run_to_the_end(scene)
    half = math.sqrt(1.0 - away * away)
    impacts, beyond = divmod(speed * duration + half, 2.0 * half)
    turned, along = -impacts * 2.0 * math.acos(away), beyond - half
    exact = [
        along * math.cos(turned) - away * math.sin(turned),
        along * math.sin(turned) + away * math.cos(turned),
        0.0,
    ]
    assert space.scene.promise is not None and space.scene.promise.horizon is None
    assert np.linalg.norm(space.state.position[0] - exact) / away < 1e-6


def test_the_promise_of_an_eccentric_binary_ends_where_its_pericentres_err() -> None:
    """At e = 0.9999 a delay of 10⁻¹⁰ is 10⁻⁸ of the size at the pericentre, 141 times faster than the mean motion.

    At the apocentre, where the run ends, the same delay is invisible.
    """
    scene, e = kepler(0.9999, 1e-8, orbits=100.0), 0.9999
    space = Space(scene, 1)
    promise, mu, size = space.scene.promise, 1.0 + 1e-12, (1.0 + e) / 2.0 * math.sqrt(2.0)
    assert promise is not None and promise.horizon is not None
    late = math.inf
    for orbit in range(100):
        passage = 2.0 * math.pi / math.sqrt(mu) * (orbit + 0.5)
        while space.time < passage:
            space.compute_dynamics(space.step + 1)
        solution = space.between(passage)
        assert solution is not None
        error = np.linalg.norm(solution[0][1] - solution[0][0] - [-(1.0 - e), 0.0, 0.0]) / size
        if error > 1e-8:
            late = passage
            break
    # rounding is a random walk, so that the promise is right to a factor of two
    assert 1.0 <= late / promise.horizon < 2.0


@pytest.mark.parametrize(
    ("eccentricity", "accuracy"),
    [
        (0.3, 1e-4),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in [(0.3, 1e-8), (0.6, 1e-6), (0.9, 1e-2)]),
        (0.9, 1e-6),
    ],
)
@pytest.mark.parametrize(("orbits", "touches"), [(300.5, False), (30.5, True)])
def test_many_orbits_keep_the_accuracy(eccentricity: float, accuracy: float, orbits: float, touches: bool) -> None:
    """The distance of twins grows like t, the error of steps like t², so a multiple of the one is not the other."""
    space = run_to_the_end(kepler(eccentricity, accuracy, orbits, touches, integrator="gauss-radau15"))
    away = space.state.position[1] - space.state.position[0] + [1.0 - eccentricity, 0.0, 0.0]  # from the pericentre
    size = (1.0 + eccentricity) / 2.0
    assert np.linalg.norm(away) / math.sqrt(2.0) / size < accuracy
    assert space.scene.promise is not None and space.scene.promise.horizon is None


def test_rounding_at_a_close_passage_ends_the_promise() -> None:
    """A last bit of a coordinate is 10⁻¹³ of the distance at pericentre; other steps round differently."""
    scene = Scene.load(
        str(Path(__file__).parents[3] / "benchmarks/scenes/eccentric-triple.toml"), ["time.accuracy=1e-10"]
    )
    space = Space(scene, 1)
    other = Space(scene_from_text(space.scene.toml, "shorter steps", ["time.max_dt=0.01"]), 1)
    assert space.scene.promise is not None
    for each in (space, other):
        each.reach(0.99 * space.scene.promise.kept_until)
    assert np.abs(space.state.position - other.state.position).max() < 1e-9
    for each in (space, other):
        each.reach(scene.time.duration)
    assert np.abs(space.state.position - other.state.position).max() > 1e-9


@pytest.mark.parametrize("accuracy", [1e-2, 1e-6, 1e-10])
def test_a_ball_bounces_within_the_accuracy(accuracy: float) -> None:
    space = run_to_the_end(ball(accuracy, restitution=0.8))
    # one body has no extent, so the size of its system is its distance from the origin, 2 m
    assert abs(space.state.position[0, 2] - 0.1 - height(2.4, 0.8)) / 2.0 < accuracy


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ([], "gauss-radau15: its steps end at impacts"),
        (["gravity.uniform=[0, 0, 0]"], "leapfrog: exact between impacts"),
        (["time.integrator=leapfrog"], 'time.integrator = "leapfrog"'),
        (["drag.relaxation_time=1"], "leapfrog: the only integrator that supports drag"),
    ],
)
def test_the_integrator_of_an_accuracy_is_explained(changes: list[str], expected: str) -> None:
    scene = scene_from_text(ball(1e-2).toml, "a ball", changes)
    assert require(scene).integrator.why.startswith(expected)


def test_balls_that_come_to_rest_end_where_geometry_puts_them() -> None:
    scene = scene_of(
        [{"position": [1.0 * k, 0.0, 2.0 + 0.3 * k], "radius": 0.1} for k in range(2)],
        time={"duration": 4.0, "accuracy": 1e-4},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -10.0]},
        contact={"restitution": 0.5},
        plane=[{}],
    )
    space = run_to_the_end(scene)
    # rms distance of the bodies from their centre: 0.52 m
    assert np.abs(space.state.position - [[0.0, 0.0, 0.1], [1.0, 0.0, 0.1]]).max() / 0.52 < 1e-4
    assert space.scene.promise is not None and space.scene.promise.horizon is None


@pytest.mark.parametrize("accuracy", [1e-2, 1e-10])
def test_two_spheres_that_collide_off_centre_end_where_geometry_puts_them(accuracy: float) -> None:
    scene = scene_of(SPHERES, time={"duration": 4.0, "accuracy": accuracy}, gravity=NO_PULL, contact=ELASTIC)
    space = run_to_the_end(scene)
    met = 2.0 - 0.5 * math.sqrt(1.0 - 0.36)  # s: centres are then 1 m apart, 0.6 m of it across
    normal, v = np.array([0.8, 0.6, 0.0]), np.array([1.0, 0.0, 0.0])
    expected = np.array([-2.0, 0.0, 0.0]) + met * v + (4.0 - met) * (v - 2.0 * (v @ normal) * normal)
    assert np.abs(space.state.position[0] - expected).max() / 2.0 < 1e-12  # flights and impacts are exact


def test_a_billiard_of_five_elastic_balls_returns_when_it_is_reversed() -> None:
    bodies = [
        {"position": [1.1 * k, 0.3 * (-1) ** k * k, 0.0], "velocity": [1.0 - 0.6 * k, 0.2 * k, 0.0], "radius": 0.5}
        for k in range(5)
    ]
    common: dict[str, Any] = {"gravity": NO_PULL, "contact": ELASTIC}
    box = {"boundary": "walls", "size": [12.0, 12.0, 12.0]}
    there = run_to_the_end(scene_of(bodies, time={"duration": 12.0, "accuracy": 1e-6}, domain=box, **common))
    assert there.extremes.impacts > 10
    reversed_bodies = [
        {"position": x.tolist(), "velocity": (-v).tolist(), "radius": 0.5}
        for x, v in zip(there.state.position, there.state.velocity, strict=True)
    ]
    back = run_to_the_end(scene_of(reversed_bodies, time={"duration": 12.0, "accuracy": 1e-6}, domain=box, **common))
    start = np.array([body["position"] for body in bodies])
    assert np.abs(back.state.position - start).max() / 3.0 < 1e-6


def test_the_size_of_a_single_body_is_its_distance_from_the_origin_or_its_radius() -> None:
    for position, expected in (([1.0, 2.0, 2.0], 3.0), ([0.0, 0.0, 0.0], 0.25)):
        scene = scene_of([{"position": position, "radius": 0.25}])
        assert Scale.of(scene, place(scene)).size == expected


def test_looking_ahead_leaves_no_trace_in_the_run() -> None:
    asked = Space(ball(1e-2, restitution=0.8), 1)
    given = Space(scene_from_text(asked.scene.toml, "with its promise"), 1)
    for one, other in zip(asked.run(), given.run(), strict=True):
        assert (one.step, one.fingerprint, one.books, one.events) == (
            other.step,
            other.fingerprint,
            other.books,
            other.events,
        )


def test_the_step_does_not_depend_on_the_number_of_threads() -> None:
    scene = scene_of(
        [],
        group=[{"count": 30, "radius": 0.1, "velocity": {"dispersion": 0.1}}],
        time={"duration": 0.5, "accuracy": 1e-3},
        gravity={"constant": 1e-4},
    )
    one, two = run_to_the_end(scene, 1), run_to_the_end(scene, 2)
    assert one.scene.promise == two.scene.promise
    assert one.fingerprint() == two.fingerprint()


def test_a_run_goes_on_from_a_checkpoint_with_the_same_step() -> None:
    space = Space(ball(1e-2, restitution=0.8), 1)
    frames = list(space.run())
    again = Space(space.scene, 1)
    again.restore(frames[len(frames) // 2].checkpoint)
    for _ in again.run():
        pass
    assert again.fingerprint() == space.fingerprint()
    assert again.scene.toml == space.scene.toml


def test_a_longer_run_than_was_looked_ahead_ends_its_promise() -> None:
    settled_scene = Space(ball(1e-2), 1).scene
    longer = scene_from_text(settled_scene.toml, "longer", ["time.duration=3.0"])
    said = [event.text for frame in Space(longer, 1).run() for event in frame.events if event.kind == "horizon"]
    assert said == ["The accuracy of 0.01 is kept up to t = 2.4 s; ordinary steps go on."]
    assert kept_accuracy(longer)["horizon"] == 2.4
    assert "horizon" not in kept_accuracy(settled_scene)


def test_a_longer_run_than_was_looked_ahead_takes_the_same_steps() -> None:
    scene = scene_of(SPHERES, time={"duration": 3.0, "accuracy": 1e-2}, gravity=NO_PULL, drag={"relaxation_time": 2.0})
    space = Space(scene, 1)
    longer = Space(scene_from_text(space.scene.toml, "longer", ["time.duration=30.0"]), 1)
    for each in (space, longer):
        for _ in range(100):
            each.compute_dynamics(each.step + 1)
    assert 0.0 < longer.time == space.time < 3.0
    assert longer.fingerprint() == space.fingerprint()


def test_no_promise_is_made_where_none_is_asked_for() -> None:
    scene = scene_of(SPHERES, time={"duration": 4.0}, gravity=NO_PULL)
    assert with_promise(scene) is scene


def chaotic(accuracy: float) -> Scene:
    """Return eight elastic balls in a tight box: errors grow tenfold in about a tenth of a second."""
    corners = [[x, y, z] for x in (-0.6, 0.5) for y in (-0.55, 0.6) for z in (-0.5, 0.55)]
    bodies = [
        {"position": corner, "velocity": [1.0 - 0.3 * k, 0.7, -0.4 * k], "radius": 0.3}
        for k, corner in enumerate(corners)
    ]
    box = {"boundary": "walls", "size": [2.0, 2.0, 2.0]}
    return scene_of(bodies, time={"duration": 20.0, "accuracy": accuracy}, domain=box, gravity=NO_PULL, contact=ELASTIC)


def planets(accuracy: float, **time: Any) -> Scene:
    """Return two planets of 10⁻⁵ on nearly circular orbits, for forty periods of the inner one."""
    bodies = [
        {"mass": 1.0, "radius": 1e-4, "position": [0, 0, 0]},
        {"mass": 1e-5, "radius": 1e-4, "position": [1.0, 0, 0], "velocity": [0, 1.02, 0]},
        {"mass": 1e-5, "radius": 1e-4, "position": [0, 1.6, 0], "velocity": [-0.79, 0, 0.01]},
    ]
    return scene_of(
        bodies,
        time={"duration": 80.0 * math.pi, "accuracy": accuracy, "max_dt": 1e3, **time},
        gravity={"constant": 1.0},
        contact={"enabled": False},
    )


@pytest.mark.parametrize(
    ("accuracy", "chosen"), [(1e-2, "wisdom-holman"), (1e-6, "wisdom-holman"), (1e-9, "gauss-radau15")]
)
def test_planets_keep_an_accuracy_by_the_integrator_that_costs_less(accuracy: float, chosen: str) -> None:
    space = run_to_the_end(planets(accuracy))
    assert require(space.scene).integrator.why.startswith(chosen)
    exact = run_to_the_end(planets(1e-12, integrator="gauss-radau15"))
    promise, size = space.scene.promise, math.sqrt((1.0 + 1.6**2) / 3.0)
    error = math.sqrt(float(np.mean(np.sum((space.state.position - exact.state.position) ** 2, axis=1)))) / size
    assert promise is not None and promise.horizon is None
    assert error <= promise.error[-1] <= accuracy


def test_planets_of_a_given_wisdom_holman_get_the_step_that_keeps_an_accuracy() -> None:
    promise = with_promise(planets(1e-10, integrator="wisdom-holman")).promise
    assert promise is not None
    assert promise.integrator is None and promise.refinement > 1.0


def test_twins_part_as_two_runs_of_their_own_do() -> None:
    scene = with_promise(kepler(0.5, 1e-6))
    start = place(scene)
    moved = start.position + np.array([[0.0, 0.0, 0.0], [1e-8, 0.0, 0.0]])
    times = np.linspace(0.0, scene.time.duration, 9)[1:]
    _, apart = diverge(scene, start, moved, 0.25, times, enough=1.0, iterations=1)
    one, other = Space(scene, 1), Space(scene, 1, replace(start, position=moved))
    for time, found in zip(times, apart, strict=True):
        one.reach(float(time))
        other.reach(float(time))
        d = other.state.position - one.state.position
        # one iteration of the twin's step is right to some per cent
        assert found == pytest.approx(math.sqrt(float(np.mean(np.sum(d * d, axis=1)))), rel=0.1)


def test_long_steps_of_gauss_radau15_take_hardly_more_than_two_iterations() -> None:
    for refinement in (1.0, 0.5, 0.25):
        start = place(kepler(0.5, 1e-6))
        fixed, field, fraction = np.zeros(0, np.int64), np.zeros(3), STEP_FRACTION / refinement
        motion = motion_of(start.position, start.velocity, start.mass, fixed, field, 0.0)
        runner = GaussRadau15(motion, 1e3, None, fraction, None, tolerance(refinement))
        runner.begin(0.01)
        steps = runner.advance(0.0, 20.0, np.inf, 10**6).steps
        assert runner.iterations < 3 * steps  # the first ones predict nothing


def test_the_promise_ends_where_rounding_has_grown_to_the_accuracy() -> None:
    space = Space(chaotic(1e-4), 1)
    promise = space.scene.promise
    assert promise is not None and promise.horizon is not None
    # the same balls, displaced by a last bit
    twin = space.scene.body[0].model_copy(update={"position": (math.nextafter(-0.6, 0.0), -0.55, -0.5)})
    other = Space(space.scene.model_copy(update={"body": (twin, *space.scene.body[1:])}), 1)
    apart, times = 0.0, np.linspace(0.0, 20.0, 401)[1:]
    for time in times:
        for each in (space, other):
            for _ in each.run(float(time), schedule=at(())):
                pass
        d = space.state.position - other.state.position
        apart = math.sqrt(float(np.mean(np.sum(d * d, axis=1))))
        if apart > 1e-4:
            break
    assert apart > 1e-4
    assert promise.horizon == pytest.approx(time, rel=0.2)


def test_the_run_says_when_the_promise_ends_and_records_the_error() -> None:
    space = Space(chaotic(1e-4), 1)
    promise = space.scene.promise
    assert promise is not None and promise.horizon is not None
    frames = list(space.run(min(1.2 * promise.horizon, 20.0)))
    said = [event for frame in frames for event in frame.events if event.kind == "horizon"]
    assert len(said) == 1
    assert said[0].time - said[0].time % 1e-9 >= promise.horizon - 1e-9
    before = [frame.expected_error for frame in frames if frame.time < 0.9 * promise.horizon]
    assert max(before) <= 1e-4
    assert frames[-1].expected_error > 1e-4


def test_the_lyapunov_exponent_of_a_regular_orbit_is_small_and_that_of_colliding_balls_is_not() -> None:
    regular, irregular = with_promise(kepler(0.5, 1e-6)).promise, with_promise(chaotic(1e-4)).promise
    assert regular is not None and irregular is not None
    # errors of an orbit grow in proportion to time, by a factor of some hundred in ten orbits
    assert 0.0 <= regular.lyapunov < math.log(1e3) / (20.0 * math.pi)
    assert irregular.lyapunov > 1.0


@pytest.mark.parametrize(
    ("key", "value"), [("fixed_dt", 0.1), ("target_dx", 0.1), ("cfl", 0.1), ("pull_fraction", 0.1), ("smoothing", 0.5)]
)
def test_a_key_that_sets_the_step_contradicts_an_accuracy(key: str, value: float) -> None:
    with pytest.raises(SceneError, match=rf"{key} = {value} with accuracy = 1e-06, which sets the step"):
        scene_of(SPHERES, time={"duration": 1.0, "accuracy": 1e-6, key: value})


def test_all_keys_that_contradict_an_accuracy_are_named_at_once() -> None:
    with pytest.raises(
        SceneError, match=r"cfl = 0\.2 and smoothing = 0\.5 with .*overrides time\.cfl= and time\.smoothing="
    ):
        scene_of(SPHERES, time={"accuracy": 1e-6, "cfl": 0.2, "smoothing": 0.5})


def test_late_impacts_contradict_an_accuracy() -> None:
    with pytest.raises(SceneError, match=r'"end-of-step" with time.accuracy = 1e-06: impacts would be late'):
        scene_of(SPHERES, time={"accuracy": 1e-6}, contact={"timing": "end-of-step"})


def test_an_integrator_without_error_control_contradicts_an_accuracy() -> None:
    with pytest.raises(SceneError, match='integrator = "euler" with accuracy'):
        scene_of(SPHERES, time={"accuracy": 1e-6, "integrator": "euler"})


def test_an_accuracy_beyond_double_precision_is_refused_with_the_best_that_there_is() -> None:
    far = [{**body, "position": [1e6, *body["position"][1:]]} for body in SPHERES[:1]] + [
        {**SPHERES[1], "position": [1e6 + 4.0, 0.6, 0.0]}
    ]
    with pytest.raises(SceneError, match=r"accuracy = 1e-10: double precision allows at best 5\.\de-08"):
        Space(scene_of(far, time={"accuracy": 1e-10}, gravity=NO_PULL))


@pytest.mark.parametrize(
    ("method", "accuracy", "error", "remedy"),
    [
        ("tree", 1e-5, "4e-05", "gravity.opening_angle = 0.35"),
        ("tree", 1e-9, "4e-05", 'gravity.method = "direct"'),
        ("fast-multipole", 1e-6, "4e-06", "gravity.opening_angle = 0.41"),
    ],
)
def test_a_tree_that_is_too_coarse_says_what_could_reach_the_accuracy(
    method: str, accuracy: float, error: str, remedy: str
) -> None:
    with pytest.raises(SceneError, match=f"whose error is about {error}; set {remedy}"):
        Space(scene_of(SPHERES, time={"accuracy": accuracy}, gravity={"method": method}))


def test_a_promise_without_an_accuracy_is_refused() -> None:
    text = "[promise]\nrefinement = 1.0\nuntil = 1.0\nlyapunov = 0.0\nerror = [0.0]\n[[body]]\n"
    with pytest.raises(SceneError, match=r"a \[promise\] without time.accuracy"):
        scene_from_text(text, "a scene")


@pytest.mark.slow
@pytest.mark.parametrize("index", [2, 6])
def test_balls_that_pull_and_bounce_keep_to_the_event_driven_solution(index: int) -> None:
    """Five balls that pull each other and bounce, beside the event-driven solution."""
    rng = np.random.default_rng(index)
    bodies: list[dict[str, Any]] = [
        {
            "position": (2.0 * np.array([k % 2, k // 2 % 2, k // 4]) + 0.8 * rng.random(3)).tolist(),
            "velocity": (rng.random(3) - 0.5).tolist(),
            "radius": 0.3,
            "mass": 0.2,
        }
        for k in range(5)
    ]
    common: dict[str, Any] = {
        "gravity": {"constant": 1.0},
        "contact": {"restitution": 0.9, "static_friction": 0.3 * (index % 2)},
    }
    scene = scene_of(bodies, time={"duration": 6.0, "accuracy": 1e-4}, **common)
    plain = scene_of(bodies, time={"duration": 6.0}, **common)
    times = np.linspace(0.0, 6.0, 25)[1:]
    exact = solve(Space(plain, 1), times, budget=20.0).trajectory
    space = Space(scene, 1)
    promise = space.scene.promise
    assert promise is not None
    start = space.state.position.copy()
    size = math.sqrt(float(np.mean(np.sum((start - start.mean(axis=0)) ** 2, axis=1))))
    for time, position in zip(exact.time, exact.position, strict=True):
        if time > promise.kept_until:
            break
        for _ in space.run(float(time), schedule=at(())):
            pass
        error = math.sqrt(float(np.mean(np.sum((space.state.position - position) ** 2, axis=1)))) / size
        assert error <= 1e-4, time
    assert len(exact.time) > 2


@pytest.mark.parametrize(
    ("chance", "expected", "why"),
    [
        (-1.0, [1, 2, 3, 4], "the first two are not believed, and one of the others may be chance"),
        (1e-3, [1, 2], "distances of rounding are no chance; one that shorter steps change nothing may be"),
    ],
)
def test_a_look_ahead_ends_where_shorter_steps_would_not_extend_the_promise(
    chance: float, expected: list[int], why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("carom.physics.look_ahead.find_step.CHANCE", chance)
    scene = ball(1e-6)
    scene = scene.model_copy(update={"time": scene.time.model_copy(update={"integrator": "leapfrog"})})
    compared: list[int] = []

    def cliff(
        times: FloatArray, apart: list[FloatArray], finest: float, order: int, accuracy: float, farthest: float
    ) -> tuple[float, float, FloatArray]:
        compared.append(len(apart))
        return 0.25, 0.5 * float(times[-1]), np.where(times <= 0.5 * times[-1], 0.0, 1.0)

    monkeypatch.setattr("carom.physics.look_ahead.find_step.extrapolate", cliff)
    promise = with_promise(scene, 1).promise
    assert promise is not None and promise.refinement == 0.25
    assert compared == expected, why


@pytest.mark.parametrize("accuracy", [1e-2, 1e-3, 1e-4])
def test_a_look_ahead_goes_on_while_steps_are_too_long_to_keep_an_accuracy_at_all(accuracy: float) -> None:
    speed = math.sqrt(1.9 / 0.1)  # at the pericentre of a = 1, e = 0.9
    scene = scene_of(
        [
            {"mass": 0.7, "radius": 1e-3, "position": [-0.03, 0, 0], "velocity": [0, -0.3 * speed, 0]},
            {"mass": 0.3, "radius": 1e-3, "position": [0.07, 0, 0], "velocity": [0, 0.7 * speed, 0]},
        ],
        time={"duration": 16.0 * math.pi, "accuracy": accuracy, "integrator": "leapfrog"},
        gravity={"constant": 1.0},
        contact={"enabled": False},
        record={"check_every": 1000},
    )
    space = run_to_the_end(scene)  # eight orbits
    assert space.scene.promise is not None and space.scene.promise.horizon is None
    away = space.state.position - [[-0.03, 0.0, 0.0], [0.07, 0.0, 0.0]]
    assert math.sqrt(float(np.mean(np.sum(away * away, axis=1)))) / 0.1 < 100 * accuracy
    assert space.energy().relative_error < accuracy


@pytest.mark.slow
def test_a_look_ahead_does_not_end_at_a_step_that_is_longer_than_it_needs_by_chance() -> None:
    balls = [(0.0, 1.0, 0.0), (0.05, 1.5, 0.0), (0.5, 0.5, -0.3)]  # they come to rest; runs of 2 and 4 differ by most
    scene = scene_of(
        [
            {"radius": 0.1, "density": 1000.0, "position": [x, 0.0, z], "velocity": [v, -v / 3, 0.0]}
            for x, z, v in balls
        ],
        time={"duration": 3.0, "accuracy": 1e-6},
        gravity={"uniform": [0.0, 0.0, -9.81]},
        contact={"restitution": 0.6, "static_friction": 0.3, "kinetic_friction": 0.3},
        plane=[{"point": [0.0, 0.0, 0.0]}],
    )
    promise = with_promise(scene, 1).promise
    assert promise is not None and promise.kept_until == 3.0


def test_a_look_ahead_notices_contacts_that_come_to_rest_after_its_last_but_one_time() -> None:
    scene = Scene.from_dict(
        {
            "time": {"duration": 1.6, "accuracy": 1e-4},
            "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -10.0]},
            "contact": {"restitution": 0.5},
            "plane": [{"point": [0.0, 0.0, 0.0]}],
            "body": [{"radius": 0.1, "mass": 1.0, "position": [0.0, 0.0, 1.1]}],
        }
    )
    run = TrialRun(scene, 1.0, 1, place(scene), np.array([0.4, 0.8, 1.2, 1.6]))  # at rest from 3 √(2 / 10) = 1.34 s
    assert run.at(2) is not None and run.rests_from == np.inf
    assert run.at(3) is not None and run.rests_from == 1.2


def chattering_cube() -> Scene:
    """Return 27 balls that fill a box, whose contacts at rest part and meet without end."""
    places = [[-0.02 * (x - 1), 0.02 * (y - 1), 0.02 * (z - 1)] for x in range(3) for y in range(3) for z in range(3)]
    velocities = np.random.default_rng(1).uniform(-1e-4, 1e-4, (27, 3)).tolist()
    return scene_of(
        [
            {"position": place, "velocity": velocity, "radius": 0.01 - 1e-11, "mass": 0.2}
            for place, velocity in zip(places, velocities, strict=True)
        ],
        time={"duration": 30.0, "max_dt": 20.0, "accuracy": 1e-6},
        gravity={"constant": 0.0, "uniform": [-2e-7, 0.0, -1e-7]},
        contact={"restitution": 0.5},
        domain={"boundary": "walls", "size": [0.06] * 3},
    )


def test_a_look_ahead_ends_where_chattering_contacts_take_steps_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carom.physics.look_ahead.trial_run.LEAST_OF_CONTACTS", 0.5)
    monkeypatch.setattr("carom.physics.look_ahead.trial_run.MOST", 0.5)
    runs: list[TrialRun] = []

    class Remembered(TrialRun):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            runs.append(self)

    monkeypatch.setattr("carom.physics.look_ahead.examined_runs.TrialRun", Remembered)
    promise = with_promise(chattering_cube(), 1).promise
    assert promise is not None and promise.kept_until < 30.0
    assert any(run.is_cut for run in runs)


def struck_pair(**time: Any) -> Scene:
    """Return two spheres that their own pull holds together, and a third that strikes one of them and parts them."""
    return scene_of(
        [
            {"position": [-0.5, 0.0, 0.0], "velocity": [0.0, -0.3, 0.0], "radius": 0.5, "mass": 1.0},
            {"position": [0.5, 0.0, 0.0], "velocity": [0.0, 0.3, 0.0], "radius": 0.5, "mass": 1.0},
            {"position": [-0.7, -4.0, 0.0], "velocity": [0.0, 3.0, 0.0], "radius": 0.2, "mass": 0.8},
        ],
        time={"duration": 2.0, **time},
        gravity={"constant": 1.0},
        contact=ELASTIC,
    )


def test_an_impact_on_bodies_at_rest_keeps_the_second_order() -> None:
    scene = struck_pair(accuracy=1e-6)

    def end(refinement: float) -> FloatArray:
        # the default budget ends the run with the shortest steps
        run = TrialRun(scene, refinement, 1, place(scene), np.array([2.0]), WorkBudget(2.0, least=10.0))
        found = run.at(0)
        assert found is not None
        return found

    ends = [end(refinement) for refinement in (2.0, 4.0, 8.0, 16.0)]
    apart = [float(np.abs(one - other).max()) for one, other in pairwise(ends)]
    # a fourth each; 1/2 with an impact in the middle of a step, by the impulse of the contact for the whole of it
    assert apart[1] <= 0.3 * apart[0]
    assert apart[2] <= 0.3 * apart[1]


def test_the_work_of_a_look_ahead_does_not_depend_on_compiled_kernels() -> None:
    """A kernel takes many steps of lasting contacts in a call, once a process has compiled it."""
    scene = struck_pair(accuracy=1e-6)

    def trial() -> tuple[float, int, float]:
        run = TrialRun(scene, 4.0, 1, place(scene), np.array([2.0]))
        run.at(0)
        return run.work, run.steps, run.reached

    first = trial()
    with compiling_all():
        assert trial() == first


def test_gauss_radau_goes_on_once_contacts_at_rest_have_parted() -> None:
    space = Space(struck_pair(accuracy=1e-4))
    frames = list(space.run(schedule=every(0.0)))
    limits = [frame.dt_limit for frame in frames]
    parted = max(k for k, frame in enumerate(frames) if frame.dt_limit not in ("error", "end"))
    assert frames[0].events or frames[1].events  # at rest from the start
    assert "error" in limits[parted:]
    assert frames[parted].time < 1.5
    for k in (parted - 2, parted, parted + 1):
        space.restore(frames[k].checkpoint)
        assert [f.fingerprint for f in space.run(schedule=every(0.0))] == [f.fingerprint for f in frames[k:]]


def test_a_run_ahead_shows_bodies_at_rest_at_the_times_that_were_asked_for() -> None:
    scene = scene_of(
        [{"position": [0.0, 0.0, 0.1], "velocity": [1.0, 0.0, 0.0], "radius": 0.1}],
        time={"duration": 2.0, "accuracy": 1e-4},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -10.0]},
        plane=[{"point": [0.0, 0.0, 0.0]}],
        contact=ELASTIC,
    )
    times = np.array([0.31, 0.94, 1.7])
    run = TrialRun(scene, 1.0, 1, place(scene), times)
    found = [run.at(k) for k in range(3)]
    assert [each[0, 0] for each in found if each is not None] == pytest.approx(times.tolist(), abs=1e-12)  # 1 m/s
