"""Bodies from data files and arrays."""

from __future__ import annotations

import os
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.feather
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

from carom.errors import SceneError
from carom.physics.placement import place
from carom.plan.features import require
from carom.plan.hierarchy import heaviest
from carom.scene import data as table
from carom.scene.load import Scene
from carom.scene.matter import pair_coefficients
from carom.scene.wording import JoinedNames, NumberedNames
from seeds import chosen_seed

POSITION = np.array([[0.0, 0.0, 0.1], [3.0, 0.0, 0.2], [0.0, 3.0, 0.3]])
VELOCITY = np.array([[1.0, 0.0, 0.0], [0.0, 1.0 / 3.0, 0.0], [0.0, 0.0, 0.0]])
MASS = np.array([1.0, 2.0, 3.0])
RADIUS = np.array([0.5, 0.6, 0.7])

Columns = dict[str, Any]


def columns(**others: Any) -> Columns:
    found: Columns = dict(zip("xyz", POSITION.T, strict=True))
    found |= dict(zip(("vx", "vy", "vz"), VELOCITY.T, strict=True))
    found |= {"m": MASS, "r": RADIUS, **others}
    return {name: values for name, values in found.items() if values is not None}


def write_csv(path: Path, **others: Any) -> None:
    pyarrow.csv.write_csv(pa.table(columns(**others)), path)


def write_parquet(path: Path, **others: Any) -> None:
    pq.write_table(pa.table(columns(**others)), path)


def write_feather(path: Path, **others: Any) -> None:
    pyarrow.feather.write_feather(pa.table(columns(**others)), path)


def write_stream(path: Path, **others: Any) -> None:
    found = pa.table(columns(**others))
    with pa.ipc.new_stream(path, found.schema) as writer:
        writer.write_table(found)


def write_npz(path: Path, **others: Any) -> None:
    np.savez(path, **({"position": POSITION, "velocity": VELOCITY, "mass": MASS, "radius": RADIUS} | others))


def write_hdf5(path: Path, **others: Any) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        group = file.create_group("PartType0")
        named = {"Coordinates": POSITION, "Velocities": VELOCITY, "Masses": MASS.astype(">f8"), "Radius": RADIUS}
        for name, values in (named | others).items():
            group[name] = values


def write_rebound(path: Path, **others: Any) -> None:
    import rebound

    simulation = rebound.Simulation()
    if others.get("units"):
        simulation.units = others["units"]
    for k in range(len(MASS)):
        x, v = POSITION[k], VELOCITY[k]
        simulation.add(m=MASS[k], r=RADIUS[k], x=x[0], y=x[1], z=x[2], vx=v[0], vy=v[1], vz=v[2])
    simulation.save_to_file(str(path), delete_file=True)


WRITERS: dict[str, Callable[..., None]] = {
    "a.csv": write_csv,
    "a.parquet": write_parquet,
    "a.feather": write_feather,
    "a.arrow": write_stream,
    "a.npz": write_npz,
    "a.h5": write_hdf5,
    "a.bin": write_rebound,
}


def files(*names: str) -> list[Any]:
    """Return parameters, with the packages that their formats need."""
    packages = {"a.h5": "h5py", "a.bin": "rebound"}
    return [pytest.param(name, marks=pytest.mark.needs(packages[name]) if name in packages else ()) for name in names]


def scene_of(folder: Path, file: str, more: str = "", top: str = "") -> Scene:
    path = folder / "scene.toml"
    path.write_text(f'{top}\n[[bodies]]\nfile = "{file}"\n{more}\n', encoding="utf-8")
    return Scene.load(path)


def complaint(folder: Path, file: str, more: str = "", top: str = "") -> str:
    with pytest.raises(SceneError) as caught:
        place(scene_of(folder, file, more, top))
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("file", files(*WRITERS))
def test_bodies_of_each_format_have_the_numbers_of_the_file(tmp_path: Path, file: str) -> None:
    WRITERS[file](tmp_path / file)
    start = place(scene_of(tmp_path, file))
    for found, written in ((start.position, POSITION), (start.velocity, VELOCITY), (start.mass, MASS)):
        assert np.array_equal(found, written)
    assert np.array_equal(start.radius, RADIUS)
    assert np.array_equal(start.inertia, 0.4 * MASS * RADIUS * RADIUS)
    assert list(start.name) == ["body 0", "body 1", "body 2"]


def test_constants_take_the_place_of_columns(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv")
    start = place(scene_of(tmp_path, "a.csv", 'radius = "1 cm"\ndensity = 2600.0\nvelocity = [0, 0, 1]'))
    assert start.radius.tolist() == 3 * [0.01]
    assert start.mass == pytest.approx(3 * [2600.0 * 4.0 / 3.0 * np.pi * 1e-6], rel=1e-15)
    assert start.velocity.tolist() == 3 * [[0.0, 0.0, 1.0]]


@pytest.mark.parametrize("given", ["radius = 0.2", "mass = 4.0", "density = 2600.0"])
def test_a_radius_or_mass_in_place_of_a_column_leaves_out_the_inertia_that_the_file_has_for_it(
    tmp_path: Path, given: str
) -> None:
    write_parquet(tmp_path / "a.parquet", inertia=0.5 * MASS * RADIUS**2)
    start = place(scene_of(tmp_path, "a.parquet", given))
    np.testing.assert_allclose(start.inertia, 0.4 * start.mass * start.radius**2, rtol=1e-14)
    shell = "[[material]]\nname = 'shell'\ninertia_factor = 0.6"
    start = place(scene_of(tmp_path, "a.parquet", f"{given}\nmaterial = 'shell'", shell))
    np.testing.assert_allclose(start.inertia, 0.6 * start.mass * start.radius**2, rtol=1e-14)


def test_an_inertia_is_kept_where_the_scene_names_its_column_or_replaces_nothing(tmp_path: Path) -> None:
    inertia = 0.5 * MASS * RADIUS**2
    write_parquet(tmp_path / "a.parquet", inertia=inertia)
    start = place(scene_of(tmp_path, "a.parquet", 'radius = 0.2\ncolumns = { inertia = "inertia" }'))
    assert start.inertia.tolist() == inertia.tolist()
    write_parquet(tmp_path / "b.parquet", inertia=inertia, r=None)
    assert place(scene_of(tmp_path, "b.parquet", "radius = 0.2")).inertia.tolist() == inertia.tolist()


def test_columns_are_taken_by_the_names_that_the_scene_gives(tmp_path: Path) -> None:
    write_parquet(tmp_path / "a.parquet", X=POSITION[:, 2], mass=MASS, pinned=[1, 0, 0], vx=None, vy=None, vz=None)
    named = 'columns = { position = ["X", "y", "x"], mass = "m", fixed = "pinned" }'
    scene = scene_of(tmp_path, "a.parquet", named)
    start = place(scene)
    assert start.position[:, 0].tolist() == POSITION[:, 2].tolist()
    assert start.position[:, 2].tolist() == POSITION[:, 0].tolist()
    assert start.fixed.tolist() == [True, False, False]
    assert scene.anchored


def test_spins_and_diameters_are_found_by_the_names_that_granular_codes_give_them(tmp_path: Path) -> None:
    spins = dict(zip(("omegax", "omegay", "omegaz"), VELOCITY.T, strict=True))
    write_csv(tmp_path / "a.csv", **spins, diameter=2.0 * RADIUS, r=None)
    scene = scene_of(tmp_path, "a.csv")
    assert np.array_equal(scene.data[0].angular_velocity, VELOCITY)
    assert np.array_equal(scene.data[0].radius, RADIUS)
    ((used,),) = scene.notes  # and no columns that are not used
    assert "angular velocity from omegax, omegay, omegaz" in used and "diameter from diameter (1 to 1.4 m)" in used
    named = scene_of(tmp_path, "a.csv", 'columns = { diameter = "m" }')
    assert named.data[0].radius.tolist() == [0.5, 1.0, 1.5]
    assert "omegaz" in complaint_of_columns(tmp_path, **spins | {"omegax": None})
    assert 'columns = { radius = "r" }' in complaint_of_columns(tmp_path, diameter=RADIUS)


def complaint_of_columns(folder: Path, **others: Any) -> str:
    write_csv(folder / "wrong.csv", **others)
    return complaint(folder, "wrong.csv")


@pytest.mark.parametrize("file", ["a.csv", "a.parquet", "a.npz"])
def test_every_column_that_is_not_used_is_listed(tmp_path: Path, file: str) -> None:
    WRITERS[file](tmp_path / file, id=np.arange(3), mu=RADIUS, **{"ev\x1bil\n" * 9: RADIUS})
    ((_, note),) = scene_of(tmp_path, file, "radius = 0.1").notes
    columns = note.removeprefix(f"{file}: columns that are not used: ")
    radius = "r" if file != "a.npz" else "radius"
    evil = ("ev�il�" * 7)[:40]
    found = [
        f"{radius} (the scene gives the radius)",
        "id",
        "mu ([contact] or a [[material]] gives coefficients)",
        evil,
    ]
    assert sorted(columns.split(", ")) == sorted(found)


def test_numbers_of_a_file_are_in_the_units_of_the_scene(tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz")
    start = place(scene_of(tmp_path, "a.npz", top='[units]\nlength = "km"\nmass = "g"\n'))
    assert start.position == pytest.approx(1e3 * POSITION, rel=1e-15)
    assert start.velocity == pytest.approx(1e3 * VELOCITY, rel=1e-15)
    assert start.mass == pytest.approx(1e-3 * MASS, rel=1e-15)


@pytest.mark.needs("rebound")
def test_a_simulationarchive_in_other_units_than_si_needs_a_scene_that_names_units(tmp_path: Path) -> None:
    write_rebound(tmp_path / "a.bin", units=("days", "AU", "Msun"))
    said = complaint(tmp_path, "a.bin")
    assert said.endswith(
        'a.bin: its numbers are in au, day, M_sun, and the scene has SI units; write units = "au, day, M_sun" at the '
        'top of the scene, or [units] with length = "au", time = "day", mass = "M_sun"'
    )
    own = 'units = "au, day, M_sun"\ngravity.constant = 0'
    assert place(scene_of(tmp_path, "a.bin", top=own)).radius.tolist() == RADIUS.tolist()
    given = '[units]\nlength = "au"\ntime = "day"\nmass = "M_sun"'
    assert place(scene_of(tmp_path, "a.bin", top=given)).radius == pytest.approx(RADIUS * 149597870700.0)


@pytest.mark.needs("rebound")
@pytest.mark.parametrize(
    ("top", "said"),
    [
        ('units = "au, yr, M_sun"', "and the scene has velocity in au/yr; write units"),
        ('units = "km, day, M_sun"', "and the scene has length in km; write units"),
        ('[units]\nlength = "au"\ntime = "day"', "and the scene has mass in kg; write units"),
        (
            '[units]\nlength = "au"\ntime = "day"\nmass = "M_sun"\nvelocity = "km/s"',
            "has velocity in km/s; write units",
        ),
    ],
)
def test_a_simulationarchive_whose_units_the_scene_contradicts_is_refused(tmp_path: Path, top: str, said: str) -> None:
    write_rebound(tmp_path / "a.bin", units=("days", "AU", "Msun"))
    message = complaint(tmp_path, "a.bin", top=f"{top}\n[gravity]\nconstant = 0")
    assert "a.bin: its numbers are in au, day, M_sun" in message and said in message


@pytest.mark.needs("rebound")
def test_units_of_a_simulationarchive_contradict_only_numbers_that_are_read_from_it(tmp_path: Path) -> None:
    write_rebound(tmp_path / "a.bin", units=("days", "AU", "Msun"))
    masses = '[units]\nlength = "au"\ntime = "day"\nmass = "kg"'
    assert place(scene_of(tmp_path, "a.bin", "mass = 5", top=masses)).mass.tolist() == 3 * [5.0]
    without = 'units = "dimensionless"\n[gravity]\nconstant = 0'
    assert place(scene_of(tmp_path, "a.bin", top=without)).mass.tolist() == MASS.tolist()


@pytest.mark.needs("rebound")
def test_a_simulationarchive_in_si_or_without_units_is_read_as_it_is(tmp_path: Path) -> None:
    for units in (("s", "m", "kg"), None):
        write_rebound(tmp_path / "a.bin", units=units)
        assert place(scene_of(tmp_path, "a.bin")).radius.tolist() == RADIUS.tolist()


def test_of_several_steps_the_last_is_read_or_the_one_asked_for(tmp_path: Path) -> None:
    steps = np.stack([POSITION, POSITION + 1.0])
    write_npz(tmp_path / "a.npz", position=steps, velocity=np.stack([VELOCITY, VELOCITY]))
    assert np.array_equal(place(scene_of(tmp_path, "a.npz")).position, steps[1])
    assert np.array_equal(place(scene_of(tmp_path, "a.npz", "snapshot = 0")).position, steps[0])
    twice = {name: np.concatenate([values, values]) for name, values in columns().items()}
    twice |= {
        "step": np.repeat([0, 8], 3),
        "body": np.tile(np.arange(3), 2),
        "x": np.r_[POSITION[:, 0], 9.0, 12.0, 15.0],
    }
    pq.write_table(pa.table(twice), tmp_path / "a.parquet")
    assert place(scene_of(tmp_path, "a.parquet")).position[:, 0].tolist() == [9.0, 12.0, 15.0]
    assert "it has 2" in complaint(tmp_path, "a.parquet", "snapshot = 5")


def test_bodies_from_data_come_after_single_ones_and_before_groups(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", name=["left", "right", "top"])
    others = '[[body]]\nname = "sun"\nposition = [0, 0, -9]\n[[group]]\ncount = 1\n'
    others += "region = { radius = 2, centre = [50, 0, 0] }\n"
    write_npz(tmp_path / "b.npz", position=POSITION + 20.0)
    scene = scene_of(tmp_path, "a.csv", f'[[bodies]]\nfile = "b.npz"\nname = "grain"\n{others}')
    start = place(scene)
    assert scene.count == 8
    names = ["sun", "left", "right", "top", "grain 0", "grain 1", "grain 2", "group 0 0"]
    assert list(start.name) == names
    assert start.group.tolist() == [-1, -2, -2, -2, -3, -3, -3, 0]
    assert scene.bodies[0].count == 3


def test_the_plan_knows_what_the_bodies_from_data_do(tmp_path: Path) -> None:
    still, one = np.zeros((3, 3)), np.eye(3)
    for velocity, spin, touches, turns in (
        (still, still, False, False),
        (VELOCITY, still, True, True),
        (still, one, False, True),
    ):
        write_npz(tmp_path / "a.npz", velocity=velocity, angular_velocity=spin)
        needs = require(scene_of(tmp_path, "a.npz", top="[gravity]\nconstant = 0\n"))
        assert (needs.contact.modelled, needs.spin.modelled) == (touches, turns)
    heavy = heaviest(scene_of(tmp_path, "a.npz"))
    assert heavy.name == "body 2"
    assert heavy.fraction == pytest.approx(0.5, rel=1e-15)


def test_a_scene_remembers_the_count_and_the_digest_of_its_file(tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz")
    scene = scene_of(tmp_path, "a.npz", "# a comment")
    assert "count = 3" in scene.toml
    assert "# a comment" in scene.toml
    (tmp_path / "scene.toml").write_text(scene.toml, encoding="utf-8")
    again = Scene.load(tmp_path / "scene.toml")
    assert again.toml == scene.toml
    assert again == scene
    write_npz(tmp_path / "a.npz", mass=MASS + 1.0)
    with pytest.raises(SceneError, match=r"a\.npz has changed: its sha256 is .*, not .* as in the scene; restore"):
        Scene.load(tmp_path / "scene.toml")


def test_changed_keys_keep_the_bodies_or_read_the_file_again(tmp_path: Path) -> None:
    write_npz(tmp_path / "a.npz")
    scene = scene_of(tmp_path, "a.npz")
    assert scene.changed(["time.duration=2"]).data[0] is scene.data[0]
    assert scene.changed(["bodies.0.radius=0.25"]).data[0].radius.tolist() == 3 * [0.25]
    write_npz(tmp_path / "b.npz", mass=MASS + 1.0)
    assert scene.changed(["bodies.0.file=b.npz"]).data[0].mass.tolist() == [2.0, 3.0, 4.0]


def test_arrays_make_a_scene() -> None:
    scene = Scene.from_arrays(
        position=POSITION, velocity=[0, 0, 1], radius=0.5, mass=MASS, fixed=False, name="grain", time={"duration": 2.0}
    )
    start = place(scene)
    assert scene.time.duration == 2.0
    assert start.velocity.tolist() == 3 * [[0.0, 0.0, 1.0]]
    assert np.array_equal(start.mass, MASS)
    assert list(start.name) == ["grain 0", "grain 1", "grain 2"]
    assert scene.changed(["time.duration=3"]).count == 3
    with pytest.raises(SceneError, match="can be changed, because its file is not available"):
        scene.changed(["bodies.0.radius=1"])


def test_a_scene_with_bodies_keeps_its_other_sections() -> None:
    scene = Scene.from_dict({"body": [{"name": "old"}], "time": {"duration": 7.0}})
    own = scene.with_bodies(position=POSITION + 9.0, radius=0.5, density=1.0, name=["a", "b", "c"])
    assert list(place(own).name) == ["a", "b", "c"]
    assert own.time.duration == 7.0
    both = own.with_bodies(keep=True, position=POSITION - 9.0, radius=0.5, density=1.0)
    assert list(place(both).name) == ["a", "b", "c", "body 3", "body 4", "body 5"]


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"position": POSITION[:, :2]}, r"position: an array of the shape \(3, 2\)"),
        ({"position": [1.0, 2.0, 3.0]}, r"position: an array of the shape \(3,\)"),
        ({"mass": [1.0, 2.0]}, r"mass: an array of the shape \(2,\); 3 bodies need the shape \(3,\)"),
        ({"mass": [1.0, np.nan, 1.0]}, "the arrays: column mass, row 1: nan is not a finite number"),
        ({"mass": np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False])}, "mass: body 1 has no value"),
        ({"radius": np.ma.masked_array(1.0, mask=True)}, "radius: there is no value"),
        ({"velocity": np.ma.masked_array([1.0, 2.0, 3.0], [False, False, True])}, "velocity: there is no value"),
        ({"density": 1.0}, "either a mass or a density"),
        ({"radius": None}, "need a position and a radius"),
        ({"mass": ["a", "b", "c"]}, "row 0: 'a' is not a number"),
        ({"position": [[0, 0, 0], [1, 2]]}, "position: .*3"),
        ({"bodies": []}, "bodies: their source is the arrays"),
    ],
)
def test_wrong_arrays_are_refused_in_one_sentence(arrays: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Scene.from_arrays(**{"position": POSITION, "radius": 0.5, "mass": MASS, **arrays})


CONTENTS: dict[str, tuple[dict[str, Any], str, list[str]]] = {
    "a missing column": ({"m": None}, "", ["scene.toml:3: ", "a.csv: no column for mass (usually mass or m", "x, y"]),
    "a velocity of two axes": ({"vz": None}, "", ["columns for velocity are incomplete: vx and vy without vz; add"]),
    "a spin about one axis": ({"wz": MASS}, "", ["columns for angular_velocity are incomplete: wz without wx and wy"]),
    "a missing axis": ({"z": None}, "", ['no column for z; write columns = { position = ["x", "y"] }']),
    "an empty cell": ({"vy": [0.0, None, 1.0]}, "", ["a.csv: column vy, row 1: nan is not a finite number"]),
    "an infinite number": ({"y": [0.0, 1.0, np.inf]}, "", ["column y, row 2: inf is not a finite number"]),
    "a word": ({"m": ["1", "two", "3"]}, "", ["column m, row 1: 'two' is not a number"]),
    "a negative radius": ({"r": [1.0, 1.0, -1.0]}, "", ["column r, row 2: -1 must be more than 0"]),
    "a number too large": ({"m": [1e200, 1.0, 1.0]}, "", ["column m, row 0: 1e+200 is not between 1e-100"]),
    "two columns for one quantity": ({"mass": MASS}, "", ["two columns for mass, ", 'columns = { mass = "']),
    "a mass and a density": ({"density": MASS}, "", ["columns for both mass and density", 'columns = { mass = "m" }']),
    "a column that is not there": ({}, 'columns = { mass = "mas" }', ['no column "mas" for mass', "m, r"]),
    "a column and a value": ({}, 'radius = 1\ncolumns = { radius = "r" }', ["radius and columns.radius are both"]),
    "another count": ({}, "count = 5", ["it has 3 rows, but count = 5"]),
    "overlaps": (
        {"x": 0.0, "y": 0.0, "z": [0.0, 0.5, 1.0]},
        "",
        ["row 1 and row 2 of a.csv overlap by 0.8 m", "; so do row 0 and row 1 of a.csv", "allow_overlap"],
    ),
    "a fixed body that moves": ({"fixed": [True, False, False]}, "", ["row 0 is fixed and has a velocity"]),
    "a flag that is missing": (
        {"fixed": [True, None, False]},
        "",
        ["column fixed, row 1: empty, which is neither true"],
    ),
    "neither true nor false": ({"fixed": [0, 2, 0]}, "", ["column fixed, row 1: ", "neither true nor false"]),
    "no rows": ({name: np.array([]) for name in columns()}, "", ["a.csv: it has no rows"]),
}


@pytest.mark.parametrize("case", CONTENTS)
def test_wrong_columns_are_refused_by_file_column_and_row(tmp_path: Path, case: str) -> None:
    changed, more, expected = CONTENTS[case]
    whole = {name: np.full(3, values) if isinstance(values, float) else values for name, values in changed.items()}
    write_csv(tmp_path / "a.csv", **whole)
    message = complaint(tmp_path, "a.csv", more)
    for part in expected:
        assert part in message


def test_a_refusal_shows_the_number_of_the_file_whatever_its_unit(tmp_path: Path) -> None:
    units = '[units]\nlength = "km"\nmass = "t"\n'
    write_csv(tmp_path / "a.csv", m=[1.0, -2.0, 3.0])
    assert "column m, row 1: -2 must not be negative" in complaint(tmp_path, "a.csv", top=units)
    write_npz(tmp_path / "a.npz", radius=np.array([1.0, 1.0, 1e98]))
    assert "1e+98 is not between 1e-103 and 1e+97 in size" in complaint(tmp_path, "a.npz", top=units)
    write_npz(tmp_path / "a.npz", fixed=np.array(["true", "maybe", "false"]))
    assert "column fixed, row 1: 'maybe' is neither" in complaint(tmp_path, "a.npz", top=units)


def test_all_wrong_files_are_refused_in_one_message(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", m=None)
    write_csv(tmp_path / "b.csv")
    write_csv(tmp_path / "c.csv", r=[1.0, -1.0, 1.0])
    more = "".join(f'[[bodies]]\nfile = "{file}"\n' for file in ("b.csv", "none.csv", "c.csv"))
    with pytest.raises(SceneError) as caught:
        scene_of(tmp_path, "a.csv", more)
    first, second, third = str(caught.value).splitlines()
    assert "scene.toml:3: bodies.0: a.csv: no column for mass" in first
    assert "scene.toml:7: bodies.2: " in second
    assert "none.csv: cannot be read: No such file" in second
    assert "scene.toml:9: bodies.3: c.csv: column r, row 1" in third


def test_overlaps_are_allowed_where_the_scene_says_so(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", x=np.zeros(3), y=np.zeros(3))
    assert len(place(scene_of(tmp_path, "a.csv", top="[contact]\nallow_overlap = true\n")).mass) == 3


def pickled(path: Path) -> None:
    write_npz(path, mass=np.array([1.0, None, 2.0], dtype=object))


def overstated(path: Path) -> None:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (40000000, 3), }".ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("position.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)


def too_many(path: Path) -> None:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (900000000000, 3), }".ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("position.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)


def noise(path: Path) -> None:
    path.write_bytes(b"\x00\xff noise \x80" * 99)


def nothing(path: Path) -> None:
    path.write_bytes(b"")


def hollow(path: Path) -> None:
    path.touch()
    os.truncate(path, 10**12)


def ragged(path: Path) -> None:
    path.write_text("x,y,z\n1,2\n3,4,5\n", encoding="utf-8")


def repeated(path: Path) -> None:
    path.write_text("x,y,z,x,m,r\n1,2,3,4,5,6\n", encoding="utf-8")


def unlike(path: Path) -> None:
    write_npz(path, mass=np.ones(2))


def flat(path: Path) -> None:
    write_npz(path, position=POSITION.ravel())


FILES: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "a pickle": ("a.npz", pickled, "array mass holds Python objects"),
    "an array shorter than it says": ("a.npz", overstated, "claims to have 960000000 bytes"),
    "an array of 10¹² rows": ("a.npz", too_many, "claims to have 21600000000000 bytes"),
    "noise in an archive": ("a.npz", noise, "not an .npz file"),
    "noise in a table": ("a.parquet", noise, "not a Parquet file"),
    "noise in an Arrow file": ("a.arrow", noise, "not an Arrow file"),
    "noise in an HDF5 file": ("a.h5", noise, "not an HDF5 file, or damaged"),
    "noise in a Simulationarchive": ("a.bin", noise, "not a Simulationarchive"),
    "an empty text": ("a.csv", nothing, "not a table of values"),
    "an empty archive": ("a.npz", nothing, "not an .npz file"),
    "an empty table": ("a.parquet", nothing, "not a Parquet file"),
    "rows of different lengths": ("a.csv", ragged, "line 2 has 2 values (1,2), and line 1 names 3"),
    "two columns of one name": ("a.csv", repeated, "two columns for position"),
    "arrays of different lengths": ("a.npz", unlike, "mass has 2 rows, and position has 3"),
    "an array of another shape": ("a.npz", flat, "position has the shape (9,), and position needs (n, 3)"),
    "an unknown format": ("a.xlsx", noise, 'no format has the suffix ".xlsx"; '),
    "a device": ("a.csv", lambda path: path.symlink_to("/dev/zero"), "a.csv: a device or a pipe; name a file"),
    "a pipe": ("a.parquet", os.mkfifo, "a.parquet: a device or a pipe; name a file"),
    "a file of holes": ("a.csv", hollow, "a.csv: 1000000000000 bytes are too many"),
    "a folder": ("folder.npz", Path.mkdir, "a folder, not a data file"),
}


ALIKE = 50_000_000  # rows, which 1 kB may stand for


def filled(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name in columns():
            file.create_dataset(name, shape=(ALIKE,), dtype="f8", chunks=(ALIKE // 50,), fillvalue=1.0)


def write_arrow(path: Path, column: pa.Array, **options: Any) -> None:
    found = pa.table(dict.fromkeys(columns(), column))
    with pa.ipc.new_file(path, found.schema, options=pa.ipc.IpcWriteOptions(**options)) as writer:
        writer.write_table(found)


def nulls(path: Path) -> None:
    write_arrow(path, pa.nulls(table.FREE_ROWS))


def runs(path: Path) -> None:
    write_arrow(path, pa.RunEndEncodedArray.from_arrays(pa.array([table.FREE_ROWS], pa.int32()), pa.array([1.0])))


def squeezed(path: Path) -> None:
    write_arrow(path, pa.array(np.ones(100_000)), compression="zstd")


def squeezed_words(path: Path) -> None:
    words = pa.DictionaryArray.from_arrays(pa.array([0], pa.int8()), pa.array(["a" * 1_000_000]))
    write_arrow(path, words, compression="zstd")


def squeezed_table(path: Path) -> None:
    pq.write_table(pa.table(dict.fromkeys(columns(), np.ones(100_000))), path)


def squeezed_arrays(path: Path) -> None:
    arrays: Any = dict.fromkeys(columns(), np.ones(100_000))
    np.savez_compressed(path, **arrays)


def cases(of: Mapping[str, tuple[str, Any, str]]) -> list[Any]:
    """Return the names of cases, with the packages that their formats need."""
    return [pytest.param(name, marks=param.marks) for name, (file, *_) in of.items() for param in files(file)]


def wide_chunk(path: Path) -> None:
    """Write a dataset of three numbers, whose only chunk has room for 4 × 10⁸."""
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("x", (3,), "f8", maxshape=(None,), chunks=(400_000_000,), compression="gzip")
        file.update({name: np.ones(3) for name in columns() if name != "x"})


BOMBS: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "a chunk larger than its dataset": ("a.h5", wide_chunk, "would take 3200000"),
    "datasets of a fill value": ("a.h5", filled, "would take 3200000000 bytes of memory"),
    "columns of nulls": ("a.arrow", nulls, "column x is of type null; write numbers or text"),
    "columns of one run": ("a.arrow", runs, "column x is of type run_end_encoded"),
    "compressed batches": ("a.feather", squeezed, "bytes of memory: it is damaged, or a decompression bomb"),
    "compressed dictionaries": ("a.arrow", squeezed_words, "bytes of memory: it is damaged, or a decompression bomb"),
    "a compressed table": ("a.parquet", squeezed_table, "would take 6400000 bytes of memory"),
    "compressed arrays": ("a.npz", squeezed_arrays, "would take 64"),
}


@pytest.mark.parametrize("case", cases(BOMBS))
def test_a_small_file_that_would_fill_the_memory_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    file, write, expected = BOMBS[case]
    write(tmp_path / file)
    if case != "datasets of a fill value":
        monkeypatch.setattr(table, "ROOMY", 1_000_000)
    assert expected in complaint(tmp_path, file)


@pytest.mark.parametrize("file", ["a.parquet", "a.feather", "a.arrow"])
def test_a_file_of_too_many_columns_is_refused_before_pyarrow_builds_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    wide = pa.table({f"c{k}": [1.0] for k in range(200)})
    if file == "a.parquet":
        pq.write_table(wide, tmp_path / file)
        monkeypatch.setattr(pq, "ParquetFile", None)
    else:
        pyarrow.feather.write_feather(wide, tmp_path / file)
        monkeypatch.setattr(pyarrow.ipc, "open_stream", None)
    monkeypatch.setattr(table, "MOST_COLUMNS", 49)
    assert "200 columns are too many; at most 49" in complaint(tmp_path, file)


def test_names_in_a_dictionary_are_not_repeated_without_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = pa.DictionaryArray.from_arrays(pa.array([0, 0, 0], pa.int8()), pa.array(["a" * 1000]))
    write_feather(tmp_path / "a.feather", name=words)
    assert scene_of(tmp_path, "a.feather").data[0].name == 3 * ["a" * 1000]
    many = pa.concat_tables(400 * [pyarrow.feather.read_table(tmp_path / "a.feather")]).combine_chunks()
    monkeypatch.setattr(table, "ROOMY", 200_000)
    pyarrow.feather.write_feather(many, tmp_path / "a.feather")
    pq.write_table(many, tmp_path / "a.parquet")
    for file in ("a.feather", "a.parquet"):
        assert "bytes would take 1200000 bytes of memory" in complaint(tmp_path, file)


@pytest.mark.parametrize("case", cases(FILES))
def test_a_hostile_file_is_refused_in_one_sentence(tmp_path: Path, case: str) -> None:
    file, write, expected = FILES[case]
    write(tmp_path / file)
    assert expected in complaint(
        tmp_path, file, "radius = 1\nmass = 1" if "bytes" in expected or "values" in expected else ""
    )


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    assert "nowhere.csv: cannot be read: No such file" in complaint(tmp_path, "nowhere.csv")


def test_a_table_of_too_many_rows_is_refused_before_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "MOST_ROWS", 2)
    for file in ("a.parquet", "a.feather", "a.npz", "a.csv"):
        WRITERS[file](tmp_path / file)
        assert "3 rows are too many; at most 2" in complaint(tmp_path, file)
    monkeypatch.undo()
    monkeypatch.setattr(table, "FREE_ROWS", 2)
    monkeypatch.setattr(table, "LEAST_ROW", 10_000)
    for file in ("a.parquet", "a.feather", "a.npz", "a.csv"):
        assert "3 rows in" in (said := complaint(tmp_path, file)) and "less than 10000 bytes a row" in said


@pytest.mark.parametrize(("file", "package"), [("a.h5", "h5py"), ("a.bin", "rebound")])
def test_a_format_whose_package_is_missing_names_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, package: str
) -> None:
    noise(tmp_path / file)
    monkeypatch.setitem(sys.modules, package, None)
    assert f"pip install '{package}>=" in complaint(tmp_path, file)


@pytest.mark.parametrize("file", files(*(file for file in WRITERS if file != "a.bin")))
def test_a_damaged_file_is_refused_in_one_sentence_or_read(tmp_path: Path, file: str) -> None:
    WRITERS[file](tmp_path / file)
    whole, rng = (tmp_path / file).read_bytes(), np.random.default_rng(chosen_seed())
    for _ in range(40):
        damaged = bytearray(whole)
        for byte in rng.integers(len(damaged), size=rng.integers(1, 5)):
            damaged[byte] = rng.integers(256)
        (tmp_path / file).write_bytes(damaged[: rng.integers(len(damaged) // 2, 2 * len(damaged))])
        try:
            found = scene_of(tmp_path, file).data[0]
        except SceneError as error:
            assert "\n" not in str(error)
        else:
            assert np.isfinite(found.position).all()


def test_a_dictionary_may_have_numpy_arrays_and_numbers() -> None:
    body = {"position": np.array([1.0, 2.0, 3.0]), "radius": np.float64(2.0)}
    scene = Scene.from_dict({"body": [body], "seed": np.int64(3)})
    assert scene.body[0].position == (1.0, 2.0, 3.0)
    assert scene.seed == 3


@pytest.mark.parametrize("name", ["007", "2020-01-01", "true", "1e5", "null", "NA", "nan", 'a, "b"', "名前"])
def test_a_name_in_a_csv_file_is_kept_as_it_is_written(tmp_path: Path, name: str) -> None:
    written = '"{}"'.format(name.replace('"', '""')) if "," in name else name
    (tmp_path / "a.csv").write_text(f"name,x,y,z,m,r\n{written},0,0,0,1,1\n", encoding="utf-8")
    assert list(place(scene_of(tmp_path, "a.csv")).name) == [name]


@pytest.mark.parametrize("missing", [None, np.nan])
def test_a_body_whose_name_is_missing_in_an_array_is_numbered(missing: object) -> None:
    names = np.array(["left", missing, "top"], dtype=object)
    scene = Scene.from_arrays(position=POSITION, radius=0.1, mass=1.0, name=names)
    assert list(place(scene).name) == ["left", "body 1", "top"]


@pytest.mark.parametrize("write", [write_csv, write_parquet])
def test_a_body_whose_name_is_missing_is_numbered(tmp_path: Path, write: Callable[..., None]) -> None:
    file = "a.csv" if write is write_csv else "a.parquet"
    write(tmp_path / file, name=["left", None, "top"])
    assert list(place(scene_of(tmp_path, file)).name) == ["left", "body 1", "top"]


@pytest.mark.parametrize("write", [write_parquet, write_feather])
def test_names_that_are_whole_numbers_keep_their_digits_beside_a_missing_one(
    tmp_path: Path, write: Callable[..., None]
) -> None:
    write(tmp_path / "a.arrow" if write is write_feather else tmp_path / "a.parquet", name=[5, None, 2**60 + 1])
    file = "a.arrow" if write is write_feather else "a.parquet"
    assert list(place(scene_of(tmp_path, file)).name) == ["5", "body 1", "1152921504606846977"]


@pytest.mark.parametrize("write", [write_parquet, write_feather])
def test_names_that_are_whole_numbers_stored_as_floats_have_no_fraction(
    tmp_path: Path, write: Callable[..., None]
) -> None:
    file = "a.arrow" if write is write_feather else "a.parquet"
    write(tmp_path / file, name=pa.array([5.0, None, 2.0**52], pa.float64()))
    assert list(place(scene_of(tmp_path, file)).name) == ["5", "body 1", "4503599627370496"]
    write(tmp_path / file, name=pa.array([5.0, 5.5, 1e300], pa.float64()))
    assert list(place(scene_of(tmp_path, file)).name) == ["5", "5.5", "1e+300"]


@pytest.mark.parametrize(
    ("written", "names"),
    [
        (("5.0", "", "60.0"), ["5", "body 1", "60"]),  # as pandas writes whole numbers beside a missing one
        (("5.0", "5.5", "6.0"), ["5.0", "5.5", "6.0"]),
        (("5.0", "007.0", "6.0"), ["5.0", "007.0", "6.0"]),
        (("5.0", "Körper", "6.0"), ["5.0", "Körper", "6.0"]),
    ],
)
def test_names_in_a_csv_file_lose_a_fraction_of_zero_only_where_all_are_whole_numbers(
    tmp_path: Path, written: tuple[str, ...], names: list[str]
) -> None:
    rows = "".join(f"{name},{3 * k},0,0,1,1\n" for k, name in enumerate(written))
    (tmp_path / "a.csv").write_text(f"name,x,y,z,m,r\n{rows}", encoding="utf-8")
    assert list(place(scene_of(tmp_path, "a.csv")).name) == names


def test_names_are_written_only_when_they_are_asked_for() -> None:
    numbered: NumberedNames = NumberedNames("body", 10**12, 5)
    names = JoinedNames([["sun"], numbered])
    assert (names[0], names[1], names[-1], len(names)) == ("sun", "body 5", f"body {10**12 + 4}", 10**12 + 1)
    assert names[:2] == ["sun", "body 5"]
    assert NumberedNames("a", 2) == ["a 0", "a 1"]
    with pytest.raises(IndexError):
        names[10**13]


def test_many_bodies_need_no_object_each() -> None:
    grid: NDArray[np.float64] = np.stack(np.meshgrid(*3 * [np.arange(40.0)], indexing="ij"), axis=-1).reshape(-1, 3)
    scene = Scene.from_arrays(position=grid, radius=0.4, density=1.0, contact={"enabled": False})
    assert scene.count == 64_000
    assert len(scene.toml) < 1000
    assert place(scene).name[-1] == "body 63999"


def test_bodies_from_a_file_take_the_density_of_their_material_unless_the_file_has_masses(tmp_path: Path) -> None:
    (tmp_path / "bare.csv").write_text("x,y,z\n0,0,0\n3,0,0\n")
    (tmp_path / "heavy.csv").write_text("x,y,z,mass\n0,9,0,5.0\n3,9,0,7.0\n")
    text = (
        "[[material]]\nname = 'shell'\ndensity = 2000.0\ninertia_factor = 0.6\nrestitution = 0.9\n"
        "[[bodies]]\nfile = 'bare.csv'\nradius = 1.0\nmaterial = 'shell'\n"
        "[[bodies]]\nfile = 'heavy.csv'\nradius = 1.0\nmaterial = 'shell'\n"
        "[[body]]\nposition = [0, 20, 0]\n"
    )
    (tmp_path / "scene.toml").write_text(text)
    scene = Scene.load(tmp_path / "scene.toml")
    start = place(scene)
    volume = 4.0 / 3.0 * np.pi
    assert start.mass.tolist() == pytest.approx([1000 * volume, 2000 * volume, 2000 * volume, 5.0, 7.0])
    assert (start.inertia / start.mass).tolist() == pytest.approx([0.4, 0.6, 0.6, 0.6, 0.6])
    found = pair_coefficients(scene)
    assert [found.of(0, 1).restitution, found.of(1, 4).restitution] == [0.5, 0.9]
    heavier = scene.changed(["material.0.density=4000.0"])
    assert place(heavier).mass[1] == pytest.approx(4000 * volume)


def test_arrays_of_bodies_are_of_a_material_each() -> None:
    materials = [
        {"name": "steel", "density": 7800.0, "restitution": 0.9},
        {"name": "shell", "density": "1 g/cm^3", "inertia_factor": 0.5},
    ]
    steel = Scene.from_arrays(position=POSITION, radius=RADIUS, made_of="steel", material=materials)
    both = steel.with_bodies(keep=True, position=POSITION + 10.0, radius=RADIUS, mass=MASS, made_of="shell")
    start = place(both)
    volume = 4.0 / 3.0 * np.pi * RADIUS**3
    np.testing.assert_allclose(start.mass, [*(7800.0 * volume), *MASS], rtol=1e-14)  # products of a few factors
    np.testing.assert_allclose(start.inertia[3:], 0.5 * MASS * RADIUS**2, rtol=1e-14)
    assert [section.material for section in both.bodies] == ["steel", "shell"]
    with pytest.raises(SceneError, match=r'"stele".*"steel"'):
        Scene.from_arrays(position=POSITION, radius=RADIUS, mass=MASS, made_of="stele", material=materials)
