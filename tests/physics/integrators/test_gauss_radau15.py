"""Gauss–Radau integration: its order, its error, and that its bits depend on nothing but the scene."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import carom
from carom.errors import PhysicsError, SceneError
from carom.physics.integrators.gauss_radau.radau_step import NODES
from carom.physics.schedule import at, every
from carom.physics.space import Space
from carom.recording.read.recording import Recording
from carom.runs.replay import replay
from carom.runs.resume import continue_run, resumable_run
from carom.scene.load import Scene
from small_scenes import scene_of

RADAU = "gauss-radau15"
PYTHAGOREAN: list[dict[str, Any]] = [  # Burrau (1913): at rest at the corners of a triangle of sides 3, 4 and 5
    {"mass": 3.0, "radius": 0.01, "position": [1, 3, 0]},
    {"mass": 4.0, "radius": 0.01, "position": [-2, -1, 0]},
    {"mass": 5.0, "radius": 0.01, "position": [1, -1, 0]},
]


def binary(eccentricity: float, periods: float, **sections: Any) -> Scene:
    """Two equal masses, G (m₁ + m₂) = 1, semi-major axis 1, at pericentre."""
    r, v = 1.0 - eccentricity, float(np.sqrt((1.0 + eccentricity) / (1.0 - eccentricity)))
    bodies = [
        {"mass": 0.5, "radius": 1e-6, "position": [-r / 2, 0, 0], "velocity": [0, -v / 2, 0]},
        {"mass": 0.5, "radius": 1e-6, "position": [r / 2, 0, 0], "velocity": [0, v / 2, 0]},
    ]
    return points(bodies, 2.0 * np.pi * periods, **sections)


def points(bodies: list[dict[str, Any]], duration: float, **sections: Any) -> Scene:
    """Bodies that pull each other, G = 1, and cannot touch."""
    time = {"duration": duration, "max_dt": 1e9, "integrator": RADAU}
    extra = dict(sections)
    time |= extra.pop("time", {})
    gravity = {"constant": 1.0} | extra.pop("gravity", {})
    return scene_of(bodies, time=time, gravity=gravity, contact={"enabled": False}, **extra)


def final(scene: Scene) -> Space:
    space = Space(scene)
    for _ in space.run(schedule=at(())):
        pass
    return space


def separation(space: Space) -> NDArray[np.float64]:
    return np.asarray(space.state.position[1] - space.state.position[0])


def test_the_nodes_are_those_of_gauss_radau_quadrature() -> None:
    # the zeros of P₇ + P₈, moved from [-1, 1] to [0, 1]; Bonnet's recursion in exact arithmetic
    for node in NODES:
        x = 2 * node - 1
        before, legendre = Fraction(1), x
        for k in range(1, 8):
            before, legendre = legendre, ((2 * k + 1) * x * legendre - k * before) / (k + 1)
        assert abs(before + legendre) <= Fraction(1, 10**33)  # the nodes are written with 36 digits


@pytest.mark.parametrize(("eccentricity", "tolerance"), [(0.0, 1e-11), (0.5, 1e-11), (0.9, 1e-9), (0.999, 1e-6)])
def test_a_binary_returns_after_a_hundred_periods(eccentricity: float, tolerance: float) -> None:
    # Rounding alone: 10⁻¹⁶ a step in the energy, random, of N steps makes a phase error of 10⁻¹⁶ √N × 2π × 100 × 3/2,
    # some 10⁻¹¹, which the speed at pericentre, √((1 + e)/(1 - e)), and the periods' growth with 1/(1 - e) multiply.
    space = final(binary(eccentricity, 100.0))
    assert np.abs(separation(space) - [1.0 - eccentricity, 0.0, 0.0]).max() <= tolerance
    of_pericentre = (1.0 + eccentricity) / (1.0 - eccentricity)  # kinetic energy there over that of the orbit
    assert space.energy().relative_error <= 1e-16 * of_pericentre * np.sqrt(space.step)


def test_an_eccentric_orbit_takes_few_steps_at_apocentre_and_many_at_pericentre() -> None:
    steps = [frame.dt for frame in Space(binary(0.9, 1.0, record={"every": "step"})).run()][2:-1]
    # τ ~ r^{3/2}: steps at r = 1 + e are 19^{3/2} = 83 times as long as at 1 - e; those next to the ends are not there
    assert max(steps) / min(steps) >= 40.0


def test_steps_on_a_circle_are_those_of_the_tolerance() -> None:
    steps = [frame.dt for frame in Space(binary(0.0, 1.0, record={"every": "step"})).run()][5:-1]
    # acceleration and its derivatives have the size 1, so T' = (5040 × 10⁻⁹)^{1/7} √(2/(1 + 1)), but for missing terms
    assert np.abs(np.array(steps) / (5040e-9) ** (1 / 7) - 1.0).max() <= 1e-9


def test_a_body_that_nothing_pulls_at_the_start_does_not_stop_the_figure_eight() -> None:
    # the pulls on the middle body cancel at t = 0, so the time in which its acceleration changes is 0 there
    scene = Scene.load("figure-eight", ["time.fixed_dt=", "time.integrator=gauss-radau15", "time.max_dt=1.0"])
    space = Space(scene)
    start = space.state.position.copy()
    space.reach(scene.time.duration)
    # two periods, as accurate as the published initial values, eight decimals
    assert np.abs(space.state.position - start).max() <= 1e-6
    assert space.step < 600  # 2000 if steps follow the change relative to an acceleration of 0


def test_a_body_that_swings_through_the_middle_of_a_binary_keeps_its_energy() -> None:
    """Sitnikov's problem: the pull on the body passes 0 in the middle, and its change relative to it has no bound."""
    pair = [{"mass": 0.5, "radius": 1e-6, "position": [x, 0, 0], "velocity": [0, x, 0]} for x in (-0.5, 0.5)]
    probe = {"mass": 1e-13, "radius": 1e-6, "position": [0, 0, 1.0]}
    space = final(points([*pair, probe], 100.0))
    height, speed = space.state.position[2, 2], space.state.velocity[2, 2]
    energy = 0.5 * speed**2 - 1.0 / np.sqrt(height**2 + 0.25)
    assert abs(energy + 1.0 / np.sqrt(1.25)) < 1e-11  # the probe's pull moves the pair by some 1e-13 a period
    assert space.step < 3000


def test_with_fixed_steps_the_order_is_fifteen() -> None:
    # in 4 and in 6 steps; both errors are far above rounding, 10⁻¹⁵, the second near the limit of small steps
    four, six, exact = (
        final(binary(0.3, 1.0, time={"duration": 2.9, "fixed_dt": 2.9 / steps})).state.position for steps in (4, 6, 400)
    )
    errors = np.abs(four - exact).max(), np.abs(six - exact).max()
    assert np.log(errors[0] / errors[1]) / np.log(6 / 4) == pytest.approx(15.0, abs=1.5)


def test_the_pythagorean_problem_agrees_with_dop853_until_chaos_parts_them() -> None:
    mass = np.array([3.0, 4.0, 5.0])

    def rates(_: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        x, v = y.reshape(2, 3, 3)
        way = x[None] - x[:, None]
        cube = np.linalg.norm(way, axis=2) ** 3 + np.eye(3)
        return np.concatenate((v.ravel(), (mass[None, :, None] * way / cube[:, :, None]).sum(axis=1).ravel()))

    start = np.concatenate((np.ravel([body["position"] for body in PYTHAGOREAN]), np.zeros(9))).astype(float)
    exact = solve_ivp(rates, (0.0, 12.0), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:9, -1].reshape(3, 3)
    found = final(points(PYTHAGOREAN, 12.0)).state.position
    # close passes up to t = 12 multiply rounding and DOP853's tolerance by some 10⁴
    assert np.abs(found - exact).max() <= 1e-8


def planets(periods: float, seed: int) -> Scene:
    """A star and eight planets on circles at random phases, for so many periods of the innermost."""
    rng = np.random.default_rng(seed)
    bodies: list[dict[str, Any]] = [{"mass": 1.0, "radius": 1e-6}]
    for axis in (0.39, 0.72, 1.0, 1.52, 5.2, 9.5, 19.2, 30.0):
        angle = rng.uniform(0.0, 2.0 * np.pi)
        ray, ahead = [np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0]
        place, speed = (np.array(ray) * axis).tolist(), (np.array(ahead) * np.sqrt(1.0 / axis)).tolist()
        bodies.append({"mass": 1e-5, "radius": 1e-6, "position": place, "velocity": speed})
    return points(bodies, periods * 2.0 * np.pi * 0.39**1.5, record={"check_every": 1_000_000, "every": 1e9})


@pytest.mark.slow
def test_the_energy_error_of_planets_grows_no_faster_than_a_random_walk() -> None:
    few, many = (
        np.median([final(planets(periods, seed)).energy().relative_error for seed in range(3)])
        for periods in (100, 1600)
    )
    # one last bit of the energy, 2 × 10⁻¹⁶, for its own summation at either end, and √16 for the walk
    assert many <= 4.0 * few + 4e-16
    assert many <= 1e-16 * np.sqrt(36 * 1600)  # a last bit in each of 36 steps a period


def test_the_energy_of_a_planetary_system_errs_by_rounding_only() -> None:
    space = final(planets(300, 3))
    # a random walk of some 5000 steps of a rounding error, 10⁻¹⁶ × √5000 = 8 × 10⁻¹⁵, and that of summing the energy
    assert space.energy().relative_error <= 1e-14


def test_softening_fixed_bodies_and_a_uniform_field_act_as_with_other_integrators() -> None:
    bodies: list[dict[str, Any]] = [
        {"mass": 1.0, "radius": 0.01, "fixed": True},
        {"mass": 0.1, "radius": 0.01, "position": [1, 0, 0], "velocity": [0, 1, 0.2]},
        {"mass": 0.2, "radius": 0.01, "position": [0, 2, 0], "velocity": [-0.5, 0, 0]},
    ]
    gravity = {"softening": 0.1, "uniform": [0.01, 0.0, -0.02]}
    found = final(points(bodies, 5.0, gravity=gravity))
    coarse, fine = (
        final(points(bodies, 5.0, gravity=gravity, time={"integrator": "yoshida4", "fixed_dt": dt})).state.position
        for dt in (1e-3, 5e-4)
    )
    assert found.state.position[0].tolist() == [0.0, 0.0, 0.0]
    # Yoshida's errors of order four, 8 × 10⁻⁹ and a sixteenth of that, cancel but for those of order six
    assert np.abs(found.state.position - (16.0 * fine - coarse) / 15.0).max() <= 1e-11


def fingerprints(scene: Scene, **how: Any) -> dict[int, int]:
    return {frame.step: frame.fingerprint for frame in Space(scene).run(**how)}


def test_bits_do_not_depend_on_frames_checks_or_threads() -> None:
    scene = points(PYTHAGOREAN, 5.0)
    steps = fingerprints(scene, schedule=every(0.0))
    last = max(steps)
    for schedule in (at(()), at((3, 4, 50)), every(0.7), lambda step, before, time: step % 7 == 0):
        found = fingerprints(scene, schedule=schedule)
        assert found.items() <= steps.items() and last in found
    rarely = points(PYTHAGOREAN, 5.0, record={"check_every": 7})
    assert fingerprints(rarely, schedule=at(())).items() <= steps.items()
    alone = Space(scene, threads=1)
    assert {frame.step: frame.fingerprint for frame in alone.run(schedule=every(0.7))}.items() <= steps.items()
    space = Space(scene)
    for step in range(1, 51):
        space.compute_dynamics(step)
    assert space.fingerprint() == steps[50]


def test_spinning_bodies_turn_alike_however_many_frames_there_are() -> None:
    bodies = [body | {"angular_velocity": [0.3, 0.0, 1.0]} for body in PYTHAGOREAN]
    scene = points(bodies, 3.0)
    steps = fingerprints(scene, schedule=every(0.0))
    assert fingerprints(scene, schedule=every(0.5)).items() <= steps.items()


def test_a_run_goes_on_from_a_checkpoint_with_the_same_bits() -> None:
    scene = points(PYTHAGOREAN, 5.0)
    frames = list(Space(scene).run(schedule=every(0.0)))
    space = Space(scene)
    space.restore(frames[40].checkpoint)
    assert [frame.fingerprint for frame in space.run(schedule=every(0.0))] == [f.fingerprint for f in frames[40:]]


def test_a_recording_is_replayed_and_resumed_with_the_same_bits(tmp_path: Path) -> None:
    scene, path = points(PYTHAGOREAN, 2.0), tmp_path / "three.rrd"
    recording = carom.run(scene, path)
    assert replay(recording).same
    assert replay(recording, 1.0, 1.5).same  # from a checkpoint, not from the start
    run = resumable_run(recording, until=3.0)
    resumed = Recording.open(continue_run(run, run.space(), tmp_path / "more.rrd").path)
    assert replay(resumed).same


def test_the_solution_within_a_step_is_that_of_a_run_which_ends_there() -> None:
    scene = binary(0.5, 1.0)
    space = Space(scene)
    for step in range(1, 31):
        space.compute_dynamics(step)
    moment = space.time - 0.4 * space.dt
    solution = space.between(moment)
    assert solution is not None
    ended = final(binary(0.5, 1.0, time={"duration": moment})).state
    # both err by 10⁻⁹/5040 of a step's last term at most; speeds and distances are about 1
    assert np.abs(solution[0] - ended.position).max() <= 1e-13
    assert np.abs(solution[1] - ended.velocity).max() <= 1e-13


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"gravity": {"method": "tree"}}, 'gravity.method = "tree", whose error it cannot control'),
        ({"gravity": {"method": "fast-multipole"}}, 'gravity.method = "fast-multipole", whose error it cannot control'),
        ({"time": {"pull_fraction": 0.1}}, "time.pull_fraction with .*remove time.pull_fraction"),
        ({"time": {"cfl": 0.1}}, "time.cfl with"),
        ({"drag": {"relaxation_time": 1.0}}, r"with \[drag\]"),
        ({"domain": {"boundary": "periodic", "size": [9, 9, 9]}, "gravity": {"constant": 0.0}}, "in a periodic box"),
    ],
)
def test_scenes_that_gauss_radau15_cannot_integrate_are_refused_with_the_remedy(
    sections: dict[str, Any], message: str
) -> None:
    contact = sections.pop("contact", {"enabled": False})
    bodies: list[dict[str, Any]] = [{"mass": 1.0}, {"mass": 1.0, "position": [3, 0, 0]}]
    time = {"integrator": RADAU} | sections.pop("time", {})
    with pytest.raises(SceneError, match=message):
        Space(scene_of(bodies, time=time, contact=contact, **sections))


def test_points_that_fall_straight_into_each_other_end_the_run_with_the_remedy() -> None:
    bodies = [{"mass": 1.0, "radius": 1e-9, "position": [x, 0, 0]} for x in (-1.0, 1.0)]
    with pytest.raises(PhysicsError, match=r"no longer moves the clock|not finite|centres"):
        final(points(bodies, 10.0))


def earth(duration: str, **time: Any) -> Scene:
    """The Earth around the Sun, in SI units; steps of a second would be 31 million a year."""
    return Scene.from_dict(
        {
            "time": {"duration": duration, "integrator": RADAU} | time,
            "gravity": {"constant": 6.6743e-11},
            "body": [
                {"name": "Sun", "radius": "695700 km", "mass": 1.98847e30},
                {
                    "name": "Earth",
                    "radius": "6371 km",
                    "mass": 5.9722e24,
                    "position": [1.495978707e11, 0.0, 0.0],
                    "velocity": [0.0, 29784.7, 0.0],
                },
            ],
        }
    )


def test_two_years_of_the_earth_take_some_eighty_steps() -> None:
    space = final(earth("2 yr"))
    assert space.step < 200
    assert space.energy().relative_error < 1e-14  # rounding of 79 steps


def test_a_largest_step_that_the_scene_gives_still_holds() -> None:
    space = final(earth("1 d", max_dt="1 h"))
    assert 24 <= space.step < 30  # the first steps grow by a factor of four


def test_steps_without_a_limit_do_not_depend_on_the_duration_of_the_run() -> None:
    one, two = Space(earth("1 yr")), Space(earth("2 yr"))
    for step in range(1, 21):
        one.compute_dynamics(step)
        two.compute_dynamics(step)
    assert one.fingerprint() == two.fingerprint()


def test_a_body_that_nothing_pulls_crosses_a_long_run_in_few_steps() -> None:
    body = {"radius": 1.0, "mass": 1.0, "velocity": [1.0, 0.0, 0.0]}
    space = final(Scene.from_dict({"time": {"duration": 1e6, "integrator": RADAU}, "body": [body]}))
    assert space.step < 20  # each step may be four times as long as the one before
    assert space.state.position[0, 0] == 1e6
