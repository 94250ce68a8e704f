"""Text files as people have them; samples/ has one of each kind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from data_scenes import SAMPLES, refusal, scene_of


def test_a_table_of_a_german_spreadsheet_is_read(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "excel.csv", 'columns = { mass = "Masse [g]" }')
    bodies = scene.data[0]
    np.testing.assert_allclose(bodies.position, [[-0.0125, 0.0, 0.0125], [0.0125, 0.0, -0.0125]], rtol=1e-15)
    np.testing.assert_allclose([bodies.mass, bodies.radius], [[0.0041, 0.0042], [0.005, 0.005]], rtol=1e-15)
    assert bodies.name == ["Kugel; links", "Kugel rechts"]
    said = "excel.csv: read with values separated by semicolons, decimal commas, names in line 2"
    assert scene.notes[0][0] == said


def test_fortran_numbers_in_fixed_columns_are_read(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "fortran.dat")
    assert scene.data[0].velocity[:, 1].tolist() == [0.1, -0.1]
    assert scene.data[0].radius.tolist() == [0.02, 0.02]  # the second is written without its D
    assert scene.notes[0][0].endswith("separated by blanks, names in a comment, 3 lines of comments")


@pytest.mark.parametrize(
    ("file", "more", "radius", "note"),
    [
        ("yade.txt", "density = 2600", [0.005, 0.005], "separated by tabs, names in a comment"),
        ("savetxt.txt", "", [7e8, 7e8], "separated by blanks, names in a comment, 1 line of comments"),
        ("commented.csv", "mass = 1", [0.5, 0.5], "separated by commas, names in line 3, 3 lines of comments"),
        ("bare.txt", 'mass = 1\ncolumns = ["x", "y", "z", "radius"]', [0.5, 0.5], "blanks, no line with names"),
    ],
)
def test_text_files_of_other_programs_are_read(
    tmp_path: Path, file: str, more: str, radius: list[float], note: str
) -> None:
    scene = scene_of(tmp_path, file, more)
    assert scene.data[0].radius.tolist() == radius
    assert note in scene.notes[0][0]


def test_a_table_without_names_asks_for_them(tmp_path: Path) -> None:
    said = refusal(tmp_path, "bare.txt", "mass = 1")
    assert 'bare.txt: no line names its 4 columns; name them all, such as columns = ["x", "y", "z", ' in said
    said = refusal(tmp_path, "bare.txt", 'columns = ["x", "y", "z"]\nmass = 1\nradius = 1')
    assert "bare.txt: it has 4 columns, but the key columns has 3 names" in said
    np.savez(tmp_path / "a.npz", position=np.zeros((1, 3)))
    assert "a.npz: columns = […] names all columns of a text file" in refusal(tmp_path, "a.npz", 'columns = ["x"]')


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("a.csv", "x,y,z\n1,2,3\n1,2\n", "a.csv: line 3 has 2 values (1,2), and line 1 names 3"),
        ("a.txt", "# x y z\n1 2 3\n4 5 6 7\n", "a.txt: line 3 has 4 values (4 5 6 7), and the first row has 3"),
        ("a.csv", "# nothing\n# else\n", "it has only comments"),
        ("a.csv", "x,y,z,m,r\n1,2,3,4,1.5.2\n", "column r, row 0: '1.5.2' is not a number"),
    ],
)
def test_what_is_not_recognised_is_named_with_its_line(tmp_path: Path, file: str, text: str, said: str) -> None:
    (tmp_path / file).write_text(text, encoding="utf-8")
    assert said in refusal(tmp_path, file, "" if "m,r" in text else "mass = 1\nradius = 1")


def test_an_answer_of_horizons_gives_each_body_at_one_epoch(tmp_path: Path) -> None:
    own = 'units = "au, day, M_sun"\ngravity.constant = 0'
    scene = scene_of(
        tmp_path, "horizons.txt", "mass = 0\nradius = 1e-5\nsnapshot = 0", f"{own}\ncontact.enabled = false"
    )
    bodies = scene.data[0]
    assert bodies.name == ["Earth (399)", "1 Ceres (A801 AA)"]
    assert bodies.position[0].tolist() == [-1.764960412046410e-01, 9.672421180372105e-01, -5.611301232011862e-05]
    assert bodies.velocity[1].tolist() == [-2.5e-3, 8.9e-3, 7.5e-4]
    assert (
        "vectors of Horizons at JD 2461041.500000000, relative to Sun (10), in Ecliptic of J2000.0" in scene.notes[0][0]
    )
    si = scene_of(tmp_path, "horizons.txt", "mass = 1\nradius = 1").data[0]  # units are stated, and the last is read
    assert si.position[1, 0] == pytest.approx(2.7975 * 149597870700.0, rel=1e-15)


def test_a_table_of_horizons_that_ends_early_or_mixes_epochs_is_refused(tmp_path: Path) -> None:
    text = (SAMPLES / "horizons.txt").read_text()
    (tmp_path / "short.txt").write_text(text.rpartition("$$EOE")[0])
    assert "has no $$EOE; the file ends early" in refusal(tmp_path, "short.txt")
    (tmp_path / "mixed.txt").write_text(text.replace("2461042.500000000 =", "2461043.500000000 ="))
    said = "Earth (399) and 1 Ceres (A801 AA) differ in epoch: 2461042.500000000 and 2461043.500000000"
    assert said in refusal(tmp_path, "mixed.txt")
