"""A periodic box under Lees–Edwards shear, held against impacts that NumPy finds image by image.

Runs with impacts are slow, since their kernels compile for a minute.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.physics.space import Space
from carom.recording.export.extended_xyz import write_extended_xyz
from carom.runs.recomputed import snapshots
from carom.scene.load import Scene
from carom.state.frame import Frame
from small_scenes import scene_of

SIZE = np.array([5.0, 4.0, 6.0])  # m
RATE = 0.8  # 1/s
RADIUS, E = 0.75, 0.9
SMOOTH = {"restitution": E, "static_friction": 0.0, "kinetic_friction": 0.0}
AXES = [(0, 1), (1, 2), (2, 0), (1, 0)]  # flow, gradient


def sheared(flow: int = 0, gradient: int = 1, rate: float = RATE, size: FloatArray = SIZE) -> dict[str, Any]:
    shear = {"rate": rate, "flow": "xyz"[flow], "gradient": "xyz"[gradient]}
    return {"gravity": {"constant": 0.0}, "domain": {"boundary": "periodic", "size": size.tolist(), "shear": shear}}


def last_frame(bodies: list[dict[str, Any]], threads: int | None = None, **sections: Any) -> Frame:
    *_, last = Space(scene_of(bodies, **sections), threads).run()
    return last


def bodies_at(position: FloatArray, velocity: FloatArray) -> list[dict[str, Any]]:
    masses = np.linspace(1.0, 4.0, len(position))
    rows = zip(position.tolist(), velocity.tolist(), masses.tolist(), strict=True)
    return [{"position": x, "velocity": v, "radius": RADIUS, "mass": m} for x, v, m in rows]


def in_box(
    x: FloatArray, v: FloatArray, time: float, flow: int, gradient: int, rate: float = RATE, size: FloatArray = SIZE
) -> tuple[FloatArray, FloatArray]:
    """Return the images inside the box of bodies that were followed through all its faces, as Lees & Edwards do."""
    x, v = x.copy(), v.copy()
    k = np.floor(x[:, gradient] / size[gradient] + 0.5)
    x[:, gradient] -= k * size[gradient]
    x[:, flow] -= k * rate * size[gradient] * time
    v[:, flow] -= k * rate * size[gradient]
    return x - size * np.floor(x / size + 0.5), v


def assert_same_places(x: FloatArray, y: FloatArray, tolerance: float, size: FloatArray = SIZE) -> None:
    """Compare positions in a box; a body on a face may be on either."""
    apart = x - y
    np.testing.assert_allclose(apart - size * np.round(apart / size), 0.0, atol=tolerance)


def first_impact(
    x: FloatArray, v: FloatArray, now: float, flow: int, gradient: int
) -> tuple[float, int, int, FloatArray, FloatArray]:
    """Return time, pair, and separation and relative velocity of the next impact among all images, by quadratics."""
    best = (np.inf, 0, 0, np.zeros(3), np.zeros(3))
    near = np.array(list(product((-2, -1, 0, 1, 2), repeat=3)))
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            k = near[:, gradient] - np.round((x[j, gradient] - x[i, gradient]) / SIZE[gradient])
            d, u = np.tile(x[j] - x[i], (len(k), 1)), np.tile(v[j] - v[i], (len(k), 1))
            d[:, flow] += k * RATE * SIZE[gradient] * now
            u[:, flow] += k * RATE * SIZE[gradient]
            d += (near - np.round(d / SIZE)) * SIZE
            b, c = (d * u).sum(axis=1), (d * d).sum(axis=1) - 4 * RADIUS**2
            with np.errstate(invalid="ignore", divide="ignore"):
                tau = np.where(b < 0.0, c / (-b + np.sqrt(b * b - (u * u).sum(axis=1) * c)), np.inf)
            m = int(np.nanargmin(tau))
            if tau[m] < best[0]:
                best = (float(tau[m]), i, j, d[m] + u[m] * tau[m], u[m])
    return best


def by_quadratics(
    x: FloatArray, v: FloatArray, mass: FloatArray, end: float, flow: int, gradient: int
) -> tuple[FloatArray, FloatArray, int]:
    """Follow smooth spheres through all impacts and all faces of the box; return how many impacts there were."""
    now, impacts = 0.0, 0
    x, v = x.copy(), v.copy()
    while True:
        tau, i, j, d, u = first_impact(x, v, now, flow, gradient)
        if now + tau >= end:
            return x + v * (end - now), v, impacts
        x, now, impacts = x + v * tau, now + tau, impacts + 1
        n = d / np.linalg.norm(d)
        impulse = -(1.0 + E) * (u @ n) / (1.0 / mass[i] + 1.0 / mass[j]) * n
        v[i], v[j] = v[i] - impulse / mass[i], v[j] + impulse / mass[j]


def gas(flow: int = 0, gradient: int = 1) -> tuple[FloatArray, FloatArray]:
    """Return seven spheres on a grid, with the velocity of the flow and random ones."""
    rng = np.random.default_rng(7)
    x = np.array([[-1.2, -0.9, -1.5], [1.2, 0.9, 1.5], [1.2, -0.9, 0.1], [-1.2, 0.9, 0.2]])
    x = np.concatenate([x, [[0.1, 0.1, -2.4], [-0.2, 1.9, 2.4], [2.4, -1.8, -2.6]]])
    v = 1.5 * rng.standard_normal(x.shape)
    v[:, flow] += RATE * x[:, gradient]
    return x, v


@pytest.mark.slow
@pytest.mark.parametrize(("flow", "gradient"), AXES)
def test_spheres_meet_the_images_that_quadratics_find_for_every_pair_of_axes(flow: int, gradient: int) -> None:
    x, v = gas(flow, gradient)
    end = 6.0
    mass = np.linspace(1.0, 4.0, len(x))
    unwrapped, after, impacts = by_quadratics(x, v, mass, end, flow, gradient)
    assert impacts > 9
    last = last_frame(bodies_at(x, v), contact=SMOOTH, time={"duration": end}, **sheared(flow, gradient))
    place, velocity = in_box(unwrapped, after, end, flow, gradient)
    # each impact multiplies rounding errors by about the free path over the radius
    assert_same_places(last.position, place, 1e-8)
    np.testing.assert_allclose(last.velocity, velocity, atol=1e-8)
    assert last.energy.relative_error < 1e-13
    assert last.momentum_error is not None and last.momentum_error < 1e-13


@pytest.mark.slow
def test_an_impact_across_the_sheared_face_is_that_with_the_image_in_open_space_spins_included() -> None:
    rough = {"restitution": 0.7, "static_friction": 0.4, "kinetic_friction": 0.3}
    x = np.array([[0.3, 1.1, 0.1], [0.2, -1.1, 0.0]])
    v = np.array([[0.1, 0.9, 0.0], [-3.0, -0.9, 0.2]])
    spin = [[1.0, -2.0, 3.0], [0.5, 0.0, -4.0]]
    image = np.array([0.0, SIZE[1], 0.0]), np.array([RATE * SIZE[1], 0.0, 0.0])
    end = 0.6
    boxed = [body | {"angular_velocity": w} for body, w in zip(bodies_at(x, v), spin, strict=True)]
    moved = bodies_at(x + np.array([[0.0] * 3, image[0]]), v + np.array([[0.0] * 3, image[1]]))
    free = [body | {"angular_velocity": w} for body, w in zip(moved, spin, strict=True)]
    alone = last_frame(free, contact=rough, gravity={"constant": 0.0}, time={"duration": end})
    last = last_frame(boxed, contact=rough, time={"duration": end}, **sheared())
    assert alone.energy.ledger.friction > 0.0 and alone.energy.ledger.restitution > 0.0
    place, velocity = in_box(alone.position, alone.velocity, end, 0, 1)
    assert_same_places(last.position, place, 1e-13)
    np.testing.assert_allclose(last.velocity, velocity, atol=1e-13)
    assert last.angular_velocity is not None and alone.angular_velocity is not None
    np.testing.assert_allclose(last.angular_velocity, alone.angular_velocity, atol=1e-13)
    for term in ("restitution", "friction"):
        assert getattr(last.energy.ledger, term) == pytest.approx(getattr(alone.energy.ledger, term), rel=1e-12)
    assert last.energy.relative_error < 1e-14
    assert last.contact_rows is None or len(last.contact_rows) == 0


def test_bodies_that_cannot_touch_pass_through_the_images_of_the_box() -> None:
    x, v = gas()
    end, masses = 30.0, np.linspace(1.0, 4.0, len(x))
    start = 0.5 * float((masses[:, None] * v * v).sum())
    last = last_frame(bodies_at(x, v), contact={"enabled": False}, time={"duration": end}, **sheared())
    place, velocity = in_box(x + v * end, v, end, 0, 1)
    assert np.abs(v[:, 1] * end).max() > 5 * SIZE[1]
    assert_same_places(last.position, place, 1e-12)
    np.testing.assert_allclose(last.velocity, velocity, atol=1e-12)
    assert last.energy.ledger.entry("shear") == pytest.approx(start - last.energy.total, rel=1e-12)
    assert last.energy.relative_error < 1e-14


def test_an_exported_box_has_the_vectors_to_its_images_at_the_time_of_the_frame(tmp_path: Path) -> None:
    x, v = gas()
    scene = scene_of(bodies_at(x, v), contact={"enabled": False}, time={"duration": 3.0, "max_dt": 0.1}, **sheared())
    recording = carom.run(scene, tmp_path / "run.rrd")
    write_extended_xyz(tmp_path / "run.extxyz", next(snapshots(recording, 2.0, everything=False)), iter(()))
    head = (tmp_path / "run.extxyz").read_text(encoding="utf-8").splitlines()[1]
    time = float(head.partition("Time=")[2].split()[0])
    cell = np.array(head.partition('Lattice="')[2].partition('"')[0].split(), dtype=float).reshape(3, 3)
    shift = cell[1, 0] - RATE * SIZE[1] * time
    assert shift - SIZE[0] * round(shift / SIZE[0]) == pytest.approx(0.0, abs=1e-14)
    np.testing.assert_array_equal(cell - np.diag(SIZE), np.outer([0.0, 1.0, 0.0], [cell[1, 0], 0.0, 0.0]))
    np.testing.assert_array_equal(cell, recording.cell(time))


def test_bodies_that_move_with_the_flow_stay_on_it() -> None:
    x, _ = gas()
    v = np.zeros_like(x)
    v[:, 0] = RATE * x[:, 1]
    last = last_frame(bodies_at(x, v), contact=SMOOTH | {"enabled": False}, time={"duration": 20.0}, **sheared())
    np.testing.assert_array_equal(last.velocity, v)
    np.testing.assert_array_equal(last.position[:, 1:], x[:, 1:])
    assert last.energy.ledger.entry("shear") == 0.0


@pytest.mark.slow
def test_the_result_does_not_depend_on_where_the_middle_of_the_box_lies() -> None:
    x, v = gas()
    end, up = 3.0, 0.77
    shift, speed = np.array([0.4, up, -0.3]), np.array([RATE * up, 0.0, 0.0])
    frames = [
        last_frame(bodies_at(place, velocity), contact=SMOOTH, time={"duration": end}, **sheared())
        for place, velocity in ((x, v), (x + shift, v + speed))
    ]
    moved = frames[0].position + shift + speed * end
    place, velocity = in_box(moved, frames[0].velocity + speed, end, 0, 1)
    assert_same_places(frames[1].position, place, 1e-9)
    np.testing.assert_allclose(frames[1].velocity, velocity, atol=1e-9)
    dissipated = [frame.energy.ledger.restitution for frame in frames]
    assert dissipated[0] == pytest.approx(dissipated[1], rel=1e-9)


@pytest.mark.slow
def test_without_a_rate_a_sheared_box_is_a_periodic_box() -> None:
    x, v = gas()
    still = sheared(rate=0.0)
    plain = still | {"domain": {key: value for key, value in still["domain"].items() if key != "shear"}}
    frames = [last_frame(bodies_at(x, v), contact=SMOOTH, time={"duration": 2.0}, **box) for box in (still, plain)]
    assert_same_places(frames[0].position, frames[1].position, 1e-10)
    np.testing.assert_allclose(frames[0].velocity, frames[1].velocity, atol=1e-10)


CROWD: dict[str, Any] = {
    "count": 90,
    "radius": {"min": 0.3, "max": 0.5},
    "mass": 1.0,
    "region": {"shape": "box", "size": SIZE.tolist()},
    "velocity": {"dispersion": 0.5},
}


def smallest_gap(frame: Frame, radius: FloatArray, time: float) -> float:
    """Return the smallest gap of two spheres, over all images, in m."""
    gaps = []
    for k in (-1, 0, 1):
        d = frame.position[:, None] - frame.position[None]
        d[..., 1] -= k * SIZE[1]
        d[..., 0] -= k * RATE * SIZE[1] * time
        d[..., 0] -= SIZE[0] * np.round(d[..., 0] / SIZE[0])
        d[..., 2] -= SIZE[2] * np.round(d[..., 2] / SIZE[2])
        gap = np.sqrt((d * d).sum(axis=2)) - radius[:, None] - radius[None]
        gaps.append(gap[~np.eye(len(gap), dtype=bool)].min())
    return float(min(gaps))


@pytest.mark.slow
@pytest.mark.parametrize("restitution", [pytest.param(0.0, marks=pytest.mark.nightly), 0.8])
def test_spheres_in_a_crowded_box_never_overlap_an_image_even_if_their_impacts_do_not_end(restitution: float) -> None:
    document = sheared() | {"group": [CROWD], "contact": SMOOTH | {"restitution": restitution}}
    document |= {"time": {"duration": 1.5}, "record": {"every": 0.3}}
    space = Space(Scene.from_dict(document))
    for frame in space.run():
        # touching spheres err by the rounding of the coordinates
        assert smallest_gap(frame, space.state.radius, frame.time) > -1e-12
    assert frame.energy.relative_error < 1e-12
    assert frame.momentum_error is not None and frame.momentum_error < 1e-12
    assert frame.energy.ledger.entry("shear") < 0.0 < frame.energy.ledger.restitution


def test_a_group_starts_with_the_flow_in_addition_to_its_own_velocities() -> None:
    still = sheared(rate=0.0) | {"group": [CROWD], "contact": {"enabled": False}}
    plain, moving = (Space(Scene.from_dict(still | box)).state for box in (sheared(rate=0.0), sheared()))
    np.testing.assert_array_equal(moving.position, plain.position)
    np.testing.assert_allclose(moving.velocity[:, 0] - plain.velocity[:, 0], RATE * plain.position[:, 1], atol=1e-15)
    np.testing.assert_array_equal(moving.velocity[:, 1:], plain.velocity[:, 1:])


@pytest.mark.slow
def test_a_sheared_gas_has_the_same_bits_on_any_number_of_threads_after_resuming_and_in_a_replay(
    tmp_path: Path,
) -> None:
    document = sheared() | {"group": [CROWD], "contact": {"restitution": 0.9}, "time": {"duration": 0.6}}
    runs = [list(Space(Scene.from_dict(document), threads).run()) for threads in (1, 2)]
    assert [frame.fingerprint for frame in runs[0]] == [frame.fingerprint for frame in runs[1]]
    short, longer = tmp_path / "short.rrd", tmp_path / "longer.rrd"
    carom.run(Scene.from_dict(document | {"time": {"duration": 0.3}}), short)
    assert carom.resume(short, 0.6, longer).finished
    assert carom.replay(longer).same
    recording = carom.Recording.open(longer)
    assert recording.info["shear.rate"] == RATE and recording.info["shear.gradient"] == "y"
    assert recording.energy()["shear"].to_numpy()[-1] < 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"domain": {"boundary": "open", "shear": {"rate": 1.0}}}, 'set boundary = "periodic"'),
        (
            {"domain": {"boundary": "periodic", "size": [9.0] * 3, "shear": {"rate": 1.0, "flow": "y"}}},
            "choose two different axes",
        ),
        ({"drag": {"relaxation_time": 1.0}}, "domain.shear with a [drag]"),
        ({"time": {"duration": 1.0, "accuracy": 1e-6}}, "domain.shear with time.accuracy"),
        ({"time": {"duration": 1.0, "integrator": "yoshida4"}}, 'set "leapfrog"'),
        ({"contact": {"sleep": {"speed": 0.1}}}, "domain.shear with contact.sleep"),
        ({"contact": {"allow_overlap": True}}, "domain.shear with contact.allow_overlap"),
        ({"model": {"force": ["spin"]}}, "domain.shear with model.force"),
        ({"body": [{"fixed": True}]}, "domain.shear with a fixed body"),
    ],
)
def test_what_a_sheared_box_does_not_support_is_refused_with_the_remedy(change: dict[str, Any], message: str) -> None:
    document = sheared() | {"body": [{"radius": 0.5}], "time": {"duration": 1.0}} | change
    with pytest.raises(SceneError, match=r"shear|axes") as error:
        Scene.from_dict(document)
    assert message in str(error.value)
