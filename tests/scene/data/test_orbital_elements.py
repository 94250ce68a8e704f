"""Tables of orbital elements become positions and velocities about a central mass at the origin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.scene.data.body_columns import BodyColumns
from carom.scene.data.orbit_tables import julian_date
from carom.scene.load import Scene
from data_scenes import refusal, scene_of

AU, DAY, SUN, G = 149597870700.0, 86400.0, 2e30, 6.6743e-11
PLAIN = 'units = "dimensionless"\ngravity.constant = 1'
ORBIT = "orbit = { central_mass = 1 }\nmass = 0\nradius = 1e-3"
TEST_PARTICLES = "contact.enabled = false"


def bodies(folder: Path, text: str, more: str = ORBIT, top: str = PLAIN) -> BodyColumns:
    (folder / "orbits.csv").write_text(text)
    return scene_of(folder, "orbits.csv", more, f"{TEST_PARTICLES}\n{top}").data[0]


def elements_of(r: FloatArray, v: FloatArray, mu: float) -> tuple[float, ...]:
    """Return a, e, i, node, peri and the mean anomaly in degrees of an ellipse: the textbook's formulas."""
    h = np.cross(r, v)
    towards = np.cross(v, h) / mu - r / np.linalg.norm(r)
    e = float(np.linalg.norm(towards))
    a = 1.0 / (2.0 / np.linalg.norm(r) - v @ v / mu)
    node = np.array([-h[1], h[0], 0.0])
    incline = np.arccos(h[2] / np.linalg.norm(h))
    peri = np.arctan2(np.cross(node, towards) @ h / np.linalg.norm(h), node @ towards)
    eccentric = np.arctan2(r @ v / np.sqrt(mu * a), 1.0 - np.linalg.norm(r) / a)
    angles = incline, np.arctan2(node[1], node[0]), peri, eccentric - e * np.sin(eccentric)
    return (float(a), e, *(float(np.rad2deg(angle)) % 360.0 for angle in angles))


def test_the_satellite_of_vallados_textbook_has_its_published_position_and_velocity(tmp_path: Path) -> None:
    # Vallado, Fundamentals of Astrodynamics, examples 2-5 and 2-6; its true anomaly of 92.335° as a mean anomaly
    p, e, f = 11067.790, 0.832853, np.deg2rad(92.335)
    half = 2.0 * np.arctan(np.sqrt((1.0 - e) / (1.0 + e)) * np.tan(f / 2.0))
    text = f"a,e,i,om,w,M\n{p / (1.0 - e * e)},{e},87.870,227.898,53.38,{np.rad2deg(half - e * np.sin(half))}\n"
    found = bodies(tmp_path, text, top='units = "dimensionless"\ngravity.constant = 398600.4418')
    # the angles are printed to 0.005°, which is 1 km of 11 500 km
    np.testing.assert_allclose(found.position[0], [6524.834, 6862.875, 6448.296], atol=1.0)
    np.testing.assert_allclose(found.velocity[0], [4.901327, 5.533756, -1.976341], atol=1e-3)


angle = st.floats(1.0, 179.0)


@given(
    a=st.floats(0.1, 50.0),
    e=st.floats(0.01, 0.99),
    angles=st.tuples(angle, st.floats(0.0, 359.0), st.floats(0.0, 359.0), st.floats(1.0, 359.0)),
)
def test_the_elements_of_the_state_are_those_of_the_table(
    tmp_path_factory: pytest.TempPathFactory, a: float, e: float, angles: tuple[float, ...]
) -> None:
    row = (a, e, *angles)
    text = f"a,e,i,Omega,omega,M\n{','.join(map(repr, row))}\n"
    found = bodies(tmp_path_factory.getbasetemp(), text, ORBIT.replace("= 1 }", '= 1, angle = "deg" }'))
    again = elements_of(found.position[0], found.velocity[0], 1.0)
    np.testing.assert_allclose(again[0], a, rtol=1e-12 / (1.0 - e))  # r is rounded, and near the pericentre v² ~ 2 / r
    np.testing.assert_allclose(again[1], e, atol=1e-12)
    difference = (np.array(again[2:]) - angles + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(difference, 0.0, atol=1e-9 / e)  # the pericentre of a circle is nowhere


@pytest.mark.parametrize(("e", "t"), [(0.0, 1.0), (0.5, 40.0), (0.999, -2.0), (1.0, 3.0), (1.5, -7.0), (30.0, 1e4)])
def test_every_conic_passes_its_pericentre_at_the_stated_time(tmp_path: Path, e: float, t: float) -> None:
    """The area swept since then, the energy and the angular momentum are those of the orbit."""
    q = 0.7
    found = bodies(tmp_path, f"q,e,i,om,w,tp,epoch\n{q},{e},0,0,0,0,{t}\n")
    (x, y, _), v = found.position[0], found.velocity[0]
    r, h = np.hypot(x, y), np.sqrt(q * (1.0 + e))
    np.testing.assert_allclose(x * v[1] - y * v[0], h, atol=1e-15 * r * np.hypot(*v[:2]), rtol=1e-14)
    np.testing.assert_allclose(v @ v / 2.0 - 1.0 / r, (e - 1.0) / (2.0 * q), rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(r + e * x, q * (1.0 + e), rtol=1e-12)  # the equation of the conic
    if e <= 1.0:  # Kepler's equation, and Barker's
        a = q / (1.0 - e) if e < 1.0 else np.inf
        eccentric = np.arctan2(y / np.sqrt(1.0 - e * e), x + a * e) if e < 1.0 else 0.0
        s = y / (2.0 * q)  # tan of half the true anomaly of a parabola
        since = np.sqrt(2.0 * q**3) * (s + s**3 / 3.0) if e == 1.0 else a**1.5 * (eccentric - e * np.sin(eccentric))
        period = 2.0 * np.pi * a**1.5 if e < 1.0 else np.inf
        turns = (t - since) / period
        assert abs(since - t) < 1e-12 if e == 1.0 else abs(turns - round(turns)) < 1e-12
    else:
        a = q / (e - 1.0)
        hyperbolic = np.arcsinh(y / (a * np.sqrt(e * e - 1.0)))
        np.testing.assert_allclose(a**1.5 * (e * np.sinh(hyperbolic) - hyperbolic), t, rtol=1e-11)


@pytest.mark.needs("rebound")
def test_rebound_has_the_same_states(tmp_path: Path) -> None:
    import rebound

    simulation = rebound.Simulation()
    simulation.add(m=1.0)
    rng = np.random.default_rng(5)
    rows = np.column_stack([rng.uniform(0.5, 5.0, 20), rng.uniform(0.0, 0.9, 20), rng.uniform(0.0, 6.28, (20, 4))])
    for a, e, i, node, peri, mean in rows:
        simulation.add(m=0.0, a=a, e=e, inc=i / 2.0, Omega=node, omega=peri, M=mean)
    rows[:, 2] /= 2.0
    header = "a,e,inc [rad],Omega [rad],omega [rad],M [rad]"
    lines = [header, *(",".join(map(repr, row)) for row in rows.tolist())]
    found = bodies(tmp_path, "\n".join(lines), top='units = "m, s, kg"\ngravity.constant = 1')
    for k, particle in enumerate(simulation.particles[1:]):
        np.testing.assert_allclose(found.position[k], particle.xyz, atol=1e-13)
        np.testing.assert_allclose(found.velocity[k], particle.vxyz, atol=1e-12)


def test_a_table_of_jpl_is_read_in_its_own_units(tmp_path: Path) -> None:
    section = 'orbit = { central_mass = "1 M_sun" }\ndensity = "2000 kg/m^3"'
    scene = scene_of(tmp_path, "sbdb.csv", section)
    ceres = scene.data[0]
    assert ceres.name == ["1 Ceres (A801 AA)", "2 Pallas (A802 FA)", "4 Vesta (A807 FA)"]
    assert ceres.radius.tolist() == [469700.0, 256500.0, 261385.0]
    distance = np.linalg.norm(ceres.position, axis=1) / AU
    assert np.all((distance > 2.1) & (distance < 3.5))
    assert (
        "small bodies of JPL (a [au], e, i [deg], om [deg], w [deg], ma [deg], epoch [day]), about 1.98"
        in scene.notes[0][0]
    )
    own = scene_of(tmp_path, "sbdb.csv", section, 'units = "au, day, M_sun"').data[0]
    np.testing.assert_allclose(own.position, ceres.position / AU, rtol=1e-14)
    np.testing.assert_allclose(own.velocity, ceres.velocity / (AU / DAY), rtol=1e-14)


def test_a_later_epoch_moves_the_bodies_along_their_orbits(tmp_path: Path) -> None:
    text = "a,e,i,om,w,ma,epoch\n1,0.3,20,30,40,50,100\n"
    later = bodies(tmp_path, text, ORBIT.replace("= 1 }", "= 1, epoch = 100.5 }"))
    moved = bodies(tmp_path, text.replace(",50,100", f",{50.0 + float(np.rad2deg(0.5))!r},100"))
    np.testing.assert_allclose(later.position, moved.position, rtol=1e-13)
    np.testing.assert_allclose(later.velocity, moved.velocity, rtol=1e-13)


def test_lines_of_the_minor_planet_center_are_read_by_their_places(tmp_path: Path) -> None:
    section = f'orbit = {{ central_mass = {SUN} }}\nmass = 0\nradius = "1 km"'
    scene = scene_of(tmp_path, "mpcorb.txt", section, TEST_PARTICLES)
    assert scene.data[0].name == ["(1) Ceres", "(2) Pallas", "2024 AA"]
    assert elements_of(scene.data[0].position[2], scene.data[0].velocity[2], G * SUN)[1:] == pytest.approx(
        (0.25, 5.0, 30.0, 20.0, 10.0), abs=1e-9
    )
    assert julian_date("J9611") == 2450083.5 and julian_date("K24AH") == 2460600.5
    text = (tmp_path / "mpcorb.txt").read_text()
    (tmp_path / "excerpt.dat").write_text(text.partition("---\n")[2].lstrip("-\n"))  # as grep or head leaves it
    excerpt = scene_of(tmp_path, "excerpt.dat", section, TEST_PARTICLES)
    np.testing.assert_array_equal(excerpt.data[0].position, scene.data[0].position)
    (tmp_path / "torn.mpcorb").write_text(text.replace("0.0788175", "         "))
    assert "torn.mpcorb: line 6 has no e in columns 71 to 79 (00001" in refusal(tmp_path, "torn.mpcorb", section)


@pytest.mark.parametrize(
    ("text", "more", "said"),
    [
        ("a,e,i,om,w,ma\n1,0,0,0,0,0\n", "radius = 1\nmass = 1", 'write orbit = { central_mass = "1 M_sun" } to read'),
        ("a,e,i,om,ma\n1,0,0,0,0\n", ORBIT, "there is no peri (w)"),
        ("a,e,i,om,w\n1,0,0,0,0\n", ORBIT, "there is no M (ma) or tp"),
        ("a,e,i,om,w,ma\n1,1.5,0,0,0,0\n", ORBIT, "row 0: a = 1 and e = 1.5 define no orbit"),
        ("q,e,i,om,w,ma\n1,1,0,0,0,5\n", ORBIT, "a parabola has no mean anomaly; give q and tp"),
        ("a,e,i,om,w,tp\n1,0,0,0,0,5\n", ORBIT, "tp needs an epoch"),
        ("a,e,i,om,w,ma,epoch\n1,0,0,0,0,5,1\n1,0,0,0,0,5,2\n", ORBIT, "its epochs differ, from 1 to 2"),
        ("a,e,i,om,w,ma\n1,0,0,0,0,\n", ORBIT, "column ma, row 0: empty, which is not a number"),
        ("a,e,i,om,w,ma\n1,0,0,0,0,0\n", f"{ORBIT}\nvelocity = [1, 0, 0]", "orbit and velocity are both given"),
    ],
)
def test_what_is_no_orbit_is_refused_in_one_sentence(tmp_path: Path, text: str, more: str, said: str) -> None:
    with pytest.raises(SceneError) as caught:
        bodies(tmp_path, text, more)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_another_constant_of_gravity_gives_other_velocities(tmp_path: Path) -> None:
    bodies(tmp_path, "a,e,i,om,w,ma\n1,0,0,0,0,0\n")
    scene = Scene.load(tmp_path / "scene.toml", overrides=["gravity.constant=4"])
    np.testing.assert_allclose(scene.data[0].velocity[0], [0.0, 2.0, 0.0], atol=1e-15)
