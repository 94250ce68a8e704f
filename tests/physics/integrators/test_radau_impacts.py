"""Impacts with gauss-radau15: where they happen, what they conserve, and that none is missed."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import carom
from carom.contact_table import IMPACT_MODE
from carom.errors import SceneError
from carom.lab.compared_run import follow
from carom.lab.tradeoff.event_driven_reference import solve
from carom.physics.integrators.gauss_radau.gauss_radau15 import GaussRadau15
from carom.physics.integrators.gauss_radau.radau_impacts import Solids
from carom.physics.integrators.gauss_radau.radau_step import motion_of
from carom.physics.schedule import at, every
from carom.physics.space import Space
from carom.recording.read.recording import Recording
from carom.runs.outlook import forewarning
from carom.runs.replay import replay
from carom.runs.resume import continue_run, resumable_run
from carom.scene.load import Scene
from small_scenes import scene_of

FloatArray = NDArray[np.float64]

RADAU = "gauss-radau15"


def solid(bodies: list[dict[str, Any]], duration: float, e: float = 1.0, **sections: Any) -> Scene:
    """Smooth spheres that pull each other, G = 1, and bounce."""
    extra = dict(sections)
    time = {"duration": duration, "max_dt": 1e9, "integrator": RADAU} | extra.pop("time", {})
    contact = {"restitution": e, "static_friction": 0.0, "kinetic_friction": 0.0} | extra.pop("contact", {})
    gravity = {"constant": 1.0} | extra.pop("gravity", {})
    return scene_of(bodies, time=time, gravity=gravity, contact=contact, **extra)


def falling_pair(duration: float, e: float) -> Scene:
    """The pair of `published/test_two_body_bounce`."""
    return solid([{"position": [x, 0, 0], "radius": 2.0, "mass": 1.0} for x in (-10, 10)], duration, e)


def comet(after: float = 0.0) -> tuple[Scene, float, float]:
    """A comet of a = 17.8 au and e = 0.9999 from its apocentre on, which hits its sun.

    Returns the scene, up to ``after`` s after the impact, the time of the impact by Kepler's equation (s), and its
    speed by vis-viva (m/s).
    """
    mu, a, e, sun, small = 6.6743e-11 * 1.98847e30, 17.8 * 1.495978707e11, 0.9999, 6.957e8, 5e3
    bodies: list[dict[str, Any]] = [
        {"mass": 1.98847e30, "radius": sun},
        {
            "mass": 1.0,
            "radius": small,
            "position": [a * (1.0 + e), 0, 0],
            "velocity": [0, math.sqrt(mu / a * (1.0 - e) / (1.0 + e)), 0],
        },
    ]
    anomaly = math.acos((1.0 - (sun + small) / a) / e)
    impact = (math.pi - (anomaly - e * math.sin(anomaly))) * math.sqrt(a**3 / mu)
    speed = math.sqrt(mu * (2.0 / (sun + small) - 1.0 / a))
    scene = scene_of(bodies, time={"duration": impact + after}, gravity={"constant": 6.6743e-11})
    return scene, impact, speed


def test_a_comet_hits_its_sun_at_the_time_of_kepler_with_the_speed_of_vis_viva() -> None:
    scene, impact, speed = comet()
    space = Space(scene.model_copy(update={"time": scene.time.model_copy(update={"duration": 2.0 * impact})}), 1)
    while not space.extremes.impacts:
        before = np.linalg.norm(space.state.velocity[1] - space.state.velocity[0])
        space.compute_dynamics(space.step + 1)
    assert space.step < 1000
    # rounding of the coordinates at 36 au is 10⁻³ m, and the comet arrives at 6 × 10⁵ m/s
    assert space.time == pytest.approx(impact, rel=1e-12)
    assert before < speed
    row = space.impacts.log[0]
    sideways = math.sqrt(speed**2 - float(row["approach"]) ** 2)
    momentum = 17.8 * 1.495978707e11 * 1.9999 * np.linalg.norm(scene.body[1].velocity)
    assert sideways == pytest.approx(momentum / (6.957e8 + 5e3), rel=1e-9)  # the angular momentum


def test_a_run_whose_steps_become_short_says_so_before_it_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The comet slides and rolls on its sun at hundreds of km/s, and moves by half its radius in a step."""
    monkeypatch.setattr("carom.runs.outlook.FORWARN_SECONDS", 0.3)
    scene, impact, speed = comet(after=2.4e7)
    text = forewarning(Space(scene, 1))
    found = re.search(r"about (\S+) steps, .* hours: from t = (\S+) s on, .*limit: velocity.*raise time.cfl", text)
    assert found, text
    steps = 2.4e7 * speed / (0.5 * 5e3)  # a part of the speed is lost in the impact
    assert 0.05 * steps < float(found[1]) < 2.0 * steps
    assert float(found[2]) == pytest.approx(impact, rel=1e-2)
    assert forewarning(Space(falling_pair(1.0, 1.0), 1)) == ""


def three_bodies(duration: float, e: float = 1.0, **sections: Any) -> Scene:
    """Three unequal spheres that meet many times."""
    bodies = [
        {"mass": 1.0, "radius": 0.3, "position": [1.0, 0.2, 0.0]},
        {"mass": 0.5, "radius": 0.2, "position": [-1.0, 0.0, 0.3], "velocity": [0.0, 0.3, 0.0]},
        {"mass": 0.2, "radius": 0.1, "position": [0.0, 1.0, -0.2], "velocity": [0.4, 0.0, 0.1]},
    ]
    return solid(bodies, duration, e, **sections)


def impacts_of(space: Space) -> list[tuple[float, int, int]]:
    return [
        (float(row["time"]), int(row["i"]), int(row["j"]))
        for frame in space.run(schedule=at(()))
        if frame.impacts is not None
        for row in frame.impacts
    ]


def fall(apocentre: float, contact: float) -> float:
    """The time from rest to contact, G (m₁ + m₂) = 2."""
    q = contact / apocentre
    return math.sqrt(apocentre**3 / 4) * (math.acos(math.sqrt(q)) + math.sqrt(q * (1 - q)))


def test_two_spheres_that_fall_together_bounce_when_kepler_says() -> None:
    space = Space(falling_pair(84.0, 0.5), record_contacts=True)
    expected, time, energy = [], fall(20.0, 4.0), -2 / 20
    while time < 84.0:
        expected.append(time)
        energy = (energy + 2 / 4) / 4 - 2 / 4
        time += 2 * fall(-2 / energy, 4.0)
    found = [time for time, _, _ in impacts_of(space)]
    # the clock's last bit, 1.4 × 10⁻¹⁴ s, at each impact; a last bit of the gap, 10⁻¹⁵ m, at 0.05 m/s in the last one
    assert np.abs(np.array(found) - expected).max() <= 3e-13
    assert len(found) == len(expected) == 5


def test_a_hundred_elastic_bounces_keep_their_period() -> None:
    found = [time for time, _, _ in impacts_of(Space(falling_pair(13_600.0, 1.0), record_contacts=True))]
    expected = fall(20.0, 4.0) * (2 * np.arange(len(found)) + 1)
    assert len(found) == 101
    # The kinetic energy at contact is 8 times the whole, so its last bits, 10⁻¹⁶ in each of 5000 steps at random,
    # change the period by 10⁻¹⁴ × 8 × 3/2: 1.2 × 10⁻¹³ × 13 600 s, if all came at once
    assert np.abs(np.array(found) - expected).max() <= 2e-9


def test_a_ball_on_a_plane_bounces_at_the_times_of_free_fall() -> None:
    ball = [{"mass": 1.0, "radius": 0.5, "position": [0, 0, 1.5], "velocity": [0.3, 0.0, 0.0]}]
    plane = [{"point": [0, 0, 0], "normal": [0, 0, 1]}]
    gravity = {"constant": 0.0, "uniform": [0, 0, -9.81]}
    space = Space(solid(ball, 100.0, gravity=gravity, plane=plane), record_contacts=True)
    found = [time for time, _, _ in impacts_of(space)]
    expected = math.sqrt(2 / 9.81) * (2 * np.arange(len(found)) + 1)
    assert len(found) == 111
    # each bounce adds a last bit of the clock, 1.4 × 10⁻¹⁴ s at most, and of the speed, 10⁻¹⁶ × 0.9 s: 111 of them
    assert np.abs(np.array(found) - expected).max() <= 111 * 1.5e-14
    assert space.energy().relative_error <= 111 * 2.0**-52


@pytest.mark.parametrize("e", [1.0, 0.8])
def test_three_bodies_with_impacts_follow_the_event_driven_reference(e: float) -> None:
    scene = three_bodies(5.0, e)
    times = np.linspace(0.1, 5.0, 50)
    reference = solve(Space(scene), times)
    space = Space(scene, record_contacts=True)
    found = impacts_of(space)
    assert not reference.ended and len(found) == len(reference.time) >= 4
    assert np.abs(np.array([time for time, _, _ in found]) - reference.time).max() <= 1e-10
    # DOP853 errs by 10⁻¹³ a step in some hundred steps, and each impact multiplies errors by a few
    assert np.abs(space.state.position - reference.trajectory.position[-1]).max() <= 1e-10


def test_elastic_impacts_keep_energy_and_momenta_to_rounding() -> None:
    space = Space(three_bodies(20.0, record={"every": 1.0}))
    start = space.momentum(), space.angular_momentum()
    for _ in space.run():
        pass
    assert space.extremes.impacts >= 15
    steps = np.sqrt(space.step)
    assert space.energy().relative_error <= 1e-15 * steps  # a random walk; kinetic energies are several times the whole
    assert np.abs(space.momentum() - start[0]).max() <= 2e-16 * steps
    assert np.abs(space.angular_momentum() - start[1]).max() <= 2e-16 * steps


def test_the_ledger_has_what_inelastic_impacts_with_friction_take_out() -> None:
    friction = {"static_friction": 0.4, "kinetic_friction": 0.3}
    space = Space(three_bodies(5.0, 0.9, contact=friction, expect={"contact_audit": 1e-12}), record_contacts=True)
    rows = [row for frame in space.run() if frame.impacts is not None for row in frame.impacts]
    assert len(rows) >= 3 and all(row["mode"] == IMPACT_MODE for row in rows)
    ledger = space.ledger
    assert ledger.restitution > 0.01 and ledger.friction > 0.001
    assert ledger.restitution == pytest.approx(sum(row["restitution_loss"] for row in rows), rel=1e-14)
    assert ledger.friction == pytest.approx(sum(row["friction_loss"] for row in rows), rel=1e-14)
    # what the energy lacks is in the ledger, to the rounding of some hundred steps
    assert space.energy().relative_error <= 1e-14
    audit = space.extremes.contact_audit
    assert audit is not None and audit.value <= 1e-12


def test_a_run_through_an_elastic_impact_goes_back_to_where_it_began() -> None:
    scene = three_bodies(3.0)
    there = Space(scene, record_contacts=True)
    impacts = len(impacts_of(there))
    back = Space(scene)
    back.state.position[:], back.state.velocity[:] = there.state.position, -there.state.velocity
    first = Space(scene).state
    for _ in back.run(schedule=at(())):
        pass
    assert impacts >= 2
    assert np.abs(back.state.position - first.position).max() <= 1e-12  # rounding, which impacts multiply
    assert np.abs(back.state.velocity + first.velocity).max() <= 1e-12


def test_a_cradle_passes_the_impulse_on_to_the_last_ball_at_one_moment() -> None:
    touching = [{"mass": 1.0, "radius": 0.5, "position": [float(k), 0, 0]} for k in range(4)]
    striker = {"mass": 1.0, "radius": 0.5, "position": [-3.0, 0, 0], "velocity": [2.0, 0, 0]}
    space = Space(solid([striker, *touching], 2.0, gravity={"constant": 0.0}), record_contacts=True)
    found = impacts_of(space)
    assert [pair[1:] for pair in found] == [(0, 1), (1, 2), (2, 3), (3, 4)]
    assert {pair[0] for pair in found} == {1.0}
    assert space.state.velocity[:, 0].tolist() == [0.0, 0.0, 0.0, 0.0, 2.0]


def test_fixed_bodies_and_walls_are_hit_and_stay() -> None:
    bodies: list[dict[str, Any]] = [
        {"mass": 1.0, "radius": 0.3, "fixed": True},
        {"mass": 0.1, "radius": 0.1, "position": [1.0, 0.1, 0], "velocity": [1.5, 0.9, 0.4]},
    ]
    space = Space(solid(bodies, 20.0, domain={"boundary": "walls", "size": [3, 3, 3]}), record_contacts=True)
    found = impacts_of(space)
    assert {j for _, _, j in found} >= {1, 2, 5} and len(found) >= 15
    assert space.state.position[0].tolist() == [0.0, 0.0, 0.0]
    assert space.energy().relative_error <= 1e-15 * np.sqrt(space.step)
    assert np.abs(space.state.position[1]).max() <= 1.4 and np.linalg.norm(space.state.position[1]) >= 0.4


def closest(integrator: GaussRadau15, radius: FloatArray) -> float:
    """Return the smallest gap at 20 moments of the last step, over the smaller radius."""
    found = np.inf
    i, j = np.triu_indices(len(radius), 1)
    for part in np.linspace(0.0, 1.0, 20):
        x = integrator.at(part * integrator.last_dt)[0]
        gap = np.linalg.norm(x[j] - x[i], axis=1) - radius[i] - radius[j]
        found = min(found, float((gap / np.minimum(radius[i], radius[j])).min()))
    return found


@pytest.mark.parametrize("seed", range(4))
def test_no_small_fast_or_grazing_body_passes_into_another(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    mass, radius = 10 ** rng.uniform(-3, 0, n), 10 ** rng.uniform(-4, -1.3, n)
    position, velocity = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    for k in range(1, n):  # aimed at the first, past its centre by up to the sum of radii and a little more
        way, aside = position[0] - position[k], rng.normal(size=3)
        aside -= aside @ way / (way @ way) * way
        miss = (radius[0] + radius[k]) * rng.choice([0.0, 0.5, 1 - 1e-6, 1 - 1e-12, 1.0, 1 + 1e-9])
        aim = way + miss * aside / np.linalg.norm(aside)
        velocity[k] = aim / np.linalg.norm(aim) * rng.choice([1.0, 30.0, 500.0])
    still = np.zeros(0, np.int64), np.zeros(3)  # nothing is fixed, and no field
    motion = motion_of(position, velocity, mass.copy(), *still, 0.0)
    integrator = GaussRadau15(motion, 1e9, None, solids=Solids.of(radius))
    integrator.begin(1e-3)
    time, hits = 0.0, 0
    while time < 1.0 and hits < 200:
        batch = integrator.advance(time, 1.0, np.inf, 1)
        time = batch.time
        assert batch.meeting is None or not batch.meeting.rests
        if batch.steps:
            # a last bit of the coordinates, about 10⁻¹⁵ m, over radii of 10⁻⁴ m
            assert closest(integrator, radius) >= -1e-10
        if batch.meeting:
            i, j = batch.meeting.ends
            normal = (position[j] - position[i]) / np.linalg.norm(position[j] - position[i])
            impulse = -2.0 * ((velocity[j] - velocity[i]) @ normal) / (1 / mass[i] + 1 / mass[j])
            velocity[i] -= impulse / mass[i] * normal
            velocity[j] += impulse / mass[j] * normal
            hits += 1


def fingerprints(scene: Scene, threads: int | None = None, **how: Any) -> dict[int, int]:
    return {frame.step: frame.fingerprint for frame in Space(scene, threads).run(**how)}


def test_bits_do_not_depend_on_frames_checks_or_threads() -> None:
    scene = three_bodies(3.0, 0.9, contact={"static_friction": 0.4, "kinetic_friction": 0.3})
    steps = fingerprints(scene, schedule=every(0.0))
    for threads, schedule in ((1, at(())), (2, every(0.7))):
        assert fingerprints(scene, threads, schedule=schedule).items() <= steps.items()
    smooth = three_bodies(3.0, 0.9, record={"check_every": 1})
    rarely = three_bodies(3.0, 0.9, record={"check_every": 9})
    assert fingerprints(rarely, schedule=at(())).items() <= fingerprints(smooth, schedule=every(0.0)).items()


def test_a_run_goes_on_from_any_checkpoint_with_the_same_bits() -> None:
    scene = three_bodies(2.0, 0.9)
    frames = list(Space(scene).run(schedule=every(0.0)))
    after_impact = [k for k, frame in enumerate(frames) if len(frame.contacts)]
    assert after_impact
    for k in (0, 5, *after_impact[:2]):
        space = Space(scene)
        space.restore(frames[k].checkpoint)
        again = [frame.fingerprint for frame in space.run(schedule=every(0.0))]
        assert again == [frame.fingerprint for frame in frames[k:]]


def test_a_recording_with_impacts_is_replayed_and_resumed_with_the_same_bits(tmp_path: Path) -> None:
    scene = three_bodies(2.0, 0.9, record={"every": 0.1})
    recording = carom.run(scene, tmp_path / "three.rrd")
    assert replay(recording).same
    run = resumable_run(recording, until=3.0)
    resumed = Recording.open(continue_run(run, run.space(), tmp_path / "more.rrd").path)
    assert replay(resumed).same


def test_leapfrog_holds_contacts_that_come_to_rest_and_an_event_says_so() -> None:
    space = Space(falling_pair(90.0, 0.5))
    events = [event for frame in space.run() for event in frame.events]
    [said] = [event for event in events if event.kind == "at-rest"]
    assert said.time == pytest.approx(84.50126, abs=1e-4)  # the limit of the times of all bounces
    assert "leapfrog integrates" in said.text
    distance = float(np.linalg.norm(space.state.position[1] - space.state.position[0]))
    assert distance == pytest.approx(4.0, abs=1e-8)
    assert np.abs(space.state.velocity).max() <= 1e-9
    assert space.energy().relative_error <= 1e-9


def test_spheres_that_touch_at_the_start_are_held_from_the_start() -> None:
    bodies = [{"position": [x, 0, 0], "radius": 1.0, "mass": 1.0} for x in (-1, 1)]
    space = Space(solid(bodies, 5.0))
    events = [event for frame in space.run() for event in frame.events]
    assert [event.time for event in events if event.kind == "at-rest"] == [0.0]
    assert np.abs(space.state.position[:, 0]).tolist() == pytest.approx([1.0, 1.0], abs=1e-9)


def test_a_run_goes_on_after_contacts_came_to_rest_with_the_same_bits(tmp_path: Path) -> None:
    scene = falling_pair(86.0, 0.5)
    frames = list(Space(scene).run(schedule=every(0.0)))
    at_rest = next(k for k, frame in enumerate(frames) if any(event.kind == "at-rest" for event in frame.events))
    for k in (at_rest - 1, at_rest, at_rest + 3):
        space = Space(scene)
        space.restore(frames[k].checkpoint)
        assert [frame.fingerprint for frame in space.run(schedule=every(0.0))] == [f.fingerprint for f in frames[k:]]
    recording = carom.run(falling_pair(86.0, 0.5), tmp_path / "fall.rrd")
    assert replay(recording).same
    assert replay(recording, 85.0, 85.5).same


def test_the_trajectory_of_a_study_has_the_impacts_at_their_times() -> None:
    scene = three_bodies(4.0)
    times = np.linspace(0.1, 4.0, 40)
    reference = solve(Space(scene), times).trajectory
    found = follow(Space(scene), times)
    assert found.pair.tolist() == reference.pair.tolist()
    assert np.abs(found.met - reference.met).max() <= 1e-10
    assert np.abs(found.position - reference.position).max() <= 1e-9  # DOP853's error and that within a step


@pytest.mark.parametrize(
    ("contact", "message"),
    [
        ({"timing": "end-of-step"}, 'contact.timing = "end-of-step" with .*remove contact.timing'),
        ({"allow_overlap": True}, "contact.allow_overlap with .*does not correct overlaps"),
    ],
)
def test_contact_keys_that_it_cannot_follow_are_refused(contact: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Space(three_bodies(1.0, contact=contact))
