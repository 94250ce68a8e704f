"""Files of LAMMPS, LIGGGHTS, OVITO and ASE; samples/ has one of each kind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from data_scenes import SAMPLES, refusal, scene_of

NO_GRAVITY = 'units = "dimensionless"\ngravity.constant = 0'


def test_a_dump_is_read_at_a_step_in_the_order_of_its_ids(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "granular.lammpstrj")
    bodies = scene.data[0]
    assert bodies.position[:, 0].tolist() == [0.1, 0.35] and bodies.velocity[:, 2].tolist() == [-1.0, 0.0]
    assert bodies.angular_velocity[1].tolist() == [0.0, 0.0, 2.5] and bodies.mass.tolist() == [0.001, 0.002]
    assert scene.notes[0][0] == "granular.lammpstrj: step 1000 of LAMMPS"
    assert "its box of 1 × 1 × 2 is periodic, which is not taken over" in scene.notes[0][1]
    assert scene_of(tmp_path, "granular.lammpstrj", "snapshot = 0").data[0].radius.tolist() == [0.05, 0.05]
    assert "it has 2" in refusal(tmp_path, "granular.lammpstrj", "snapshot = 2")


def test_scaled_positions_are_lengths_in_the_box(tmp_path: Path) -> None:
    bodies = scene_of(tmp_path, "scaled.dump", "mass = 1\nradius = 0.1").data[0]
    assert bodies.position.tolist() == [[0.5, 2.0, 1.0]]


def test_a_dump_is_recognised_whatever_its_ending(tmp_path: Path) -> None:
    text = (SAMPLES / "scaled.dump").read_text()
    (tmp_path / "dump.txt").write_text(text)
    assert scene_of(tmp_path, "dump.txt", "mass = 1\nradius = 0.1").count == 1
    (tmp_path / "short.dump").write_text(text.replace("ATOMS\n1\n", "ATOMS\n3\n"))
    assert "step 5 has 1 of its 3 atoms; the file ends early" in refusal(tmp_path, "short.dump")
    (tmp_path / "uneven.dump").write_text(text.replace("0.75 0.5", "0.75"))
    assert "line 10 has 4 values (1 1 0.75 0.125), and there are 5 columns" in refusal(tmp_path, "uneven.dump")
    (tmp_path / "many.dump").write_text(text.replace("ATOMS\n1\n", "ATOMS\n999999999999\n"))
    assert "999999999999 rows are too many" in refusal(tmp_path, "many.dump")


def test_a_data_file_gives_spheres_or_atoms_with_masses_by_type(tmp_path: Path) -> None:
    bodies = scene_of(tmp_path, "sphere.data").data[0]
    assert bodies.radius.tolist() == [0.05, 0.1] and bodies.velocity[:, 2].tolist() == [1.0, -1.0]
    assert bodies.angular_velocity[1].tolist() == [0.0, 0.0, 3.5]
    np.testing.assert_allclose(bodies.mass, 2500.0 * np.pi / 6.0 * np.array([0.1, 0.2]) ** 3, rtol=1e-15)
    atoms = scene_of(tmp_path, "atoms.data", "radius = 1.0").data[0]
    assert atoms.mass.tolist() == [39.948, 20.18]
    text = (tmp_path / "atoms.data").read_text()
    (tmp_path / "bare.data").write_text(text.replace(" # atomic", ""))
    assert 'line 11: write the atom style after the title, such as "Atoms # sphere"' in refusal(tmp_path, "bare.data")
    (tmp_path / "type.data").write_text(text.replace("2 20.18\n", ""))
    assert "no mass of the type 2 in its section Masses" in refusal(tmp_path, "type.data", "radius = 1")


def test_xyz_is_read_with_or_without_named_columns(tmp_path: Path) -> None:
    plain = scene_of(tmp_path, "water.xyz", "mass = 1\nradius = 0.1", NO_GRAVITY)
    assert plain.data[0].position[1].tolist() == [0.757, 0.586, 0.0]
    assert plain.notes[0][-1] == "water.xyz: columns that are not used: species"
    named = scene_of(tmp_path, "ase.xyz", "", NO_GRAVITY)
    assert named.data[0].mass.tolist() == [39.948, 39.948] and named.data[0].radius.tolist() == [1.88, 1.88]
    assert "its box is periodic" in named.notes[0][0] and "momenta 0, momenta 1" in named.notes[0][-1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3\nwater\nO 0 0 0\nH 1 0 0\n", "the step from line 1 on has 2 of its 3 rows"),
        ("1\nfirst\nO 0 0 0\nmany\n", "line 4 is many, and the number of rows is needed"),
        ("1\nProperties=pos:R:3:mass\n0 0 0 1\n", "does not name columns, such as pos:R:3"),
        ("99999999999\nbomb\nO 0 0 0\n", "99999999999 rows are too many"),
        ("2\nuneven\nO 0 0 0\nH 1 1\n", "line 4 has 3 values (H 1 1), and there are 4 columns"),
    ],
)
def test_an_xyz_that_is_damaged_is_refused_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.xyz").write_text(text, encoding="utf-8")
    assert said in refusal(tmp_path, "a.xyz", "mass = 1\nradius = 1")
