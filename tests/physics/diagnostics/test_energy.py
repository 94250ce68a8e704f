"""The energy scale, the checks of the energy, and what they warn of."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from carom.event import Event
from carom.physics.diagnostics.energy import EnergyAccount
from carom.physics.diagnostics.energy_monitor import MOST_WARNINGS, EnergyMonitor
from carom.physics.diagnostics.extremes import add_energy
from carom.physics.diagnostics.momentum import TotalMotion
from carom.physics.space import Space
from carom.runs.outcome import judge
from carom.scene.integrators import INTEGRATORS
from carom.scene.schema import Expect
from carom.scene.wording import Names
from carom.state.books import Extremes
from carom.state.energies import Energy, Ledger
from small_scenes import pair, random_bodies, scene_of

SPARSE = {"every": 1e9, "check_every": 1_000_000}  # one frame at the start, one at the end


def binary(eccentricity: float, **sections: Any) -> Space:
    """Two points of half a kilogram on an orbit of semi-major axis 1 m from apocentre, G = 1: a period takes 2 π s."""
    speed = 0.5 * math.sqrt((1 - eccentricity) / (1 + eccentricity))
    half = {"mass": 0.5, "radius": 1e-9}
    bodies = [
        {**half, "position": [side * 0.5 * (1 + eccentricity), 0, 0], "velocity": [0, side * speed, 0]}
        for side in (1, -1)
    ]
    sections = {"gravity": {"constant": 1.0}, "contact": {"enabled": False}} | sections
    return Space(scene_of(bodies, **sections))


def balls_at_rest(**sections: Any) -> Space:
    """Two balls of a kilogram that lie on a plane, each by itself, for a hundred steps."""
    bodies: list[dict[str, Any]] = [{"mass": 1.0, "position": [x, 0, 1.0]} for x in (0.0, 5.0)]
    sections = {"gravity": {"constant": 0.0, "uniform": [0, 0, -9.81]}, "plane": [{"normal": [0, 0, 1]}]} | sections
    return Space(scene_of(bodies, **({"time": {"duration": 1.0, "fixed_dt": 0.01}} | sections)))


def run(space: Space) -> list[Event]:
    return [event for frame in space.run() for event in frame.events]


def kinds(events: list[Event]) -> list[str]:
    return [event.kind for event in events if event.level == "WARN"]


def test_the_scale_of_an_orbit_is_its_total_energy_wherever_it_begins_and_however_eccentric() -> None:
    time = {"duration": 1.0, "fixed_dt": 0.01}
    for eccentricity in (0.0, 0.9, 0.9999):
        # G m m' / (2 a) = 0.125 J; at e = 0.9999 rounding of the velocity weighs most
        assert binary(eccentricity, time=time).energy().scale == pytest.approx(0.125, rel=1e-12)
    moving = binary(0.9, time=time)
    moving.state.velocity[:] += [1e3, 0, 0]
    account = EnergyAccount(moving.state, np.zeros(3))
    # 10⁶ m²/s² rounds to 10⁻¹⁰, of which the speed about the centre of mass is what is left
    pull = {"gravitational": moving.energy().gravitational}
    assert account.balance(TotalMotion.of(moving.state), pull, Ledger()).scale == pytest.approx(0.125, abs=1e-9)


def test_an_orbit_that_loses_its_energy_misses_its_promise_and_is_said_to_be_lost() -> None:
    # A step of 0.01 s jumps over the pericentre, 10⁻⁴ m, which takes the bodies 10⁻⁶ s.
    space = binary(0.9999, time={"duration": 2 * math.pi, "fixed_dt": 0.01}, record=SPARSE)
    events = run(space)
    energy = space.energy()
    assert energy.relative_error == pytest.approx(abs(energy.total + 0.125) / 0.125, rel=1e-12)
    assert energy.relative_error > 0.5
    assert "energy-lost" in kinds(events)
    lost = next(event for event in events if event.kind == "energy-lost")
    assert lost.text.startswith("An orbit is lost")
    expect = Expect(energy_error=1e-4, warned=("energy-lost",))
    promise, warned = judge(space.scene.model_copy(update={"expect": expect}), space.extremes, space.time)
    assert not promise.met and warned.met


def test_balls_at_rest_on_a_plane_have_the_scale_of_lifting_them_by_their_radius() -> None:
    space = balls_at_rest()
    events = run(space)
    energy = space.energy()
    assert energy.scale == pytest.approx(2 * 9.81, rel=1e-12)
    # 19.62 J in the field are rounded to 4 × 10⁻¹⁵ J in each of a hundred steps
    assert space.extremes.energy_error is not None and space.extremes.energy_error.value <= 1e-13
    assert not kinds(events)


def test_a_ball_thrown_up_and_a_ball_dropped_have_the_scale_of_what_the_field_exchanges() -> None:
    field = {"constant": 0.0, "uniform": [0, 0, -10.0]}
    for speed, seconds, exchanged in ((20.0, 2.0, 200.0), (0.0, 2.0, 200.0)):
        ball = {"mass": 1.0, "radius": 0.01, "velocity": [0, 0, speed]}
        space = Space(scene_of([ball], gravity=field, time={"duration": seconds, "fixed_dt": 0.01}))
        run(space)
        assert space.energy().scale == pytest.approx(exchanged, rel=1e-12)


def test_a_spin_that_nothing_changes_does_not_hide_an_orbit() -> None:
    space = binary(0.5, time={"duration": 1.0, "fixed_dt": 0.01})
    spinning = replace_spin(space, 1e9)
    # the spins hold 2 × ½ × 0.4 × 0.5 × 10⁻¹⁸ × 10¹⁸ = 0.2 J, more than the orbit
    assert spinning.energy().rotational == pytest.approx(0.2) and spinning.energy().scale == pytest.approx(0.125)


def replace_spin(space: Space, spin: float) -> Space:
    bodies = [body.model_copy(update={"angular_velocity": (0.0, 0.0, spin)}) for body in space.scene.body]
    return Space(space.scene.model_copy(update={"body": tuple(bodies)}))


def test_the_energy_of_fixed_bodies_among_each_other_does_not_hide_an_orbit() -> None:
    heavy: dict[str, Any] = {"mass": 1e3, "radius": 0.1, "fixed": True}
    orbiter: dict[str, Any] = {"mass": 1e-3, "radius": 0.01, "position": [10.0, 0, 0], "velocity": [0, 10.0, 0]}
    bodies = [heavy, {**heavy, "position": [0.0, 0, 1.0]}, orbiter]
    energy = Space(scene_of(bodies, gravity={"constant": 1.0}, time={"duration": 1.0})).energy()
    assert energy.gravitational < -1e6
    # ½ m v² = 0.05 J, less 0.1 J from the near one and 0.1 / √1.01 J from the other
    assert energy.scale == pytest.approx(abs(0.05 - 0.1 - 0.1 / math.sqrt(1.01)), rel=1e-9)


def test_the_rounding_of_a_heavy_body_is_no_error_of_a_light_one_that_hits_it_and_a_larger_change_is() -> None:
    # m/M = 10⁻¹²: what the bodies exchange is 10⁻¹² of the energy, and the energy of M at 0.7 m/s rounds to 10⁻¹⁶
    heavy = {"mass": 1e12, "radius": 0.5, "velocity": [0.7, 0.0, 0.0]}
    light: dict[str, Any] = {"mass": 1.0, "radius": 0.5, "position": [2.0, 0.0, 0.0]}
    elastic = {"restitution": 1.0, "static_friction": 0.0}
    space = Space(
        scene_of([heavy, light], time={"duration": 4.0}, contact=elastic, gravity={"constant": 0.0}, record=SPARSE)
    )
    assert not kinds(run(space))
    assert space.state.velocity[:, 0] == pytest.approx([0.7, 1.4], rel=1e-11)
    extremes, energy = space.extremes, space.energy()
    assert extremes.impacts == 1 and abs(energy.integration_error) > 1e-5 * energy.scale  # of rounding
    assert extremes.energy_error is not None and extremes.energy_error.value == 0.0
    assert extremes.energy_gain.value == extremes.contact_gain.value == 0.0
    # half of the energy of the light body at 1.4 m/s
    space.state.velocity[1] *= math.sqrt(0.5)
    assert space.energy().relative_error == pytest.approx(2.0, rel=0.01)  # of ½ m 0.7²


def test_energies_that_nothing_changes_hide_no_error_however_many_steps_round_the_others() -> None:
    spinning = replace_spin(binary(0.5, time={"duration": 1.0, "fixed_dt": 0.01}), 1e13)  # 2 × 10⁷ J, and 0.125 J
    account = EnergyAccount(spinning.state, np.zeros(3))
    motion, pull = TotalMotion.of(spinning.state), {"gravitational": spinning.energy().gravitational}
    account.balance(motion, pull, Ledger())
    wrong = {"gravitational": pull["gravitational"] + 1e-6}
    later = account.balance(motion, wrong, Ledger(), roundings=10**8)
    assert later.scale == pytest.approx(0.125) and later.relative_error == pytest.approx(8e-6, rel=0.01)
    assert account.balance(motion, {"gravitational": pull["gravitational"] + 1e-9}, Ledger()).relative_error == 0.0


def test_on_a_parabola_the_scale_is_that_of_its_two_terms() -> None:
    bodies: list[dict[str, Any]] = [
        {"mass": 0.5, "radius": 1e-3, "position": [side, 0, 0], "velocity": [0, side * 0.5, 0]} for side in (1, -1)
    ]
    space = Space(scene_of(bodies, gravity={"constant": 2.0}, time={"duration": 1.0}))
    # kinetic 2 × ½ × 0.5 × 0.25 = 0.125 J, gravitational -2 × 0.25 / 2 = -0.25 J; on a parabola both are 0.25 J
    assert space.energy().scale == pytest.approx(0.125)
    fast = [{**body, "velocity": [0.0, float(np.sqrt(2.0)) * body["velocity"][1], 0.0]} for body in bodies]
    assert Space(scene_of(fast, gravity={"constant": 2.0}, time={"duration": 1.0})).energy().scale == pytest.approx(0.5)


def test_the_energy_scale_of_a_collapse_contains_what_contacts_took_out() -> None:
    bodies = random_bodies(5, seed=1)
    account = EnergyAccount(bodies, np.zeros(3))
    pull = {"gravitational": -1e3}
    start = account.balance(TotalMotion.of(bodies), pull, Ledger())
    later = account.balance(TotalMotion.of(bodies), pull, Ledger(restitution=2e3, friction=1e3))
    assert later.scale == pytest.approx(start.scale + 3e3)
    # energy from contacts, which would be an error, does not make other errors look smaller
    assert EnergyAccount(bodies, np.zeros(3)).balance(TotalMotion.of(bodies), pull, Ledger(-5e3)).scale == start.scale


def test_a_short_run_is_checked_at_its_end() -> None:
    # Two spheres overlap at rest, and Baumgarte's bias throws them apart.
    scene = pair(
        0.0,
        contact={"stabilisation": "baumgarte", "allow_overlap": True, "timing": "end-of-step"},
        time={"duration": 0.05, "fixed_dt": 0.01},
        record=SPARSE,
    )
    overlapping = [
        body.model_copy(update={"position": (side * 0.9, 0.0, 0.0)})
        for side, body in zip((-1, 1), scene.body, strict=True)
    ]
    space = Space(scene.model_copy(update={"body": tuple(overlapping)}))
    space.check_interval = math.inf
    events = run(space)
    assert space.step == 5
    assert kinds(events) == ["energy-rise"]
    assert events[-1].step == 5 and "Collisions in step" in events[-1].text


def test_a_run_that_is_stopped_is_checked_where_it_stops() -> None:
    space = binary(0.9999, time={"duration": 2 * math.pi, "fixed_dt": 0.01}, record=SPARSE)

    def stop_past_the_pericentre(step: int, before: float, time: float) -> bool:
        if time > 4.0:
            space.stop()
        return False

    _, stopped = space.run(schedule=stop_past_the_pericentre)
    assert stopped.time < 4.1 and "energy-lost" in kinds(list(stopped.events))


def energies(*totals: float) -> list[Energy]:
    """Energies of a run of scale 1 J whose integrator makes up all of the change."""
    return [Energy(total, 0.0, 0.0, 0.0, Ledger(), total - totals[0], 1.0) for total in totals]


def watched(tolerance: float, *found: Energy, contact_gain: float = 0.0, integrator: str = "leapfrog") -> list[Event]:
    watch = EnergyMonitor(tolerance, Names(["a", "b"], []), INTEGRATORS[integrator])
    return [event for k, energy in enumerate(found) for event in watch.check(k, 0.5 * k, energy, contact_gain, list)]


def test_a_slow_rise_is_warned_of_however_often_it_is_checked() -> None:
    slow = watched(1e-3, *energies(*np.linspace(1.0, 1.01, 101)))  # 10⁻⁴ a check
    assert kinds(slow) == ["energy-rise"] * 9  # at every eleventh check 1.1 × 10⁻³ above the warning before
    assert "J from the integrator. Mostly the integrator." in slow[0].text and "stabilisation" not in slow[0].text
    assert "since t = 0 s" in slow[0].text and "since t = 5.5 s" in slow[1].text


def test_a_rise_counts_from_the_lowest_energy() -> None:
    events = watched(0.1, *energies(1.0, 0.5, 0.55, 0.65))
    assert [event.step for event in events if event.kind == "energy-rise"] == [3]


def test_the_watch_falls_silent_after_so_many_rises() -> None:
    events = watched(1e-3, *energies(*(1.0 + 0.01 * np.arange(MOST_WARNINGS + 50))))
    rises = [event for event in events if event.kind == "energy-rise"]
    assert len(rises) == MOST_WARNINGS and "further ones are not logged" in rises[-1].text


def test_an_integration_error_of_a_tenth_of_the_scale_is_warned_of_once() -> None:
    events = watched(1e9, *energies(-1.0, -0.95, -0.89, -0.5, -0.2))
    assert kinds(events) == ["energy-lost"] and events[0].step == 2
    assert "11% of the energy scale" in events[0].text


@pytest.mark.parametrize(
    ("integrator", "advice"),
    [
        ("leapfrog", 'fixed_dt), or time.integrator = "yoshida4".'),
        ("yoshida4", "(time.target_dx, time.cfl or time.fixed_dt)."),
        ("gauss-radau15", "Without time.fixed_dt the integrator chooses its steps by their error"),
        ("wisdom-holman", 'time.integrator = "gauss-radau15"'),
    ],
)
def test_the_advice_against_a_lost_orbit_fits_the_integrator(integrator: str, advice: str) -> None:
    (lost,) = watched(1e9, *energies(-1.0, -0.5), integrator=integrator)
    assert advice in lost.text and f'"{integrator}"' not in lost.text


def see(extremes: Extremes, *ledgers: Ledger) -> Extremes:
    """Show extremes a run in which contacts alone change the energy of 1 J."""
    for step, ledger in enumerate(ledgers):
        add_energy(extremes, step, float(step), Energy(1.0 - ledger.balance, 0.0, 0.0, 0.0, ledger, 0.0, 1.0))
    return extremes


@pytest.mark.parametrize(
    "ledgers",
    [
        [Ledger(), Ledger(restitution=-0.02)],
        [Ledger(), Ledger(friction=-0.02, restitution=0.5)],
        [Ledger(), Ledger(restitution=0.5), Ledger(restitution=0.48)],
    ],
    ids=["restitution", "friction", "given-back"],
)
def test_energy_that_contacts_put_in_misses_the_promise_of_an_energy_error(ledgers: list[Ledger]) -> None:
    extremes = see(Extremes(), *ledgers)
    assert extremes.contact_gain.value == pytest.approx(0.02) and extremes.energy_error is not None
    assert extremes.energy_error.value == 0.0
    (verdict,) = judge(pair(expect={"energy_error": 0.01}), extremes, 10.0)
    assert not verdict.met
    assert str(verdict) == "energy_error: 0.02, added by contact impulses (at most 0.01; missed)"


def test_energy_that_contacts_put_in_is_warned_of_once() -> None:
    energy = Energy(1.0, 0.0, 0.0, 0.0, Ledger(restitution=-0.5), 0.0, 1.0)
    events = watched(1e-3, energy, energy, contact_gain=0.5)
    assert kinds(events) == ["energy-ledger"]
    assert "restitution has removed -0.5 J" in events[0].text


def test_the_watch_goes_on_after_a_checkpoint_as_if_the_run_had_not_stopped() -> None:
    space = binary(0.9999, time={"duration": 2 * math.pi, "fixed_dt": 0.01})
    whole, checkpoint = [], None
    for frame in space.run():
        whole += [event for event in frame.events if event.step > 320]
        checkpoint = frame.checkpoint if frame.step == 320 else checkpoint
    assert checkpoint is not None
    again = Space(space.scene)
    again.restore(checkpoint)
    assert run(again) == whole
    assert replace(again.extremes) == replace(space.extremes)


def test_an_energy_and_its_ledger_hash_as_what_they_hold() -> None:
    first, same, other = (
        Energy(1.0, 0.0, 0.0, 0.0, Ledger().plus_loss("drag", loss), 0.0, 1.0, (("spring", 2.0),))
        for loss in (1.0, 1.0, 3.0)
    )
    assert hash(first) == hash(same) and len({first, same, other}) == 2
    assert first.ledger.entry("drag") == 1.0 and first.term("spring") == 2.0
