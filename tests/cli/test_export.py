"""`carom export`: other tools get the bodies with all their digits."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq
import pytest

import carom as library
from carom import registry
from carom.physics.placement import place
from carom.recording.export import Snapshot
from carom.recording.read.recording import Recording
from carom.recording.read.state_columns import STATE_QUANTITIES, units_of
from carom.runs.recomputed import snapshots
from carom.runs.window import rerun
from carom.scene.data.body_columns import BodyColumns
from carom.scene.load import Scene
from carom_command import carom
from data_scenes import scene_of

BALLS = 7


@pytest.fixture(scope="module")
def cradle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of the seven balls of the cradle."""
    folder = tmp_path_factory.mktemp("export")
    done = carom("run", "newtons-cradle", "--set", "time.duration=0.2", "-o", "run.rrd", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "run.rrd"


def read_csv(path: Path) -> pa.Table:
    """Read a CSV, without the units in its header."""
    table = pc.read_csv(path)
    return table.rename_columns([name.partition(" [")[0] for name in table.column_names])


@pytest.fixture(scope="module")
def pushed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of two balls that slide and touch on a rough floor."""
    balls = [{"position": [x, 0, 1], "velocity": [-x, 0.5, 0], "name": f"ball {x:+.0f}"} for x in (-1.0, 1.0)]
    scene = {
        "time": {"duration": 0.2, "fixed_dt": 0.01},
        "gravity": {"constant": 0, "uniform": [0, 0, -9.81]},
        "contact": {"restitution": 0.0},
        "plane": [{"name": "floor"}],
        "body": balls,
        "record": {"every": "step"},
    }
    path = tmp_path_factory.mktemp("pushed") / "run.rrd"
    library.run(Scene.from_dict(scene), path)
    return path


def exported(recording: Path, folder: Path, ending: str) -> dict[str, pa.Table]:
    """Export all frames; return the tables by name."""
    done = carom("export", str(recording), "--all", "-o", f"all.{ending}", cwd=folder)
    assert done.returncode == 0, done.stderr
    read = {"parquet": pq.read_table, "csv": pc.read_csv, "arrow": lambda path: pa.ipc.open_file(path).read_all()}
    parts = {"bodies": "all", "contacts": "all-contacts", "energies": "all-energies"}
    return {part: read[ending](folder / f"{stem}.{ending}") for part, stem in parts.items()}


@pytest.mark.parametrize("ending", ["parquet", "arrow"])
def test_tables_have_everything_with_units(pushed: Path, tmp_path: Path, ending: str) -> None:
    tables, recording = exported(pushed, tmp_path, ending), Recording.open(pushed)
    bodies, contacts, energies = tables.values()
    window = rerun(recording, 0.0)
    own, step = window.trajectories(), recording.frames
    assert bodies.num_rows == 2 * step and bodies["name"].to_pylist()[:2] == ["ball -1", "ball +1"]
    for quantity in STATE_QUANTITIES:
        values = np.stack([bodies[column].to_numpy() for column in quantity.columns], axis=1)
        assert np.array_equal(values.reshape(step, 2, -1), own.vectors[quantity.name]), quantity.name
        assert all(units_of(bodies).get(column, "") == quantity.unit for column in quantity.columns)
    assert own.vectors["torque"].any(), "the floor rubs"
    inertia = recording.bodies.inertia[0]
    torque = inertia * own.vectors["angular_acceleration"]
    assert np.allclose(own.vectors["torque"], torque, rtol=1e-15, atol=0.0), "rounding of one product"
    energy = recording.energy()
    for name in set(energy.column_names) - {"step", "sim_time", "time", "relative_error"}:
        assert energies[name].to_pylist() == energy[name].to_pylist() and energies["step"].to_pylist() == list(
            range(step)
        )
    assert units_of(energies)["total"] == "J"
    later = rerun(recording, 0.1, contacts=True).contacts(0.1)
    (time,) = set(later["time"].to_pylist())
    same = contacts.filter(pa.array(np.asarray(contacts["time"]) == time)).select(later.column_names)
    assert same.to_pylist() == later.to_pylist() and len(later) == 3
    assert all("ball" in name for name in contacts["name_i"].to_pylist())
    assert any("floor" in name for name in contacts["name_j"].to_pylist())
    assert units_of(contacts)["normal_force"] == "N"


def test_a_csv_has_the_units_in_its_header(pushed: Path, tmp_path: Path) -> None:
    bodies, contacts, energies = exported(pushed, tmp_path, "csv").values()
    assert {"step", "time [s]", "name", "mass [kg]", "x [m]", "wz [rad/s]", "torque_x [N m]"} <= set(
        bodies.column_names
    )
    assert {"name_i", "normal_force [N]", "normal_impulse [N s]", "mode"} <= set(contacts.column_names)
    assert {"total [J]", "friction [J]", "integration_error [J]"} <= set(energies.column_names)


def test_arrays_have_contacts_and_energies_with_units(pushed: Path, tmp_path: Path) -> None:
    assert carom("export", str(pushed), "--all", "-o", "all.npz", cwd=tmp_path).returncode == 0
    with np.load(tmp_path / "all.npz", allow_pickle=False) as arrays:
        units = json.loads(str(arrays["units"]))
        assert arrays["torque"].shape == arrays["position"].shape == (21, 2, 3)
        assert arrays["contact_normal_force"].shape == arrays["contact_i"].shape and arrays["contact_i"].size > 20
        assert arrays["energy_total"].shape == (21,)
    assert (units["torque"], units["contact_normal_force"], units["energy_total"]) == ("N m", "N", "J")


def test_a_vtk_has_force_chains_as_lines_and_names(pushed: Path, tmp_path: Path) -> None:
    assert carom("export", str(pushed), "--at", "0.1", "-o", "one.vtk", cwd=tmp_path).returncode == 0
    content = (tmp_path / "one.vtk").read_bytes()
    assert np.frombuffer(content.partition(b"LINES 1 3\n")[2][:12], ">i4").tolist() == [2, 0, 1]
    forces = np.frombuffer(content.partition(b"normal_force 1 3 double\n")[2][:24], ">f8")
    touching = rerun(pushed, 0.1, contacts=True).contacts(0.1).to_pylist()
    (between,) = (row["normal_force"] for row in touching if row["j"] == 1)
    assert forces.tolist() == [0.0, 0.0, between or 0.0]
    assert b"name 1 2 string\nball -1\nball %2B1\n" in content


def test_every_format_has_the_bits_of_the_state(cradle: Path, tmp_path: Path) -> None:
    for name in (f"one.{suffix}" for suffix in registry.HOUSE["export_formats"]):
        done = carom("export", str(cradle), "--at", "0.1", "-o", name, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith(f"{name} written: 1 step of 7 bodies, t = 0.1 s.\n")
    bodies = rerun(cradle, 0.1).bodies(0.1)
    times = Recording.open(cradle).fingerprints()["time"].to_numpy()
    time = float(times[np.searchsorted(times, 0.1 - 1e-12)])  # of the first frame from then on
    radius = np.full(BALLS, 0.1)  # as the scene has it, of steel
    mass = 7800.0 * (4.0 / 3.0) * np.pi * radius**3
    position = np.stack([bodies[axis].to_numpy() for axis in "xyz"], axis=1)
    for table in (pq.read_table(tmp_path / "one.parquet"), read_csv(tmp_path / "one.csv")):
        assert np.array_equal(np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1), position)
    with np.load(tmp_path / "one.npz", allow_pickle=False) as arrays:
        assert np.array_equal(arrays["position"], position[None]) and arrays["time"].tolist() == [time]
        assert np.array_equal(arrays["mass"], mass) and np.array_equal(arrays["radius"], radius)
    lines = (tmp_path / "one.extxyz").read_text(encoding="utf-8").splitlines()
    assert lines[0] == str(BALLS) and lines[1].startswith(
        "Properties=species:S:1:id:I:1:pos:R:3:radius:R:1:mass:R:1:velo:R:3"
    )
    assert f" Time={time!r} Step=" in lines[1]
    rows = np.array([line.split()[2:7] for line in lines[2:]], dtype=float)
    assert np.array_equal(rows, np.column_stack([position, radius, mass]))
    vtk = (tmp_path / "one.vtk").read_bytes()
    assert np.frombuffer(vtk.partition(b"TIME 1 1 double\n")[2][:8], ">f8")[0] == time
    _, _, points = vtk.partition(b"POINTS 7 double\n")
    assert np.array_equal(np.frombuffer(points[: 24 * BALLS], ">f8").reshape(BALLS, 3), position)


@pytest.mark.parametrize("ending", ["parquet", "csv", "npz", "extxyz"])
def test_what_is_exported_is_read_back_bit_for_bit(cradle: Path, tmp_path: Path, ending: str) -> None:
    done = carom("export", str(cradle), "--all", "-o", f"all.{ending}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    recording = Recording.open(cradle)
    times = recording.fingerprints()["time"].to_numpy()
    for snapshot in (0, 3, -1):
        bodies = scene_of(tmp_path, f"all.{ending}", f"snapshot = {snapshot}").data[0]
        state = next(snapshots(recording, float(times[snapshot]), everything=False))
        assert_same(bodies, state)


def test_a_vtk_that_is_exported_is_read_back_bit_for_bit(cradle: Path, tmp_path: Path) -> None:
    done = carom("export", str(cradle), "--at", "0.1", "-o", "one.vtk", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    state = next(snapshots(Recording.open(cradle), 0.1, everything=False))
    assert_same(scene_of(tmp_path, "one.vtk").data[0], state)


def assert_same(bodies: BodyColumns, state: Snapshot) -> None:
    for name, values in state.vectors.items():
        if name in ("position", "velocity", "angular_velocity"):
            assert np.array_equal(getattr(bodies, name), values), name
    assert np.array_equal(bodies.mass, state.mass) and np.array_equal(bodies.radius, state.radius)


def test_extended_xyz_has_the_periodic_box(tmp_path: Path) -> None:
    domain = '[domain]\nboundary = "periodic"\nsize = [4, 5, 6]\n'
    scene = f"[time]\nduration = 0.1\n{domain}[gravity]\nconstant = 0\n[[body]]\nvelocity = [1, 0, 0]\n"
    (tmp_path / "scene.toml").write_text(scene, encoding="utf-8")
    assert carom("run", "scene.toml", "-o", "run.rrd", cwd=tmp_path).returncode == 0
    assert carom("export", "run.rrd", "--at", "0.1", "-o", "one.extxyz", cwd=tmp_path).returncode == 0
    head = (tmp_path / "one.extxyz").read_text(encoding="utf-8").splitlines()[1]
    assert head.endswith('Lattice="4.0 0 0 0 5.0 0 0 0 6.0" Origin="-2.0 -2.5 -3.0" pbc="T T T"')


def test_the_bodies_of_a_clip_are_exported_and_no_others(cradle: Path, tmp_path: Path) -> None:
    assert carom("clip", str(cradle), "--bodies", "0,3", "-o", "clip.rrd", cwd=tmp_path).returncode == 0
    for name in (f"one.{suffix}" for suffix in registry.HOUSE["export_formats"]):
        done = carom("export", "clip.rrd", "--at", "0.1", "-o", name, cwd=tmp_path)
        assert done.stdout.startswith(f"{name} written: 1 step of 2 bodies, t = 0.1 s.\n"), done.stderr
    whole = rerun(cradle, 0.1).bodies(0.1).take([0, 3])
    position = np.stack([whole[axis].to_numpy() for axis in "xyz"], axis=1)
    for table in (pq.read_table(tmp_path / "one.parquet"), read_csv(tmp_path / "one.csv")):
        assert table["body"].to_pylist() == [0, 3] and table["name"].to_pylist() == whole["name"].to_pylist()
        assert np.array_equal(np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1), position)
    with np.load(tmp_path / "one.npz", allow_pickle=False) as arrays:
        assert arrays["body"].tolist() == [0, 3] and arrays["mass"].shape == (2,)
        assert np.array_equal(arrays["position"], position[None])
    vtk = (tmp_path / "one.vtk").read_bytes()
    assert b"POINTS 2 double\n" in vtk
    numbers = vtk.partition(b"body 1 2 int\n")[2]
    assert np.frombuffer(numbers[:8], ">i4").tolist() == [0, 3]
    rows = (tmp_path / "one.extxyz").read_text(encoding="utf-8").splitlines()[2:]
    assert [row.split()[1] for row in rows] == ["0", "3"]


def test_bodies_of_an_exported_clip_keep_their_names_in_the_next_scene(cradle: Path, tmp_path: Path) -> None:
    assert carom("clip", str(cradle), "--bodies", "3,5", "-o", "clip.rrd", cwd=tmp_path).returncode == 0
    assert carom("export", "clip.rrd", "--at", "0.1", "-o", "two.csv", cwd=tmp_path).returncode == 0
    (tmp_path / "next.toml").write_text('[[bodies]]\nfile = "two.csv"\n', encoding="utf-8")
    names = Recording.open(cradle).bodies.name
    assert list(place(Scene.load(tmp_path / "next.toml")).name) == [names[3], names[5]]


def test_all_frames_are_exported_in_their_order(cradle: Path, tmp_path: Path) -> None:
    times = Recording.open(cradle).fingerprints()["time"].to_numpy()
    for name in ("all.npz", "all.parquet", "all.extxyz", "all.vtk"):
        done = carom("export", str(cradle), "--all", "-o", name, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "all.npz", allow_pickle=False) as arrays:
        assert np.array_equal(arrays["time"], times) and arrays["velocity"].shape == (len(times), BALLS, 3)
    assert np.array_equal(pq.read_table(tmp_path / "all.parquet")["time"].to_numpy()[::BALLS], times)
    assert (tmp_path / "all.extxyz").read_text(encoding="utf-8").count("Properties=") == len(times)
    listed = json.loads((tmp_path / "all.vtk.series").read_text(encoding="utf-8"))["files"]
    assert [file["time"] for file in listed] == times.tolist()
    assert all((tmp_path / file["name"]).read_bytes().startswith(b"# vtk DataFile") for file in listed)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-o", "bodies.q"], 'the format ".q" is unknown; there are .parquet, .csv, .arrow, .npz, .extxyz, .vtk'),
        (["-o", "bodies.csv", "--all", "--at", "0.1"], "give --at or --all, not both"),
        (["-o", "bodies.csv", "--at", "99"], "covers 0 to 0.2 s; 99 s is outside"),
        (["-o", "taken.csv"], "taken.csv: exists; give --force"),
        (["-o", "taken.vtk", "--all"], "taken-vtk: exists; give --force"),
        (["-o", "no/bodies.csv"], "there is no folder no"),
    ],
)
def test_a_mistake_is_one_sentence_and_leaves_no_file(
    cradle: Path, tmp_path: Path, arguments: list[str], said: str
) -> None:
    (tmp_path / "taken.csv").touch()
    (tmp_path / "taken-vtk").mkdir()
    done = carom("export", str(cradle), *arguments, cwd=tmp_path)
    assert done.returncode == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["taken-vtk", "taken.csv"]
