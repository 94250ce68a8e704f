"""A guess about a column is reported, and a doubtful one is refused with a question."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carom.errors import SceneError
from carom.scene.load import Scene


def scene_of(folder: Path, text: str, more: str = "", top: str = "") -> Scene:
    (folder / "a.csv").write_text(text, encoding="utf-8")
    (folder / "scene.toml").write_text(f'{top}\n[[bodies]]\nfile = "a.csv"\n{more}\n', encoding="utf-8")
    return Scene.load(folder / "scene.toml")


def question(folder: Path, text: str, more: str = "") -> str:
    with pytest.raises(SceneError) as caught:
        scene_of(folder, text, more)
    assert "\n" not in str(caught.value)
    return str(caught.value)


ORBITS = "name,x,y,z,vx,vy,vz,r,M\nA,3,0,4,0,1,0,5,37\nB,6,0,8,0,1,0,10,200\nC,0,0,2,0,1,0,2,90\n"


def test_a_mean_anomaly_and_a_distance_are_not_read_as_masses_and_radii(tmp_path: Path) -> None:
    said = question(tmp_path, ORBITS, "radius = 0.1")
    assert "column M may be the mass, or a mean anomaly or a magnitude" in said
    assert 'columns = { mass = "M" } if it is the mass, or give mass = … for all bodies' in said
    said = question(tmp_path, ORBITS, "mass = 1")
    assert "column r may be the radius, or the distance from the origin, which it equals in each row" in said
    own = scene_of(tmp_path, ORBITS, 'columns = { mass = "M" }\nradius = 0.1')
    assert own.data[0].mass.tolist() == [37.0, 200.0, 90.0]


@pytest.mark.parametrize(
    ("header", "more"),
    [
        ("x,y,z,r,g,b", "mass = 1"),
        ("x,y,z,r,theta,phi", "mass = 1"),
        ("x,y,z,r,a,e", "mass = 1"),
        ("x,y,z,rho,phi,radius", ""),
        ("x,y,z,M,radius,e", ""),
    ],
)
def test_a_letter_that_another_column_explains_otherwise_is_a_question(tmp_path: Path, header: str, more: str) -> None:
    assert " may be the " in question(tmp_path, f"{header}\n1,2,3,4,5,6\n", more)


@pytest.mark.parametrize("header", ["x,y,z,m,r", "X,Y,Z,M,R", "x,y,z,M,R", "x,y,z,M [kg],radius", "x,y,z,mass,r"])
def test_a_letter_that_the_header_confirms_is_read(tmp_path: Path, header: str) -> None:
    bodies = scene_of(tmp_path, f"{header}\n1,2,3,4,5\n").data[0]
    assert bodies.mass.tolist() == [4.0] and bodies.radius.tolist() == [5.0]


def test_the_notes_say_which_column_became_what_with_its_range(tmp_path: Path) -> None:
    text = "id,x,y,z,vx,vy,vz,m,r\n1,1,2,3,0,0,9,1.5,0.5\n2,4,5,6,0,0,8,1.5,0.25\n"
    used, unused = scene_of(tmp_path, text, top='units = "au, day, M_sun"\ngravity.constant = 0').notes[0]
    assert used == (
        "a.csv: position from x, y, z (1 to 6 au); velocity from vx, vy, vz (0 to 9 au/day); mass from m (1.5 M_sun); "
        "radius from r (0.25 to 0.5 au)"
    )
    assert unused == "a.csv: columns that are not used: id"


AU, DAY = 149597870700.0, 86400.0
HEADER = "x [au],y [au],z [au],vx [km/s],vy [km/s],vz [km/s],mass (M_earth),radius [km],inertia [kg m^2]"
ROW = "1,2,3,4,5,6,7,8,9"


def test_units_in_the_header_are_those_of_the_columns(tmp_path: Path) -> None:
    ours = scene_of(tmp_path, f"{HEADER}\n{ROW}\n").data[0]
    assert ours.position.tolist() == [[AU, 2.0 * AU, 3.0 * AU]]
    assert ours.velocity.tolist() == [[4e3, 5e3, 6e3]]
    assert ours.radius.tolist() == [8e3] and ours.inertia.tolist() == [9.0]
    theirs = scene_of(tmp_path, f"{HEADER}\n{ROW}\n", top='units = "au, day, M_earth"\ngravity.constant = 0').data[0]
    assert theirs.position.tolist() == [[1.0, 2.0, 3.0]] and theirs.mass.tolist() == [7.0]
    np.testing.assert_allclose(theirs.velocity, [[each * 1e3 * DAY / AU for each in (4, 5, 6)]], rtol=1e-15)
    plain = scene_of(tmp_path, f"{HEADER}\n{ROW}\n", top='units = "dimensionless"\ngravity.constant = 0').data[0]
    assert plain.position.tolist() == [[1.0, 2.0, 3.0]] and plain.radius.tolist() == [8.0]


def test_a_unit_of_another_dimension_is_refused(tmp_path: Path) -> None:
    said = question(tmp_path, "x [au],y [au],z [deg],m,r\n1,2,3,4,5\n")
    assert 'column z [deg] for position: "deg" is an angle, not a length' in said
