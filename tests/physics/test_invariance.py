"""Invariance under units, reflection, translation, rotation, boosts, numbering and reversal of time.

Exact where floating point allows it: powers of two commute with every operation but underflow, a change of sign with
all of them, and a step that is a power of two adds up to an exact clock. Elsewhere to round-off, over runs so short or
so smooth that its growth has a bound: `smooth_documents` never collide, `impact_documents` collide once.
"""

from __future__ import annotations

import math
from itertools import islice
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from carom.lab.hunt.documents import Document
from carom.lab.shrink.whole_run import Image
from carom.physics.space import Space
from carom.state.frame import Frame
from scene_strategies import EPS, directions, documents, impact_documents, scene_from, smooth_documents, vectors
from seeds import examples

FloatArray = NDArray[np.float64]

STEPS = 20
REVERSIBLE = ("leapfrog", "leapfrog-dkd", "yoshida4")
ALL = ("euler", *REVERSIBLE)
rotations = st.tuples(st.integers(-3, 3), st.integers(-3, 3), st.integers(-3, 3), st.integers(1, 3)).map(
    lambda q: np.asarray(Rotation.from_quat(q).as_matrix())
)


def run(document: Document, steps: int = STEPS) -> tuple[Space, list[Frame]]:
    """Run a few steps and keep every frame."""
    space = Space(scene_from(document), threads=1)
    return space, list(islice(space.run(), steps + 1))


def changed(document: Document, **sections: dict[str, Any]) -> Document:
    """Copy a document with keys of its sections replaced."""
    return document | {name: {**document.get(name, {}), **keys} for name, keys in sections.items()}


# ------------------------------------------------------------------------------------------- the same bits


powers = st.integers(-20, 20).map(lambda k: 2.0**k)  # far from underflow: the smallest square is some 10⁻⁵⁰ of a unit


@examples(100)
@given(document=documents(), length=powers, mass=powers, time=powers)
def test_units_that_are_powers_of_two_change_no_bit(
    document: Document, length: float, mass: float, time: float
) -> None:
    # Every quantity has whole powers of m, kg and s, every root is taken of even ones, every threshold is a ratio.
    energy, turn = mass * length**2 / time**2, 1.0 / time
    for a, b in zip(run(document)[1], run(Image(length=length, mass=mass, time=time).of(document))[1], strict=True):
        assert (a.time * time, a.dt * time, a.dt_limit) == (b.time, b.dt, b.dt_limit)
        same(a.position * length, b.position)
        same(a.velocity * (length / time), b.velocity)
        same(a.orientation, b.orientation)
        same(a.angular_velocity, b.angular_velocity, turn)
        same(a.torque, b.torque, energy)
        same(a.angular_acceleration, b.angular_acceleration, turn * turn)
        same(a.contacts.pairs, b.contacts.pairs)
        same(a.contacts.normals, b.contacts.normals)
        same(a.contacts.overlaps * length, b.contacts.overlaps)
        same(a.momentum * (mass * length / time), b.momentum)
        same(a.angular_momentum * (mass * length**2 / time), b.angular_momentum)
        assert (a.sweeps, a.phase) == (b.sweeps, b.phase)
        for term in ("translational", "rotational", "gravitational", "field", "integration_error", "scale"):
            assert getattr(a.energy, term) * energy == getattr(b.energy, term)
        for entry in ("restitution", "friction", "stabilisation"):
            assert getattr(a.energy.ledger, entry) * energy == getattr(b.energy.ledger, entry)


def same(a: NDArray[Any] | None, b: NDArray[Any] | None, factor: float = 1.0) -> None:
    """Hold two arrays, or their absence, equal to the last bit."""
    assert (a is None) == (b is None)
    if a is not None and b is not None:
        assert np.array_equal(a * factor, b)


@examples(100)
@given(document=documents(periodic=False), axis=st.sampled_from([1, 2]))
def test_a_mirror_image_has_the_same_bits(document: Document, axis: int) -> None:
    # A change of sign commutes with every operation: nothing in a step knows left from right. Not mirrored in x, since
    # the normal of coincident centres is +x by decree; not in a box, whose wrap puts a centre on the wall to one side.
    # Velocities are vectors, spins and torques axial: a mirror turns the components along the plane.
    polar = np.ones(3)
    polar[axis] = -1.0
    axial = -polar

    image = Image(matrix=np.diag(polar)).of(document)
    for a, b in zip(run(document)[1], run(image)[1], strict=True):
        assert (a.time, a.dt, a.dt_limit, a.sweeps) == (b.time, b.dt, b.dt_limit, b.sweeps)
        same(a.position * polar, b.position)
        same(a.velocity * polar, b.velocity)
        assert a.energy == b.energy
        same(a.contacts.normals * polar, b.contacts.normals)
        if a.angular_velocity is not None and b.angular_velocity is not None:
            same(a.angular_velocity * axial, b.angular_velocity)
        if a.torque is not None and b.torque is not None:
            same(a.torque * axial, b.torque)
        if a.orientation is not None and b.orientation is not None:
            same(a.orientation * np.append(axial, 1.0), b.orientation)


@examples(100)
@given(document=documents(fixed_step=True), first=st.integers(0, STEPS))
def test_a_run_in_two_parts_is_one_run(document: Document, first: int) -> None:
    # The step is a power of two, so that times are exact, the step that ends at `until` is a whole one, and nothing but
    # its name ("end") tells it apart. At any other time the last step is cut and the steps after it are others.
    dt = document["time"]["fixed_dt"]
    whole, halves = (Space(scene_from(document), threads=1) for _ in range(2))
    one = list(whole.run(until=STEPS * dt))
    two = [*halves.run(until=first * dt), *halves.run(until=STEPS * dt)]
    assert whole.step == halves.step == STEPS and whole.time == halves.time == STEPS * dt
    assert two[first].fingerprint == two[first + 1].fingerprint, "the second part begins where the first ended"
    del two[first]
    assert [frame.fingerprint for frame in one] == [frame.fingerprint for frame in two]
    assert [frame.energy for frame in one] == [frame.energy for frame in two]


@examples(100)
@given(document=impact_documents(), order=st.permutations(range(4)))
def test_isolated_collisions_have_the_same_bits_in_any_order(document: Document, order: list[int]) -> None:
    # Pairs far from each other share nothing, so their order cannot matter as long as i < j within each is kept.
    # (The number of sweeps is that of the slowest pair, which is the same in any order.)
    pairs = len(document["body"]) // 2
    bodies = [2 * pair + k for pair in order if pair < pairs for k in (0, 1)]
    permuted = {**document, "body": [document["body"][k] for k in bodies]}
    (first, frames), (other, _) = run(document, 12), run(permuted, 12)
    assert sum(len(frame.contacts) > 0 for frame in frames) > 0
    for array in ("position", "velocity", "angular_velocity", "orientation"):
        a, b = getattr(first.state, array), getattr(other.state, array)
        same(a[bodies] if len(a) else a, b)


@examples(100)
@given(document=documents(gravity=False, fixed_step=True, periodic=False, most_bodies=8))
def test_a_far_body_that_meets_nobody_changes_no_bit(document: Document) -> None:
    radius = document["body"][0]["radius"]
    far = {"position": [0.0, 0.0, 1e9 * radius], "radius": 1e-3 * radius, "mass": 1.0}
    far["velocity"] = document["body"][0]["velocity"]
    alone, watched = run(document)[0], run({**document, "body": [*document["body"], far]})[0]
    n = len(document["body"])
    for array in ("position", "velocity"):
        same(getattr(alone.state, array), getattr(watched.state, array)[:n])
    if len(alone.state.angular_velocity) and len(watched.state.angular_velocity):
        same(alone.state.angular_velocity, watched.state.angular_velocity[:n])


# ------------------------------------------------------------------------------------------- to round-off


class Tolerance:
    """What round-off may do to a run, in m, m/s and rad.

    Each of N steps rounds positions to EPS X and velocities to EPS V, X and V the largest in either frame of reference
    (a translation or a boost makes them large), a few times; forces are sums of n terms of up to G M/ε². An error grows
    by at most exp(Σ|w| λ t) with the flow of smooth scenes, λ² = 2 G M/ε³: neighbours part by tides, of at most G M/ε³
    for each of the two. Σ|w| is the way that an integrator goes forth and back, 4.4 for Yoshida's.
    """

    def __init__(self, document: Document, *runs: list[Frame]) -> None:
        gravity, time = document["gravity"], document["time"]
        n, steps = len(document["body"]), sum(len(frames) - 1 for frames in runs)
        X = max(float(np.abs(frame.position).max()) for frames in runs for frame in frames)
        V = max(float(np.abs(frame.velocity).max()) for frames in runs for frame in frames)
        M = sum(body["mass"] for body in document["body"])
        epsilon = gravity["softening"]
        rate = math.sqrt(2.0 * gravity["constant"] * M / epsilon**3)
        pull = gravity["constant"] * M / epsilon**2 + float(np.linalg.norm(gravity["uniform"]))
        there_and_back = 4.405 if time["integrator"] == "yoshida4" else 1.0  # 2 × 1.3512 + 1.7024
        substeps = 3 if time["integrator"] == "yoshida4" else 1
        growth = math.exp(2.0 * there_and_back * rate * time["fixed_dt"] * steps)  # twice: x and v feed each other
        roundings = steps * substeps * (n + 10)
        self.position = EPS * roundings * growth * (X + V / rate + pull / rate**2)
        self.velocity = rate * self.position
        # ω itself is constant; sine, cosine and the product of quaternions round to a few EPS a step, and so does θ.
        turn = max((float(np.linalg.norm(body["angular_velocity"])) for body in document["body"]), default=0.0)
        self.angle = EPS * steps * (20.0 + turn * time["fixed_dt"] * steps)


def assert_close(space: Space, position: FloatArray, velocity: FloatArray, tolerance: Tolerance) -> None:
    assert np.abs(space.state.position - position).max() <= tolerance.position
    assert np.abs(space.state.velocity - velocity).max() <= tolerance.velocity


smooth = smooth_documents(steps=STEPS, integrators=ALL)


@examples(100)
@given(document=smooth, shift=vectors)
def test_a_translation_moves_a_smooth_run(document: Document, shift: FloatArray) -> None:
    offset = shift * 1000.0 * document["gravity"]["softening"]
    (here, frames), (there, others) = run(document), run(Image(shift=offset).of(document))
    tolerance = Tolerance(document, frames, others)
    assert_close(there, here.state.position + offset, here.state.velocity, tolerance)
    same(here.state.angular_velocity, there.state.angular_velocity)
    same(here.state.orientation, there.state.orientation)


@examples(100)
@given(document=smooth, R=rotations)
def test_a_rotation_turns_a_smooth_run(document: Document, R: FloatArray) -> None:
    (upright, frames), (turned, others) = run(document), run(Image(matrix=R).of(document))
    tolerance = Tolerance(document, frames, others)
    assert_close(turned, upright.state.position @ R.T, upright.state.velocity @ R.T, tolerance)
    if len(upright.state.orientation):
        # A body starts unturned in either frame of reference, so Q' = R Q Rᵀ.
        Q, turned_Q = (Rotation.from_quat(space.state.orientation).as_matrix() for space in (upright, turned))
        assert np.abs(turned_Q - R @ Q @ R.T).max() <= tolerance.angle


@examples(100)
@given(document=smooth, direction=vectors)
def test_a_boost_changes_nothing_but_the_frame_of_reference_of_a_smooth_run(
    document: Document, direction: FloatArray
) -> None:
    rate = 1.0 / (document["time"]["fixed_dt"] * STEPS)
    boost = direction * 1000.0 * document["gravity"]["softening"] * rate
    (still, frames), (passing, others) = run(document), run(Image(boost=boost).of(document))
    tolerance = Tolerance(document, frames, others)
    assert_close(passing, still.state.position + boost * still.time, still.state.velocity + boost, tolerance)
    same(still.state.orientation, passing.state.orientation)


@examples(100)
@given(document=smooth, data=st.data())
def test_numbering_does_not_matter_to_a_smooth_run(document: Document, data: st.DataObject) -> None:
    # To round-off only: each body sums the pulls of the others in the order of their numbers.
    order = data.draw(st.permutations(range(len(document["body"]))))
    permuted = {**document, "body": [document["body"][k] for k in order]}
    (first, frames), (other, others) = run(document), run(permuted)
    tolerance = Tolerance(document, frames, others)
    assert_close(other, first.state.position[order], first.state.velocity[order], tolerance)


@examples(100)
@given(document=smooth_documents(steps=2 * STEPS, integrators=REVERSIBLE))
def test_a_smooth_run_goes_back_to_where_it_came_from(document: Document) -> None:
    # Leapfrog and Yoshida's are symmetric: a step of -dt undoes a step of dt. Semi-implicit Euler is not.
    space, there = run(document)
    position, velocity = there[0].position, there[0].velocity
    space.state.velocity[:] *= -1.0
    space.state.angular_velocity[:] *= -1.0
    back = list(islice(space.run(), STEPS + 1))
    tolerance = Tolerance(document, there, back)
    assert_close(space, position, -velocity, tolerance)
    if len(space.state.orientation):
        assert np.abs(space.state.orientation - [0.0, 0.0, 0.0, 1.0]).max() <= tolerance.angle


def test_semi_implicit_euler_does_not_go_back() -> None:
    # The test above would notice: v += a dt, x += v dt backwards is x first, v then, and parts at order dt².
    bodies = [{"mass": 1.0, "position": [x, 0.0, 0.0], "angular_velocity": [0.0, 0.0, 0.0]} for x in (0.0, 1.0)]
    gravity = {"constant": 1.0, "softening": 1.0, "uniform": [0.0, 0.0, 0.0]}
    time = {"fixed_dt": 0.01, "integrator": "euler"}
    document = {"body": bodies, "gravity": gravity, "time": time, "contact": {"enabled": False}}
    space, there = run(document)
    space.state.velocity[:] *= -1.0
    back = list(islice(space.run(), STEPS + 1))
    assert np.abs(space.state.position - there[0].position).max() > 1e3 * Tolerance(document, there, back).position


class ImpactTolerance:
    """What round-off may do to pairs that collide once, in m and m/s.

    Before the impact N steps round positions to EPS X and velocities to EPS V. The normal is then wrong by 2 EPS N X
    over the distance of the centres, at least 0.8 of the smallest sum of radii. An impact multiplies the speeds that
    meet, W, by (1 + e) along the normal and by 1 across it, and the surface by 5/2 of that, in some three products
    each: 40 is more than all of them. Afterwards the error of a velocity adds up over N steps.
    """

    def __init__(self, document: Document, *runs: list[Frame]) -> None:
        steps = len(runs[0]) - 1
        X = max(float(np.abs(frame.position).max()) for frames in runs for frame in frames)
        V = max(float(np.abs(frame.velocity).max()) for frames in runs for frame in frames)
        radius = np.array([body["radius"] for body in document["body"]])
        spin = np.array([body["angular_velocity"] for body in document["body"]])
        own = np.array([body["velocity"] for body in document["body"]])
        meeting = float(np.abs(own[1::2] - own[0::2]).max() + (radius[:, None] * np.abs(spin)).max())
        bias = 0.2 / document["time"]["fixed_dt"]  # 1/s, Baumgarte's, of an overlap that is wrong by a rounded position
        position = EPS * (steps + 10) * X
        self.velocity = 40.0 * (EPS * (steps + 10) * V + (meeting / (0.8 * 2 * radius.min()) + bias) * position)
        self.position = position + steps * document["time"]["fixed_dt"] * self.velocity


def assert_close_after_impact(
    space: Space, position: FloatArray, velocity: FloatArray, spin: FloatArray, tolerance: ImpactTolerance
) -> None:
    assert np.abs(space.state.velocity - velocity).max() <= tolerance.velocity
    assert np.abs(space.state.position - position).max() <= tolerance.position
    if len(spin):
        surface = np.abs(space.state.angular_velocity - spin) * space.state.radius[:, None]
        assert surface.max() <= tolerance.velocity


@examples(100)
@given(document=impact_documents(), R=rotations)
def test_a_rotation_turns_an_impact(document: Document, R: FloatArray) -> None:
    (upright, frames), (turned, others) = run(document, 12), run(Image(matrix=R).of(document), 12)
    state, tolerance = upright.state, ImpactTolerance(document, frames, others)
    assert_close_after_impact(
        turned, state.position @ R.T, state.velocity @ R.T, state.angular_velocity @ R.T, tolerance
    )


@examples(100)
@given(document=impact_documents(), shift=vectors, boost=vectors)
def test_a_translation_and_a_boost_change_nothing_in_an_impact(
    document: Document, shift: FloatArray, boost: FloatArray
) -> None:
    shift, boost = 1e4 * shift, 1e3 * boost
    (still, frames), (passing, others) = run(document, 12), run(Image(shift=shift, boost=boost).of(document), 12)
    state, tolerance = still.state, ImpactTolerance(document, frames, others)
    offset = shift + boost * still.time
    assert_close_after_impact(
        passing, state.position + offset, state.velocity + boost, state.angular_velocity, tolerance
    )


@examples(100)
@given(document=impact_documents(), direction=vectors)
def test_a_uniform_field_changes_nothing_but_the_frame_of_reference_of_an_impact(
    document: Document, direction: FloatArray
) -> None:
    # What falls alike meets alike (Galileo): a contact in a field is no more at rest than one without. Euler's fall is
    # not a parabola but g dt Σ k dt; leapfrog's is. A field of W/4 a step is as large as what meets.
    own = np.array([body["velocity"] for body in document["body"]])
    dt = document["time"]["fixed_dt"]
    g = direction * float(np.abs(own[1::2] - own[0::2]).max()) / (4.0 * dt)
    (floating, frames), (falling, others) = (
        run(document, 12),
        run(changed(document, gravity={"uniform": g.tolist()}), 12),
    )
    state, tolerance = floating.state, ImpactTolerance(document, frames, others)
    steps = 12 * 13 if document["time"]["integrator"] == "euler" else 12 * 12
    position, velocity = state.position + 0.5 * g * steps * dt * dt, state.velocity + g * 12 * dt
    assert_close_after_impact(falling, position, velocity, state.angular_velocity, tolerance)


@examples(100)
@given(document=impact_documents(), data=st.data())
def test_numbering_does_not_matter_to_an_impact(document: Document, data: st.DataObject) -> None:
    # To round-off: where i and j change places, 1/m_i + 1/m_j + ρ_i²/I_i + ρ_j²/I_j is added up in another order.
    # Several contacts of one body are another matter: they are resolved in the order of the numbers (physics.md, 9).
    order = data.draw(st.permutations(range(len(document["body"]))))
    permuted = {**document, "body": [document["body"][k] for k in order]}
    (first, frames), (other, others) = run(document, 12), run(permuted, 12)
    state, tolerance = first.state, ImpactTolerance(document, frames, others)
    spin = state.angular_velocity[order] if len(state.angular_velocity) else state.angular_velocity
    assert_close_after_impact(other, state.position[order], state.velocity[order], spin, tolerance)


@examples(100)
@given(
    document=documents(gravity=False, fixed_step=False, periodic=False, velocity_limit="every-body"),
    boost=directions,
    R=rotations,
)
def test_the_first_step_does_not_depend_on_how_the_whole_moves_lies_or_is_numbered(
    document: Document, boost: FloatArray, R: FloatArray
) -> None:
    # Without pulls 1/dt is the largest of 1/max_dt and u_i/(cfl r_i): as wrong as a speed over the smallest radius.
    # Speeds are rounded to EPS V and V is a sum over n bodies.
    V = max(float(np.linalg.norm(body["velocity"])) for body in document["body"]) or 1.0
    boost = 1000.0 * V * boost
    time, n = document["time"], len(document["body"])
    smallest = time["cfl"] * min(body["radius"] for body in document["body"])
    expected = 1.0 / Space(scene_from(document), threads=1).first_dt
    backwards = {**document, "body": document["body"][::-1]}
    for other in (Image(boost=boost).of(document), Image(matrix=R).of(document), backwards):
        tolerance = EPS * ((n + 10) * 1001.0 * V / smallest + 4.0 * expected)
        assert abs(1.0 / Space(scene_from(other), threads=1).first_dt - expected) <= tolerance


@pytest.mark.slow
@pytest.mark.parametrize(
    "integrator", [REVERSIBLE[0], *(pytest.param(name, marks=pytest.mark.slow) for name in REVERSIBLE[1:])]
)
@settings(max_examples=25, deadline=None)
@given(
    document=documents(gravity=False, field=True, fixed_step=False, periodic=False, most_bodies=4),
    part=st.floats(0.05, 0.95),
)
def test_a_run_may_be_cut_anywhere_in_free_fall(document: Document, part: float, integrator: str) -> None:
    # A parabola is followed exactly whatever the steps are, so that a cut step and other steps after it do not show.
    end = 10.0 * document["time"]["max_dt"]
    falling = changed(document, contact={"enabled": False}, time={"integrator": integrator, "smoothing": 1.0})
    whole, halves = (Space(scene_from(falling), threads=1) for _ in range(2))
    *_, last = islice(whole.run(until=end), 2000)
    if last.time < end:
        return  # thousands of steps: rounding alone would be compared
    for until in (part * end, end):
        for _ in halves.run(until=until):
            pass
    assert halves.time == end
    g = float(np.linalg.norm(document["gravity"]["uniform"]))
    V = max(float(np.abs(space.state.velocity).max()) for space in (whole, halves)) + g * end
    X = max(float(np.abs(body["position"]).max()) for body in map(_as_arrays, document["body"])) + V * end
    roundings = EPS * 10 * (whole.step + halves.step)
    assert np.abs(whole.state.velocity - halves.state.velocity).max() <= roundings * V
    assert np.abs(whole.state.position - halves.state.position).max() <= roundings * X


def _as_arrays(body: Document) -> dict[str, FloatArray]:
    return {"position": np.array(body["position"])}
