"""Rows of a file that lack a value: the scene sets a replacement or leaves the row out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from carom.scene.load import Scene
from data_scenes import refusal, scene_of

TABLE = "name,x,y,z,mass,radius\nA,0,0,0,1,0.5\nB,5,0,0,,0\nC,,,,2,0.5\nD,9,0,0,3,\n"


def scene(folder: Path, more: str) -> Scene:
    (folder / "a.csv").write_text(TABLE)
    return scene_of(folder, "a.csv", more, "gravity.constant = 0")


def test_the_scene_gives_radii_and_masses_that_rows_lack(tmp_path: Path) -> None:
    made = scene(tmp_path, 'missing = { radius = "1 cm", mass = 4.0, leave_out = true }')
    bodies = made.data[0]
    assert bodies.name == ["A", "B", "D"]
    assert bodies.radius.tolist() == [0.5, 0.01, 0.01] and bodies.mass.tolist() == [1.0, 4.0, 3.0]
    assert made.notes[0][2:] == (
        "a.csv: 1 row of 4 left out, because a position is missing",
        "a.csv: 2 rows of 3 without a radius: radius = 0.01 m",
        "a.csv: 1 row of 3 without a mass: mass = 4 kg",
    )


def test_a_missing_value_is_refused_with_its_row_and_what_would_stand_for_it(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    assert "column x, row 2: nan is not a finite number" in refusal(tmp_path, "a.csv")
    said = refusal(tmp_path, "a.csv", "missing = { leave_out = true }")
    assert "column radius, row 3: nan is not a finite number; missing = { radius = … } gives it a value" in said
    said = refusal(tmp_path, "a.csv", "missing = { leave_out = true, radius = 1 }")
    assert "column mass, row 1: nan is not a finite number; missing = { mass = … } gives it a value" in said


def test_a_radius_of_zero_stands_for_a_missing_one_and_a_mass_of_zero_is_a_test_particle(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", position=[[0.0, 0, 0], [3.0, 0, 0]], mass=[0.0, 1.0], diameter=[0.0, 2.0])
    more = "missing = { radius = 0.25, mass = 9.0 }"
    bodies = scene_of(tmp_path, "a.npz", more, "gravity.constant = 0\ncontact.enabled = false").data[0]
    assert bodies.radius.tolist() == [0.25, 1.0] and bodies.mass.tolist() == [0.0, 1.0]
