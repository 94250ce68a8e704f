"""Any valid scene: no exception, nothing that is not a number, momentum and the ledger to round-off.

What round-off may do is counted: `EPS` times the arithmetic operations so far times the size of what was added up,
which includes impulses that cancel within a step, such as a pile's weight and what holds it.
"""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from carom.lab.hunt.documents import Document
from carom.physics.contact.solver.contact_solver import MOST_SWEEPS
from carom.physics.space import Space
from carom.scene.load import Scene
from carom.state.frame import Frame
from scene_strategies import EPS, documents, scene_from

FloatArray = NDArray[np.float64]

STEPS = 30
# Roundings that a body's velocity or position, or a sum over bodies, sees in one substep, and in one visit of a
# contact. Counted by reading the kernels, generously: they set the scale of a bound, not the bound.
PER_SUBSTEP, PER_VISIT = 10, 30


class Auditor:
    """Follows a run and holds every frame to the laws."""

    def __init__(self, scene: Scene) -> None:
        self.space = Space(scene, threads=1)
        state = self.space.state
        self.mass, self.inertia = state.mass, state.inertia
        self.field = np.array(scene.gravity.uniform)
        self.g = float(np.linalg.norm(self.field))
        self.weight = self.mass.sum() * self.field
        self.pulls = self.space.requirements.gravity.modelled
        self.roundings, self.impacts = 0.0, 0  # so far
        self.linear_scale = self.angular_scale = self.energy_scale = 0.0
        self.linear, self.angular, self.euler_loss = np.zeros(3), np.zeros(3), 0.0
        self.force = np.zeros(len(self.mass))  # N, Σ |F| on each body in the frame before
        self.before: Frame | None = None

    def run(self) -> None:
        for frame in islice(self.space.run(), STEPS + 1):
            self._finite(frame)
            self._well_formed(frame)
            self._count(frame)
            self._conserved(frame)
            if not self.pulls:
                self._ledger_closes(frame)
                self._contacts_create_nothing(frame)
            self.before = frame

    def _finite(self, frame: Frame) -> None:
        state, energy = self.space.state, frame.energy
        arrays = (state.position, state.velocity, state.acceleration, state.orientation, state.angular_velocity)
        everything = [array.ravel() for array in (*arrays, state.torque, state.angular_acceleration)]
        assert np.isfinite(np.concatenate(everything)).all()
        assert np.isfinite([energy.total, energy.ledger.balance, energy.integration_error, energy.scale]).all()

    def _well_formed(self, frame: Frame) -> None:
        """Unit quaternions, unit normals, pairs in order, overlaps that are overlaps."""
        orientation, contacts = self.space.state.orientation, frame.contacts
        assert np.abs((orientation**2).sum(axis=1) - 1.0).max(initial=0.0) <= 8 * EPS
        if len(contacts) == 0:
            return
        assert np.abs((contacts.normals**2).sum(axis=1) - 1.0).max() <= 8 * EPS
        i, j = contacts.pairs.T
        assert (i < j).all()
        assert (np.diff(i * len(self.mass) + j) > 0).all()
        reach = self.space.state.radius[i] + self.space.state.radius[j]
        assert (contacts.overlaps >= -4 * EPS * reach).all() and (contacts.overlaps <= reach).all()

    def _count(self, frame: Frame) -> None:
        """Add up what may have been rounded since the frame before, and how large it was."""
        scene, state = self.space.scene, self.space.state
        substeps = 3 if scene.time.integrator == "yoshida4" else 1
        asked = scene.contact.sweeps
        most = asked if isinstance(asked, int) else MOST_SWEEPS[asked]
        passes = frame.sweeps + (most if scene.contact.stabilisation == "split" else 0)
        struck = self.space.extremes.impacts - self.impacts
        self.impacts += struck
        visits = passes * len(frame.contacts) + struck
        self.roundings += substeps * (len(self.mass) + PER_SUBSTEP) + PER_VISIT * visits
        speed, reach, turning = _lengths(state.velocity), _lengths(state.position), _lengths(state.angular_velocity)
        spin = float(self.inertia[: len(turning)] @ turning)
        now = self.forces() + self.mass * self.g
        force, self.force = np.maximum(self.force, now), now  # a kick is by those at its step's start or end
        force_time = frame.dt if frame.step else 0.0
        fall = float(self.mass.sum()) * self.g * frame.time
        self.linear_scale = max(self.linear_scale, float(self.mass @ speed + force.sum() * force_time + fall))
        moment = float(self.mass * speed @ reach + force @ reach * force_time + fall * reach.max())
        self.angular_scale = max(self.angular_scale, moment + spin)
        energy = frame.energy
        height = float(self.mass @ reach) * self.g
        traffic = abs(energy.ledger.restitution) + abs(energy.ledger.friction) + abs(energy.ledger.stabilisation)
        self.energy_scale = max(self.energy_scale, energy.translational + energy.rotational + height + traffic)

    def forces(self) -> FloatArray:
        """Return Σ_j |F_ij| on each body: what cancels in a sum of forces is rounded all the same."""
        if not self.pulls:
            return np.zeros(len(self.mass))
        gravity, x = self.space.scene.gravity, self.space.state.position
        separation = x[None, :, :] - x[:, None, :]
        r2 = np.einsum("ijk,ijk->ij", separation, separation)
        with np.errstate(divide="ignore", invalid="ignore"):
            pull = np.sqrt(r2) / (r2 + gravity.softening**2) ** 1.5
        pull[r2 == 0.0] = 0.0
        return np.asarray(gravity.constant * self.mass * (pull @ self.mass))

    def _conserved(self, frame: Frame) -> None:
        """Momentum is constant; in a uniform field it follows the weight, and L the weight's moment.

        The centre of mass falls on a parabola whatever the bodies do, so that its moment has a closed form
        (physics.md, 12). Semi-implicit Euler kicks before it drifts: over a step, the weight acts where the centre was.
        """
        state, dt = self.space.state, frame.dt
        linear = self.mass @ state.velocity
        spin = self.inertia[: len(state.angular_velocity)] @ state.angular_velocity
        angular = _moment(self.mass[:, None] * state.position, state.velocity) + spin
        if self.before is None:
            self.linear, self.angular = linear, angular
        else:
            centre_before = self.mass @ self.before.position / self.mass.sum()
            centre = centre_before
            if self.space.scene.time.integrator != "euler":  # the mean over a parabola, V at the start of the step
                V = self.mass @ self.before.velocity / self.mass.sum()
                centre = centre_before + 0.5 * V * dt
            self.linear = self.linear + self.weight * dt
            self.angular = self.angular + _moment(centre[None, :], self.weight[None, :] * dt)
        tolerance = EPS * self.roundings
        assert np.abs(linear - self.linear).max() <= tolerance * self.linear_scale
        if self.space.box is None:
            assert np.abs(angular - self.angular).max() <= tolerance * self.angular_scale

    def _ledger_closes(self, frame: Frame) -> None:
        """Without self-gravity every integrator follows free flight exactly, and the ledger all that contacts do.

        But for semi-implicit Euler in a uniform field, which loses ½ M g² dt² in each step, whatever the velocities.
        """
        if self.space.scene.time.integrator == "euler":
            self.euler_loss += 0.5 * float(self.weight @ self.field) * frame.dt**2
        error = frame.energy.integration_error + self.euler_loss
        assert abs(error) <= EPS * self.roundings * (self.energy_scale + self.euler_loss)

    def _contacts_create_nothing(self, frame: Frame) -> None:
        """Restitution and friction only take; so do the pushes, since only pulls could give them something."""
        if self.before is None:
            return
        rounding = EPS * self.roundings * self.energy_scale
        ledger, before = frame.energy.ledger, self.before.energy.ledger
        assert ledger.restitution >= before.restitution - rounding
        assert ledger.friction >= before.friction - rounding
        stabilisation = self.space.scene.contact.stabilisation
        if stabilisation == "none":
            assert ledger.stabilisation == 0.0
        elif stabilisation == "split":
            assert ledger.stabilisation <= before.stabilisation + rounding
        else:
            assert ledger.stabilisation >= before.stabilisation - rounding
        if stabilisation != "baumgarte" and not self.field.any():
            energy, earlier = frame.energy, self.before.energy
            kinetic = energy.translational + energy.rotational
            assert kinetic <= earlier.translational + earlier.rotational + rounding


def _lengths(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=1)))


def _moment(arms: FloatArray, vectors: FloatArray) -> FloatArray:
    """Σ arm × vector, (3,); NumPy's cross product takes ten times as long on a few rows."""
    t = arms.T @ vectors
    return np.array([t[1, 2] - t[2, 1], t[2, 0] - t[0, 2], t[0, 1] - t[1, 0]])


# Six times 50 and not 300 at once: Hypothesis varies what it drew before, and may do without one of these for long.
@pytest.mark.parametrize("stabilisation", ["split", "baumgarte", "none"])
@pytest.mark.parametrize("gravity", [False, True])
@settings(max_examples=50, deadline=None)
@given(data=st.data())
def test_any_scene_obeys_the_laws(data: st.DataObject, gravity: bool, stabilisation: str) -> None:
    Auditor(scene_from(data.draw(documents(gravity=gravity, stabilisation=stabilisation)))).run()


def test_the_bound_on_rounding_counts_the_forces_that_kick_a_first_step_of_euler() -> None:
    """Two bodies that touch pull each other by 18 kN, which is over at the end of a step of a second."""
    x, y, r = -0.04162277660168379, -1.0316227766016839, 0.03162277660168379
    line = [(0.0, 1.0), (-1.1, 0.1), (-2.2, 1.0), (-3.7623413251903495, 0.5623413251903491)]
    line += [(-5.324682650380699 - 2.0 * k, 1.0) for k in range(6)]
    bodies = [((at, 0.0, 0.0), radius, 1.0) for at, radius in line]
    bodies.insert(1, ((0.0, y, 0.0), r, 3.1622776601683795))
    bodies.insert(4, ((x, y, 0.0), 0.01, 10.0))
    document: Document = {
        "body": [{"position": list(at), "radius": radius, "mass": mass} for at, radius, mass in bodies],
        "time": {"integrator": "euler", "fixed_dt": 1.0, "max_dt": 1.0, "duration": 1e9},
        "gravity": {"constant": 1.0, "softening": 0.0},
        "contact": {"static_friction": 0.0, "kinetic_friction": 0.0, "restitution": 0.0},
        "record": {"every": "step", "check_every": 1},
    }
    Auditor(scene_from(document)).run()


@pytest.mark.nightly
@pytest.mark.slow
@settings(max_examples=1_000, deadline=None, suppress_health_check=list(HealthCheck))
@given(documents())
def test_a_thousand_scenes_obey_the_laws(document: Document) -> None:
    Auditor(scene_from(document)).run()


RUNS_AWAY = "the bias, 0.2 overlap/dt, and the adaptive step, cfl r/v, feed each other: 0.01 J become 10⁶ J"


@pytest.mark.parametrize(
    "timing",
    ["auto", pytest.param("end-of-step", marks=pytest.mark.xfail(strict=True, reason=RUNS_AWAY))],
)
def test_baumgarte_and_the_adaptive_step_do_not_run_away(timing: str) -> None:
    # Two giants at 0.1 m/s squeeze a pebble. It takes all of the bias, v = 0.2 overlap/dt, so that the next dt is
    # cfl r/v = 5 cfl r/overlap of this one: it falls, and the bias rises, as soon as the overlap passes 5 cfl r, which
    # at cfl = 0.05 is a quarter of the pebble's radius. Thrown to and fro, it cannot leave before v is 10⁵ m/s. With
    # times of impact the pebble is held, and does not overlap.
    giants = [{"mass": 1.0, "position": [1.03 * s, 0.0, 0.0], "velocity": [-0.1 * s, 0.0, 0.0]} for s in (-1.0, 1.0)]
    document = {
        "body": [*giants, {"mass": 1e-4, "radius": 0.03}],
        "gravity": {"constant": 0.0},
        "contact": {"stabilisation": "baumgarte", "restitution": 0.0, "timing": timing},
        "time": {"duration": 3.0, "cfl": 0.05},
    }
    space = Space(scene_from(document), threads=1)
    for step in range(1000):
        space.compute_dynamics(step)
    # Baumgarte creates energy and may; but a squeezed pebble is no engine: a hundred times what the giants began with.
    assert space.energy().translational <= 100 * 0.01  # J
