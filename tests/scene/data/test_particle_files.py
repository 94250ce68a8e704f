"""Files of LAMMPS, LIGGGHTS, OVITO and ASE; samples/ has one of each kind."""

from __future__ import annotations

import base64
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from data_scenes import SAMPLES, refusal, scene_of

NO_GRAVITY = 'units = "dimensionless"\ngravity.constant = 0'


def test_a_dump_is_read_at_a_step_in_the_order_of_its_ids(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "granular.lammpstrj")
    bodies = scene.data[0]
    assert bodies.position[:, 0].tolist() == [0.1, 0.35] and bodies.velocity[:, 2].tolist() == [-1.0, 0.0]
    assert bodies.angular_velocity[1].tolist() == [0.0, 0.0, 2.5] and bodies.mass.tolist() == [0.001, 0.002]
    assert scene.notes[0][0] == "granular.lammpstrj: step 1000 of LAMMPS"
    assert "its box of 1 × 1 × 2 is periodic along x and y, which is ignored" in scene.notes[0][-1]
    assert scene.notes[0][-1].endswith('set domain.boundary = ["periodic", "periodic", "open"] for that')
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
    assert "line 10 has 4 values (1 1 0.75 0.125), but there are 5 columns" in refusal(tmp_path, "uneven.dump")
    (tmp_path / "many.dump").write_text(text.replace("ATOMS\n1\n", "ATOMS\n999999999999\n"))
    assert "999999999999 rows are too many" in refusal(tmp_path, "many.dump")


ATOM = "1 1 0.5 0 0 3 0 0 0.1 2.5"
# sizes of the units of length (m), time (s) and mass (kg), from the page of LAMMPS's command `units`
LAMMPS_UNITS = {
    "si": (1.0, 1.0, 1.0),
    "cgs": (1e-2, 1.0, 1e-3),
    "micro": (1e-6, 1e-6, 1e-15),
    "nano": (1e-9, 1e-9, 1e-21),
    "real": (1e-10, 1e-15, 1.66053906660e-27),
    "metal": (1e-10, 1e-12, 1.66053906660e-27),
}


def dump_in(units: str, steps: int = 1) -> str:
    """Return a dump with the lines that LAMMPS writes before each step, the units once."""
    head = "ITEM: NUMBER OF ATOMS\n1\nITEM: BOX BOUNDS ff ff ff\n0 1\n0 1\n0 1\n"
    rows = f"ITEM: ATOMS id type x y z vx vy vz radius mass\n{ATOM}\n"
    each = [f"ITEM: TIME\n{0.1 * step}\nITEM: TIMESTEP\n{step}\n{head}{rows}" for step in range(steps)]
    return f"ITEM: UNITS\n{units}\n" + "".join(each)


@pytest.mark.parametrize("units", LAMMPS_UNITS)
def test_a_dump_has_the_units_of_its_first_line(tmp_path: Path, units: str) -> None:
    (tmp_path / "a.dump").write_text(dump_in(units, steps=2))
    length, time, mass = LAMMPS_UNITS[units]
    bodies = scene_of(tmp_path, "a.dump").data[0]
    assert bodies.mass[0] == pytest.approx(2.5 * mass, rel=1e-12)
    assert bodies.radius[0] == pytest.approx(0.1 * length, rel=1e-12)
    assert bodies.velocity[0, 0] == pytest.approx(3.0 * length / time, rel=1e-12)


def test_a_dump_in_reduced_units_asks_what_they_are(tmp_path: Path) -> None:
    (tmp_path / "a.dump").write_text(dump_in("lj"))
    assert 'write units = "dimensionless" at the top of the scene' in refusal(tmp_path, "a.dump")
    assert scene_of(tmp_path, "a.dump", top=NO_GRAVITY).data[0].mass[0] == 2.5
    own = '[units]\nlength = "cm"\ntime = "ms"\nmass = "g"'
    assert scene_of(tmp_path, "a.dump", top=own).data[0].mass[0] == pytest.approx(2.5e-3)
    (tmp_path / "a.dump").write_text(dump_in("electron"))
    assert "units electron of LAMMPS, which carom does not know" in refusal(tmp_path, "a.dump")


def test_a_data_file_has_the_units_of_its_title(tmp_path: Path) -> None:
    text = (SAMPLES / "sphere.data").read_text().partition("\n")[2]
    title = "LAMMPS data file via write_data, version 4 Feb 2025, timestep = 0, units = "
    (tmp_path / "a.data").write_text(f"{title}cgs\n{text}")
    assert scene_of(tmp_path, "a.data").data[0].radius.tolist() == [0.05e-2, 0.1e-2]
    (tmp_path / "a.data").write_text(f"{title}si\n{text}")
    assert scene_of(tmp_path, "a.data").data[0].radius.tolist() == [0.05, 0.1]


def test_a_box_that_is_periodic_at_both_ends_by_one_letter_is_said(tmp_path: Path) -> None:
    text = dump_in("si").replace("BOUNDS ff ff ff", "BOUNDS p ff pp")
    (tmp_path / "a.dump").write_text(text)
    assert "is periodic along x and z" in " ".join(scene_of(tmp_path, "a.dump").notes[0])


@pytest.mark.parametrize(
    ("file", "limit"),
    [
        ("large.txt", "orbit_tables._LARGEST"),
        ("large.mpcorb", "orbit_tables._LARGEST_TABLE"),
        ("large.vtp", "vtk_tables._LARGEST"),
    ],
)
def test_a_file_above_the_limit_of_its_format_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, limit: str
) -> None:
    (tmp_path / file).write_text("$$SOE\n")
    monkeypatch.setattr(f"carom.scene.data.{limit}", 5)
    assert f"{file}: the file has 6 bytes, which are too many; at most 5" in refusal(tmp_path, file)


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
    assert "momenta 0, momenta 1, momenta 2 may hold the velocity" in refusal(tmp_path, "ase.xyz", "", NO_GRAVITY)
    named = scene_of(tmp_path, "ase.xyz", "velocity = [0, 0, 0]", NO_GRAVITY)
    assert named.data[0].mass.tolist() == [39.948, 39.948] and named.data[0].radius.tolist() == [1.88, 1.88]
    assert "its box of 8 × 8 × 8 is periodic" in named.notes[0][-1] and "momenta 0, momenta 1" in named.notes[0][-2]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3\nwater\nO 0 0 0\nH 1 0 0\n", "the step from line 1 on has 2 of its 3 rows"),
        ("1\nfirst\nO 0 0 0\nmany\n", "line 4 is many, but the number of rows is needed"),
        ("1\nProperties=pos:R:3:mass\n0 0 0 1\n", "does not name columns, such as pos:R:3"),
        ("99999999999\nbomb\nO 0 0 0\n", "99999999999 rows are too many"),
        ("2\nuneven\nO 0 0 0\nH 1 1\n", "line 4 has 3 values (H 1 1), but there are 4 columns"),
    ],
)
def test_an_xyz_that_is_damaged_is_refused_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.xyz").write_text(text, encoding="utf-8")
    assert said in refusal(tmp_path, "a.xyz", "mass = 1\nradius = 1")


LIGGGHTS_VTK = """# vtk DataFile Version 2.0
Generated by LIGGGHTS
ASCII
DATASET POLYDATA
POINTS 2 float
0.1 0.2 0.3 0.4
0.5 0.6
VERTICES 2 4
1 0
1 1
POINT_DATA 2
VECTORS v float
1 0 0
0 1 0
SCALARS radius float 1
LOOKUP_TABLE default
0.05 0.06
SCALARS mass float 1
LOOKUP_TABLE default
0.001
0.002
"""


def test_a_vtk_of_liggghts_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.vtk").write_text(LIGGGHTS_VTK)
    bodies = scene_of(tmp_path, "a.vtk").data[0]
    assert bodies.position.tolist() == [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]
    assert bodies.velocity[1].tolist() == [0.0, 1.0, 0.0] and bodies.mass.tolist() == [0.001, 0.002]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("POINTS 2 float", "POINTS 2000000 float", "6000000 values of the type float are announced"),
        ("POINTS 2 float", "POINTS 999999999999 float", "999999999999 rows are too many"),
        ("POLYDATA", "STRUCTURED_GRID", "a dataset STRUCTURED_GRID; points are needed"),
        ("SCALARS mass float", "SCALARS mass bit", "values of the type bit are not read"),
        ("0.001\n0.002\n", "0.001\n", "1 of 2 values; the file ends early"),
        ("# vtk", "# vrml", 'a VTK file begins with "# vtk DataFile Version"'),
    ],
)
def test_a_vtk_that_is_damaged_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    (tmp_path / "a.vtk").write_text(LIGGGHTS_VTK.replace(old, new))
    assert said in refusal(tmp_path, "a.vtk")


POINTS, MASSES = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 1.0 / 3.0]]), np.array([1.0, 2.0], np.float32)


def vtp(form: str, compressed: bool = False) -> bytes:
    """Return a VTP file as ParaView writes it."""

    def packed(values: NDArray[Any], raw: bool) -> bytes:
        data = values.tobytes()
        if compressed:
            block = zlib.compress(data)
            head = struct.pack("<4I", 1, len(data), len(data), len(block))
            return head + block if raw else base64.b64encode(head) + base64.b64encode(block)
        content = struct.pack("<I", len(data)) + data
        return content if raw else base64.b64encode(content)

    appended = packed(POINTS, True)

    def array(values: NDArray[Any], attributes: str, offset: int) -> str:
        kind = f"Float{8 * values.itemsize}"
        if form == "appended":
            return f'<DataArray type="{kind}" {attributes} format="appended" offset="{offset}"/>'
        text = " ".join(map(repr, values.ravel().tolist())) if form == "ascii" else packed(values, False).decode()
        return f'<DataArray type="{kind}" {attributes} format="{form}">\n{text}\n</DataArray>'

    points, masses = array(POINTS, 'NumberOfComponents="3"', 0), array(MASSES, 'Name="mass"', len(appended))
    head = ' compressor="vtkZLibDataCompressor"' if compressed else ""
    text = (
        f'<?xml version="1.0"?>\n<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian"{head}><PolyData>'
        f'<Piece NumberOfPoints="2"><Points>{points}</Points>'
        f"<PointData>{masses}</PointData></Piece></PolyData>"
    ).encode()
    if form == "appended":
        text += b'<AppendedData encoding="raw">\n_' + appended + packed(MASSES, True) + b"</AppendedData>"
    return text + b"</VTKFile>"


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("form", ["ascii", "binary", "appended"])
def test_a_vtp_of_paraview_is_read(tmp_path: Path, form: str, compressed: bool) -> None:
    (tmp_path / "a.vtp").write_bytes(vtp(form, compressed))
    bodies = scene_of(tmp_path, "a.vtp", "radius = 0.5").data[0]
    assert np.array_equal(bodies.position, POINTS) and bodies.mass.tolist() == [1.0, 2.0]


def test_a_vtp_that_is_damaged_or_a_bomb_is_refused(tmp_path: Path) -> None:
    entity = b'<!DOCTYPE a [<!ENTITY b "bbbb">]><VTKFile type="PolyData">'
    many = vtp("binary", True).replace(b'NumberOfPoints="2"', b'NumberOfPoints="2000000"')
    piece = many[many.index(b"<Piece") : many.index(b"</Piece>") + len(b"</Piece>")]
    masses = many[many.index(b"<PointData>") + len(b"<PointData>") : many.index(b"</PointData>")]
    for content, said in (
        (vtp("ascii").replace(b'<VTKFile type="PolyData"', entity), "declares a document type or an entity"),
        (many.replace(piece, 2 * piece), "4000000 rows in"),  # together, since pieces may share their data
        (many.replace(masses, 30 * masses), "would take 288000000 bytes of memory"),
        (vtp("appended")[:-60], "values, but "),
        (vtp("binary").replace(b"PolyData", b"ImageData"), "of the type ImageData; points are needed"),
    ):
        (tmp_path / "a.vtp").write_bytes(content)
        assert said in refusal(tmp_path, "a.vtp", "radius = 0.5"), said


@pytest.mark.needs("gsd")
def test_a_gsd_of_hoomd_is_read_at_a_frame(tmp_path: Path) -> None:
    import gsd.hoomd

    with gsd.hoomd.open(str(tmp_path / "a.gsd"), "w") as file:
        for step in (0, 1000):
            frame = gsd.hoomd.Frame()
            frame.configuration.step = step
            frame.configuration.box = [10, 10, 20, 0, 0, 0]
            frame.particles.N = 2
            frame.particles.position = [[0, 0, 0], [3, 0, step / 4000]]
            frame.particles.diameter = [2.0, 1.0]
            frame.particles.mass = [5.0, 5.0]
            file.append(frame)
    scene = scene_of(tmp_path, "a.gsd", "", NO_GRAVITY)
    assert scene.data[0].position[1].tolist() == [3.0, 0.0, 0.25] and scene.data[0].radius.tolist() == [1.0, 0.5]
    assert scene.data[0].mass.tolist() == [5.0, 5.0]  # which the file has in its first frame only
    assert "frame 1 of HOOMD, step 1000, in single precision" in scene.notes[0][0]
    assert "box of 10 × 10 × 20 is periodic" in scene.notes[0][-1]
    assert "it has 2" in refusal(tmp_path, "a.gsd", "snapshot = 2")
    (tmp_path / "b.gsd").write_bytes((tmp_path / "a.gsd").read_bytes()[:300])
    assert "b.gsd: not a GSD file, or damaged" in refusal(tmp_path, "b.gsd")


def write_snapshot(path: Path, **header: Any) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        attributes = {"NumPart_ThisFile": [2, 3, 0, 0, 1, 0], "MassTable": [0.0, 7.0, 0.0, 0.0, 0.0, 0.0]}
        file.create_group("Header").attrs.update(attributes | {"NumFilesPerSnapshot": 1, "BoxSize": 0.0} | header)
        for kind, count in ((0, 2), (1, 3), (4, 1)):
            group = file.create_group(f"PartType{kind}")
            group["Coordinates"] = np.arange(3.0 * count).reshape(count, 3) + 100.0 * kind
            group["Velocities"] = np.full((count, 3), float(kind))
            if kind != 1:
                group["Masses"] = np.full(count, kind + 1.0)
        file["PartType0/Density"] = [0.5, 0.25]


@pytest.mark.needs("h5py")
def test_a_snapshot_of_gadget_has_the_particles_of_all_types_with_masses_from_its_header(tmp_path: Path) -> None:
    write_snapshot(tmp_path / "snapshot.hdf5", BoxSize=50.0)
    scene = scene_of(tmp_path, "snapshot.hdf5", "radius = 0.01", NO_GRAVITY)
    bodies = scene.data[0]
    assert bodies.mass.tolist() == [1.0, 1.0, 7.0, 7.0, 7.0, 5.0]
    assert bodies.position[:, 0].tolist() == [0.0, 3.0, 100.0, 103.0, 106.0, 400.0]
    assert bodies.velocity[:, 2].tolist() == [0.0, 0.0, 1.0, 1.0, 1.0, 4.0]
    said = "\n".join(scene.notes[0])
    assert (
        "particles 2 of type 0, 3 of type 1 of mass 7, 1 of type 4" in said
        and "box of 50 × 50 × 50 is periodic" in said
    )


@pytest.mark.needs("h5py")
def test_one_type_of_a_snapshot_is_read_by_the_paths_of_its_datasets(tmp_path: Path) -> None:
    write_snapshot(tmp_path / "snapshot.hdf5")
    columns = {"position": "Coordinates", "velocity": "Velocities", "mass": "Masses"}
    named = ", ".join(f'{quantity} = "PartType4/{name}"' for quantity, name in columns.items())
    bodies = scene_of(tmp_path, "snapshot.hdf5", f"columns = {{ {named} }}\nradius = 0.01", NO_GRAVITY).data[0]
    assert bodies.mass.tolist() == [5.0] and bodies.position[0, 0] == 400.0


@pytest.mark.needs("h5py")
def test_a_part_of_a_snapshot_is_refused_and_comoving_numbers_are_said(tmp_path: Path) -> None:
    write_snapshot(tmp_path / "part.hdf5", NumFilesPerSnapshot=4)
    assert "one of the 4 files of a snapshot" in refusal(tmp_path, "part.hdf5", "radius = 1")
    write_snapshot(tmp_path / "comoving.hdf5", Omega0=0.3)
    notes = scene_of(tmp_path, "comoving.hdf5", "radius = 0.01", NO_GRAVITY).notes[0]
    assert any("its lengths are comoving" in note for note in notes)


def test_hostile_particle_files_are_refused_before_they_are_parsed(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    head = "title\n\n{} atoms\n1 atom types\n\nAtoms # sphere\n\n1 1 1.0 1.0 0 0 0\n"
    (tmp_path / "many.data").write_text(head.format(10**12), encoding="utf-8")
    assert "1000000000000 rows are too many" in refusal(tmp_path, "many.data")
    (tmp_path / "short.data").write_text(head.format(3), encoding="utf-8")
    assert "its header states 3 atoms, but its section Atoms has 1" in refusal(tmp_path, "short.data")
    (tmp_path / "lines.data").write_text(head.format(1) + "\n" * 50_000, encoding="utf-8")
    assert "50008 lines are too many for 1 stated atoms" in refusal(tmp_path, "lines.data")
    (tmp_path / "title.data").write_text("title\n", encoding="utf-8")
    assert 'no line such as "100 atoms" in its header' in refusal(tmp_path, "title.data")
    (tmp_path / "deep.vtp").write_text("<a>" * 200_000, encoding="utf-8")
    assert "more than 100000 tags" in refusal(tmp_path, "deep.vtp")
    with h5py.File(tmp_path / "deep.h5", "w") as file:
        file.create_group("/".join(["group"] * 300))
    assert "paths too long to be read" in refusal(tmp_path, "deep.h5")
