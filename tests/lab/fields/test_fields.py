"""`carom fields`: closed forms of columns and gases, conservation, files and messages."""

from __future__ import annotations

import base64
import json
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import carom
from carom import Recording
from carom.arrays import FloatArray
from carom.errors import RecordingError
from carom.lab.fields.field_arrays import Fields
from carom.lab.statistics import Interval
from carom.recording.write import impact_plan
from carom_command import carom as command
from small_scenes import scene_of

COLUMN = 6  # balls
SINGLE = 1e-6  # recorded impulses are float32


def smoothed_weight(low: float, high: float) -> float:
    """Return the mean from one height to another of the number of balls above: a ball counts below its centre."""
    centres = 0.5 + np.arange(COLUMN)
    return float(np.clip(centres - low, 0.0, high - low).sum() / (high - low))


@pytest.fixture(scope="module")
def column(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A column of balls of 1 kg and 1 m at rest on a plane, with g = 1 m/s²."""
    scene = scene_of(
        [{"position": [0.2, 0.2, 0.5 + k], "radius": 0.5, "mass": 1.0} for k in range(COLUMN)],
        time={"duration": 0.2, "fixed_dt": 0.01},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        contact={"restitution": 0.0, "static_friction": 0.0},
        plane=[{"normal": [0.0, 0.0, 1.0]}],
    )
    return carom.run(scene, tmp_path_factory.mktemp("column") / "run.rrd")


@pytest.mark.parametrize("replay", [False, True])
@pytest.mark.parametrize("edge", [0.4, 0.75, 2.0])
def test_the_vertical_stress_of_a_column_is_the_weight_above_over_the_area(
    column: Recording, edge: float, replay: bool
) -> None:
    found = carom.fields(column, edge, start=0.1, replay=replay)
    area = found.cell[0] * found.cell[1]
    vertical = found.contact_stress.sum(axis=(0, 1)) * area  # N
    faces = found.faces(2)
    assert faces[0] == 0.0, "the plane is a face of the grid"
    expected = [smoothed_weight(*pair) for pair in pairwise(faces.tolist())]
    assert vertical[:, 2, 2] == pytest.approx(expected, abs=COLUMN * SINGLE)
    vertical[:, 2, 2] = 0.0
    assert np.abs(vertical).max() < COLUMN * SINGLE
    assert np.abs(found.kinetic_stress).max() < SINGLE
    # one contact of the top ball, two of all others
    occupied = found.number_density.sum(axis=(0, 1)) > 0.0
    assert np.nanmax(found.coordination[:, :, occupied]) == pytest.approx(2.0)
    ends = np.nansum(found.coordination * found.number_density) * area * edge
    assert ends == pytest.approx(2 * COLUMN - 1)


def cloud_of(path: Path, friction: float) -> Recording:
    """Record forty unequal balls that collide in a periodic box."""
    group = {
        "count": 40,
        "radius": {"min": 0.3, "max": 0.5},
        "density": 2.0,
        "region": {"shape": "box", "size": [5.0, 4.0, 6.0]},
        "velocity": {"mean": [3.0, 0.0, 0.0], "dispersion": 1.0},
    }
    document: dict[str, Any] = {
        "seed": 2,
        "group": [group],
        "gravity": {"constant": 0.0},
        "contact": {"restitution": 1.0, "static_friction": friction, "kinetic_friction": friction},
        "domain": {"boundary": "periodic", "size": [5.0, 4.0, 6.0]},
        "time": {"duration": 1.0, "fixed_dt": 0.01},
        "record": {"every": "step"},
    }
    return carom.run(carom.Scene.from_dict(document), path)


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return cloud_of(tmp_path_factory.mktemp("cloud") / "run.rrd", 0.0)


def integral(found: Fields, values: FloatArray) -> FloatArray:
    return np.asarray(np.nansum(values, axis=(0, 1, 2)) * np.prod(found.cell))


@pytest.mark.parametrize("cell", ["1r", "5r", "1 km"])
def test_the_integrals_of_the_fields_are_the_sums_over_the_bodies(cloud: Recording, cell: str) -> None:
    step = cloud.checkpoint_steps[-1]
    state, bodies = cloud.checkpoint(step), cloud.bodies
    found = carom.fields(cloud, cell, start=state.time, end=state.time)
    assert found.moments == 1
    mass, velocity = bodies.mass, state.velocity
    assert integral(found, found.density) == pytest.approx(mass.sum(), rel=1e-12)
    assert integral(found, found.number_density) == pytest.approx(40, rel=1e-12)
    assert integral(found, found.solid_fraction) == pytest.approx((4 / 3 * np.pi * bodies.radius**3).sum(), rel=1e-12)
    momentum = integral(found, found.density[..., None] * found.velocity)
    assert momentum == pytest.approx(mass @ velocity, rel=1e-12, abs=1e-12 * mass.sum())
    flux = np.einsum("...,...a,...b->...ab", found.density, found.velocity, found.velocity)
    carried = integral(found, found.kinetic_stress) + integral(found, flux)
    assert carried == pytest.approx(np.einsum("n,na,nb->ab", mass, velocity, velocity), rel=1e-11, abs=1e-9)
    thermal = integral(found, 1.5 * found.number_density * found.granular_temperature)
    assert thermal == pytest.approx(np.trace(integral(found, found.kinetic_stress)) / 2, rel=1e-12)


def test_the_stress_of_a_gas_is_the_virial_of_its_impacts(cloud: Recording) -> None:
    found = carom.fields(cloud, "3r")
    interval = Interval.of(cloud, None, None, False, lambda _: None)
    assert interval.sums.impacts > 20 and not interval.impacts_left_out
    virial = interval.sums.virial / interval.duration
    assert integral(found, found.contact_stress) == pytest.approx(virial, abs=10 * SINGLE * np.abs(virial).max())
    again = carom.fields(cloud, "3r", replay=True)
    assert again.contact_stress == pytest.approx(found.contact_stress, abs=1e-4 * np.abs(found.contact_stress).max())


def test_impacts_without_rows_and_the_friction_of_impacts_count_by_their_sum(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(impact_plan, "SHARE", 0.0)  # of the file; the largest impact of each frame is kept
    recording = cloud_of(tmp_path / "run.rrd", 0.5)
    interval = Interval.of(recording, None, None, False, lambda _: None)
    virial = interval.sums.virial / interval.duration
    assert interval.impacts_left_out > 0 and np.abs(virial - virial.T).max() > 0.01 * np.abs(virial).max()
    found, again = (carom.fields(recording, "3r", replay=replay) for replay in (False, True))
    for each in (found, again):
        assert integral(each, each.contact_stress) == pytest.approx(virial, abs=10 * SINGLE * np.abs(virial).max())
    assert [note.partition(" ")[2][:16] for note in found.notes[-2:]] == ["smaller impacts ", "friction of sing"]
    assert not any("--replay" in note for note in again.notes)


def test_the_grid_of_a_box_divides_it_and_states_the_edges_that_do(cloud: Recording) -> None:
    found = carom.fields(cloud, 1.4)
    assert found.shape == (4, 3, 4)
    assert found.cell == pytest.approx([5.0 / 4, 4.0 / 3, 6.0 / 4])
    assert found.origin == pytest.approx([-2.5, -2.0, -3.0])


@pytest.mark.parametrize("edge", [0.05, 3.0, 1e90])
def test_an_open_grid_contains_all_bodies_whole_and_its_faces_are_multiples_of_the_edge(
    column: Recording, edge: float
) -> None:
    found = carom.fields(column, edge)
    for axis, (low, high) in enumerate([(-0.3, 0.7), (-0.3, 0.7), (0.0, COLUMN)]):
        faces = found.faces(axis)
        assert faces[0] <= low + 0.05 and faces[-1] >= high - 0.05  # 0.1 of a radius, where balls overlap walls
        assert faces[0] / edge == pytest.approx(np.round(faces[0] / edge), abs=1e-9)


def test_friction_that_is_read_is_that_of_the_replay_where_bodies_rest(tmp_path: Path) -> None:
    # a ball in a wedge of two planes at 60° to the ground: friction carries a part of its weight
    sides = [{"normal": [s * np.sqrt(0.75), 0.0, 0.5], "name": name} for s, name in ((1.0, "left"), (-1.0, "right"))]
    scene = scene_of(
        [{"position": [0.02, 0.0, 1.05], "radius": 0.5}, {"position": [0.05, 0.0, 2.06], "radius": 0.5}],
        time={"duration": 1.5, "fixed_dt": 0.01},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        contact={"restitution": 0.0, "static_friction": 0.8, "kinetic_friction": 0.8},
        plane=sides,
    )
    recording = carom.run(scene, tmp_path / "run.rrd")
    last = float(recording.fingerprints()["time"][-1].as_py())
    read, again = (carom.fields(recording, 0.5, start=last, replay=replay) for replay in (False, True))
    assert read.moments == again.moments == 1
    scale = np.abs(again.contact_stress).max()
    assert read.contact_stress == pytest.approx(again.contact_stress, abs=1e-3 * scale)
    normal = np.abs(again.contact_stress - np.swapaxes(again.contact_stress, 3, 4)).max()
    assert normal > 1e-2 * scale, "friction makes the stress of single contacts asymmetric"


def test_a_file_for_paraview_has_the_arrays_of_the_npz_in_the_order_of_vtk(cloud: Recording, tmp_path: Path) -> None:
    found = carom.fields(cloud, "4r", output=tmp_path / "fields.vti")
    carom.fields(cloud, "4r", output=tmp_path / "fields.npz")
    root = ElementTree.parse(tmp_path / "fields.vti").getroot()
    image = root.find("ImageData")
    assert image is not None
    x, y, z = found.shape
    assert image.get("WholeExtent") == f"0 {x} 0 {y} 0 {z}"
    assert [float(each) for each in image.attrib["Spacing"].split()] == found.cell.tolist()
    stored = np.load(tmp_path / "fields.npz")
    names = set()
    for array in image.iterfind("Piece/CellData/DataArray"):
        name, parts = array.attrib["Name"], int(array.get("NumberOfComponents", "1"))
        names.add(name)
        raw = base64.b64decode(array.text or "")
        assert int.from_bytes(raw[:8], "little") == len(raw) - 8
        values = np.frombuffer(raw[8:], "<f8").reshape(z, y, x, parts)
        expected = stored[name].reshape(x, y, z, parts).transpose(2, 1, 0, 3)
        assert np.array_equal(values, expected, equal_nan=True), name
    assert names == set(found.arrays)


@pytest.mark.slow  # matplotlib takes 3 s to import
@pytest.mark.needs("matplotlib")
def test_the_picture_has_a_panel_for_each_field_with_its_unit(cloud: Recording, tmp_path: Path) -> None:
    carom.fields(cloud, "4r", output=tmp_path / "fields.svg")
    text = (tmp_path / "fields.svg").read_text(encoding="utf-8")
    for label in ("solid fraction", "velocity (m/s)", "pressure of contacts (Pa)", "mean of 0 to 1 s and over"):
        assert label in text


def test_the_command_writes_a_file_and_says_what_it_averaged(cloud: Recording, tmp_path: Path) -> None:
    done = command("fields", str(cloud.path), "--cell", "4r", "-o", "f.vti", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("f.vti written: 3 × 3 × 4 cells") and "40 moving bodies, 0 to 1 s." in done.stdout
    done = command("fields", str(cloud.path), "--cell", "4r", "-o", "f.vti", "--json", "-f", cwd=tmp_path)
    document = json.loads(done.stdout)
    assert document["shape"] == [3, 3, 4] and document["bodies"] == 40
    assert document["fields"]["contact_stress"] == "Pa"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--cell", "wide"), "expected a length above 0"),
        (("--cell", "0"), "expected a length above 0"),
        (("--cell", "-1r"), "expected a length above 0"),
        (("--cell", "1e300"), "expected a length above 0"),
        (("--cell", "3 kg"), "expected a length above 0"),
        (("--cell", "0.001r"), "at most 2000000 fit"),
        (("--from", "5"), "has no frame from"),
        (("--from", "0.8", "--to", "0.2"), "from 0.8 to 0.2 s: the end is before the start"),
        (("-o", "f.vtu"), 'the format ".vtu" is unknown'),
        (("--from", "0.005", "--to", "0.015"), "has no exact velocities from"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(
    cloud: Recording, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    done = command("fields", str(cloud.path), "-o", "f.vti", *arguments, cwd=tmp_path)
    assert done.returncode == 2 and message in done.stderr and "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


class Pressed:
    """Another engine's ball of 2 kg that is pressed to a plane with 6 N, and rubs on it with 3 N."""

    def __init__(self) -> None:
        plane = carom.record.Plane((0.0, 0.0, 1.0), 0.0)
        self.model = carom.record.Model(engine="pressed", mass=[2.0], radius=[0.5], planes=[plane])
        self.step = 0

    def state(self) -> carom.record.State:
        contacts = np.zeros(1, carom.record.CONTACT)
        contacts["i"], contacts["j"], contacts["point"], contacts["normal"] = 0, 1, [0.2, 0.3, 0.0], [0.0, 0.0, -1.0]
        contacts["force"], contacts["friction"] = 6.0, [3.0, 0.0, 0.0]
        return carom.record.State(0.1 * self.step, [[0.2, 0.3, 0.5]], [[0.0, 0.0, 0.0]], contacts=contacts)


def test_the_stress_of_another_engine_has_its_friction(tmp_path: Path) -> None:
    pressed = Pressed()
    with carom.record.Recorder(pressed, tmp_path / "run.rrd") as recorder:
        for pressed.step in range(1, 20):
            recorder.frame()
    found = carom.fields(Recording.open(tmp_path / "run.rrd"), 1.0)
    # ℓ = -0.5 m along z, and the forces on the plane are -6 N along z and 3 N along x
    expected = np.zeros((3, 3))
    expected[2] = -0.5 * 3.0, 0.0, 0.5 * 6.0
    assert integral(found, found.contact_stress) == pytest.approx(expected, abs=10 * SINGLE)


def test_a_recording_without_contacts_has_the_fields_of_its_bodies_and_says_what_is_missing(tmp_path: Path) -> None:
    balls = [{"position": [x, 0.0, 0.0], "velocity": [-x, 0.0, 0.0], "radius": 0.5, "mass": 1.0} for x in (-1.0, 1.0)]
    scene = scene_of(balls, time={"duration": 1.0}, record={"every": "step", "impacts": "none"})
    found = carom.fields(carom.run(scene, tmp_path / "run.rrd"), 1.0)
    assert np.isnan(found.contact_stress).all() and np.isnan(found.coordination).all()
    assert integral(found, found.density) == pytest.approx(2.0)
    assert "has no contacts" in found.notes[0] and "--replay" in found.notes[0]


def test_fixed_bodies_are_boundaries(tmp_path: Path) -> None:
    balls: list[dict[str, Any]] = [{"position": [0.0, 0.0, z], "radius": 0.5, "mass": 1.0} for z in (0.0, 1.0)]
    balls[0]["fixed"] = True
    field = {"constant": 0.0, "uniform": [0.0, 0.0, -1.0]}
    scene = scene_of(balls, gravity=field, time={"duration": 0.2, "fixed_dt": 0.01}, contact={"restitution": 0.0})
    recording = carom.run(scene, tmp_path / "run.rrd")
    found = carom.fields(recording, 2.0, start=0.1)
    assert integral(found, found.density) == pytest.approx(1.0)
    # the weight over the half of the distance that is in the ball which moves
    assert integral(found, found.contact_stress)[2, 2] == pytest.approx(0.5, abs=SINGLE)
    fixed = scene_of([{**ball, "fixed": True} for ball in balls], time={"duration": 0.02, "fixed_dt": 0.01})
    with pytest.raises(RecordingError, match="all bodies are fixed"):
        carom.fields(carom.run(fixed, tmp_path / "fixed.rrd"))
