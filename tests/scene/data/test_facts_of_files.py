"""What a file states beside its columns counts: units, angles, frames, epochs, boxes, in every format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from carom.scene.data.body_columns import BodyColumns
from carom.scene.load import Scene
from data_scenes import refusal, scene_of

AU, DAY = 149597870700.0, 86400.0
EARTH, EARTH_RADIUS = 3.986004e14 / 6.6743e-11, 6.3781e6  # kg, m; nominal values of the IAU (2015)
SUN, SUN_RADIUS = 1.3271244e20 / 6.6743e-11, 6.957e8
KPC = 1000.0 * AU * 648000.0 / np.pi

LAMMPS_DATA = """LAMMPS data file via write_data, version 4 Feb 2025, timestep = 0, units = {units}

1 atoms
1 atom types

Atoms # sphere

1 1 0.4 2.5 4 2 4.416 0 0 0

Velocities

1 0 0 100 0 0 0
"""
LAMMPS_DUMP = """ITEM: UNITS
{units}
ITEM: TIMESTEP
0
ITEM: NUMBER OF ATOMS
1
ITEM: BOX BOUNDS pp pp ff
0 8
0 4
0 8
ITEM: ATOMS id type x y z vx vy vz radius density
1 1 4 2 4.416 0 0 100 0.2 2.5
"""
ECSV = """# %ECSV 1.0
# ---
# datatype:
# - {name: name, datatype: string}
# - {name: x, unit: cm, datatype: float64, description: 'along, the radius'}
# - {name: y, unit: cm, datatype: float64}
# - {name: z, unit: cm, datatype: float64}
# - {name: vz, unit: cm / s, datatype: float64}
# - {name: vx, unit: cm / s, datatype: float64}
# - {name: vy, unit: cm / s, datatype: float64}
# -
#   name: mass
#   unit: g
#   datatype: float64
# - {name: radius, unit: mm, datatype: float64}
# schema: astropy-2.0
name x y z vz vx vy mass radius
A 4 2 4.416 100 0 0 0.08377580409572782 2
"""
VTU = """<VTKFile type="UnstructuredGrid" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="1"><PointData>
<DataArray type="Float64" Name="linVelVec" NumberOfComponents="3" format="ascii">0 0 1</DataArray>
<DataArray type="Float64" Name="mass [g]" format="ascii">0.08377580409572782</DataArray>
<DataArray type="Float64" Name="radii [mm]" format="ascii">2</DataArray>
</PointData><Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">0.04 0.02 0.04416</DataArray>
</Points></Piece></UnstructuredGrid></VTKFile>
"""
VTK = """# vtk DataFile Version 4.2
grains
ASCII
DATASET POLYDATA
POINTS 1 float
0.04 0.02 0.04416
CELL_DATA 2
SCALARS contacts int
LOOKUP_TABLE default
3 4
POINT_DATA 1
SCALARS radius/mm float
LOOKUP_TABLE default
2
SCALARS mass/g float
LOOKUP_TABLE default
0.08377580409572782
VECTORS velocity float
0 0 1
"""
XYZ = """1
Properties=species:S:1:pos:R:3:velocities:R:3:radius_mm:R:1:mass_g:R:1
A 0.04 0.02 0.04416 0 0 1 2 0.08377580409572782
"""
HEADER = "x_cm,y_cm,z_cm,vx_cms,vy_cms,vz_cms,mass_g,radius_mm"
ISO = "x/cm,y/cm,z/cm,vx/(cm/s),vy/(cm/s),vz/(cm/s),m/g,r/mm"
VALUES = (4.0, 2.0, 4.416, 0.0, 0.0, 100.0, 0.08377580409572782, 2.0)
ROW = ",".join(map(repr, VALUES))


def parquet(path: Path) -> None:
    """Write a Parquet file with units in the metadata of its columns."""
    names = [part.partition("/")[0] for part in ISO.split(",")]
    units = ("cm", "cm", "cm", "cm/s", "cm/s", "cm/s", "g", "mm")
    fields = [pa.field(name, pa.float64(), metadata={"unit": text}) for name, text in zip(names, units, strict=True)]
    pq.write_table(pa.table([[value] for value in VALUES], schema=pa.schema(fields)), path)


def hdf5(path: Path) -> None:
    """Write an HDF5 file with units as AMUSE, unyt and H5MD have them."""
    import h5py

    with h5py.File(path, "w") as file:
        arrays = (
            ("position", VALUES[:3], "units", "cm"),
            ("velocity", VALUES[3:6], "unit", "cm s-1"),
            ("mass", VALUES[6], "units", b"g"),
            ("radius", VALUES[7], "units", "0.1 * cm"),
        )
        for name, value, key, text in arrays:
            file[f"particles/1/attributes/{name}"] = [value]
            file[f"particles/1/attributes/{name}"].attrs[key] = text if name != "radius" else "mm"


# A steel-like sphere of 4 mm in cgs units; the same in each format. LAMMPS' units are those of its command `units`.
SPHERES: dict[str, str | Callable[[Path], None]] = {
    "a.data": LAMMPS_DATA.format(units="cgs"),
    "a.dump": LAMMPS_DUMP.format(units="cgs"),
    "a.ecsv": ECSV,
    "ecsv.txt": ECSV,
    "suffix.csv": f"{HEADER}\n{ROW}\n",
    "iso.csv": f"{ISO}\n{ROW}\n",
    "a.vtu": VTU,
    "a.vtk": VTK,
    "a.xyz": XYZ,
    "a.parquet": parquet,
    "a.h5": hdf5,
}


def written(path: Path, content: str | Callable[[Path], None]) -> str:
    """Write a file, and return its name."""
    if callable(content):
        content(path)
    else:
        path.write_text(content, encoding="utf-8")
    return path.name


ASTRONOMICAL = 'units = "au, day, M_sun"\ngravity.constant = 0'
UNSTATED = ("a.vtu", "a.vtk", "a.xyz")  # their positions are in the units of the scene


@pytest.mark.parametrize(
    ("file", "top"),
    [
        pytest.param(file, top, marks=pytest.mark.needs("h5py") if file == "a.h5" else ())
        for top in ("", ASTRONOMICAL)
        for file in SPHERES
        if not (top and file in UNSTATED)
    ],
)
def test_a_sphere_in_cgs_units_is_the_same_in_every_format(tmp_path: Path, file: str, top: str) -> None:
    written(tmp_path / file, SPHERES[file])
    body = scene_of(tmp_path, file, top=top).data[0]
    length, time, mass = (AU, DAY, SUN) if top else (1.0, 1.0, 1.0)
    np.testing.assert_allclose(body.position[0] * length, [0.04, 0.02, 0.04416], rtol=1e-14)
    np.testing.assert_allclose(body.velocity[0] * length / time, [0.0, 0.0, 1.0], rtol=1e-14)
    np.testing.assert_allclose(body.radius[0] * length, 0.002, rtol=1e-14)
    np.testing.assert_allclose(body.mass[0] * mass, 2500.0 * np.pi * 4.0 / 3.0 * 0.002**3, rtol=1e-14)


def npz(path: Path) -> None:
    np.savez(path, position=[VALUES[:3]], velocity=[VALUES[3:6]], mass=[VALUES[6]], radius=[0.1 * VALUES[7]])


def gsd(path: Path) -> None:
    """Write a file of HOOMD, whose units are those of its user ("Units", documentation of HOOMD-blue)."""
    import gsd.hoomd

    with gsd.hoomd.open(str(path), "w") as file:
        frame = gsd.hoomd.Frame()
        frame.particles.N = 1
        frame.particles.position, frame.particles.velocity = [VALUES[:3]], [VALUES[3:6]]
        frame.particles.mass, frame.particles.diameter = [VALUES[6]], [0.2 * VALUES[7]]
        frame.configuration.box = [10, 10, 10, 0, 0, 0]
        file.append(frame)


def mercury(path: Path) -> None:
    """Write a file of MercuryDPM, whose units are those of its user; it has no masses."""
    x, y, z, *velocity, _, radius = VALUES
    numbers = (x, y, z, *velocity, 0.1 * radius, *[0.0] * 6, 0)
    path.write_text(f"1 0 0 0 0 8 4 8\n{' '.join(map(repr, numbers))}\n", encoding="utf-8")


@pytest.mark.parametrize(("units", "length", "mass"), [("g, cm, s", "cm", "g"), ("kg, m, s", "m", "kg")])
@pytest.mark.parametrize(
    ("file", "write"), [("a.npz", npz), pytest.param("a.gsd", gsd, marks=pytest.mark.needs("gsd")), ("a.data", mercury)]
)
def test_a_file_that_states_no_units_is_in_those_of_the_scene_and_a_note_says_so(
    tmp_path: Path, file: str, write: Callable[[Path], None], units: str, length: str, mass: str
) -> None:
    write(tmp_path / file)
    more = f'density = "2.5 {mass}/{length}^3"' if write is mercury else ""
    scene = scene_of(tmp_path, file, more, f'units = "{units}"')
    body, notes = scene.data[0], " ".join(scene.notes[0])
    single = 1e-6  # GSD has numbers of 32 bits
    np.testing.assert_allclose(body.position[0], VALUES[:3], rtol=single)
    np.testing.assert_allclose(body.velocity[0], VALUES[3:6], rtol=single)
    np.testing.assert_allclose(body.radius[0], 0.1 * VALUES[7], rtol=single)
    np.testing.assert_allclose(body.mass[0], VALUES[6], rtol=single)
    assert f"(2 to 4.416 {length})" in notes and (write is mercury or f"(0.0837758 {mass})" in notes)


@pytest.mark.parametrize("units", ["real", "metal"])
def test_densities_of_lammps_in_atomic_units_are_in_grams_per_cubic_centimetre(tmp_path: Path, units: str) -> None:
    # the page of LAMMPS's command `units`: for real and metal, "density = gram/cm^dim"
    (tmp_path / "a.dump").write_text(LAMMPS_DUMP.format(units=units))
    assert scene_of(tmp_path, "a.dump").data[0].mass[0] == pytest.approx(2500.0 * np.pi * 4.0 / 3.0 * 2e-11**3)


def test_units_that_the_scene_adds_to_a_column_come_first(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z,mass,radius [furlong]\n0,0,0,2,3\n")
    said = refusal(tmp_path, "a.csv", 'columns = { radius = "radius [furlong]" }')
    assert "furlong is not a unit that carom knows" in said and 'radius = "radius [furlong] [m]"' in said
    more = 'columns = { mass = "mass [g]", radius = "radius [furlong] [km]" }'
    scene = scene_of(tmp_path, "a.csv", more)
    assert scene.data[0].mass.tolist() == [2e-3] and scene.data[0].radius.tolist() == [3e3]
    assert "mass from mass [g] (0.002 kg)" in scene.notes[0][0]


def test_columns_of_the_exoplanet_archive_are_in_earths(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x (au),y (au),z (au),pl_masse (Mearth),pl_rade (Rearth)\n1,0,0,2,3\n")
    names = 'columns = { mass = "pl_masse (Mearth)", radius = "pl_rade (Rearth)" }'
    body = scene_of(tmp_path, "a.csv", names).data[0]
    assert body.mass[0] == pytest.approx(2.0 * EARTH, rel=1e-15) and body.radius.tolist() == [3.0 * EARTH_RADIUS]


@pytest.mark.needs("h5py")
def test_units_of_amuse_are_those_of_its_attributes(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        group = file.create_group("particles/0000000001/attributes")
        for name, value, text in (
            *((axis, 1.0, "kpc") for axis in "xyz"),
            *((f"v{axis}", 10.0, "km * s**-1") for axis in "xyz"),
            ("mass", 1.0, "MSun"),
            ("radius", 1.0, "RSun"),
        ):
            group[name] = [value]
            group[name].attrs["units"] = text
    body = scene_of(tmp_path, "a.hdf5").data[0]
    assert body.position[0, 0] == pytest.approx(KPC, rel=1e-15) and body.velocity.tolist() == [[1e4, 1e4, 1e4]]
    assert body.mass[0] == pytest.approx(SUN, rel=1e-15) and body.radius.tolist() == [SUN_RADIUS]
    with h5py.File(tmp_path / "a.hdf5", "a") as file:
        file["particles/0000000001/attributes/mass"].attrs["units"] = "code_mass"
    assert "code_mass is not a unit that carom knows" in refusal(tmp_path, "a.hdf5")


@pytest.mark.needs("h5py")
def test_one_set_of_an_amuse_file_with_several_saves_is_read_in_si(tmp_path: Path) -> None:
    """amuse.io.store writes units as ``to_simple_form().reference_string()``."""
    import h5py

    length, time = "system.get('S.I.').base('length')", "system.get('S.I.').base('time')"
    units = {"x": f"(1000.0 * {length})", "vx": f"({length} * ({time}**-1))", "mass": "system.get('S.I.').base('mass')"}
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        for number in (1, 2):
            group = file.create_group(f"particles/{number:010d}/attributes")
            for axis in "xyz":
                group[axis], group[f"v{axis}"] = [1.0 * number], [3.0]
                group[axis].attrs["units"], group[f"v{axis}"].attrs["units"] = units["x"], units["vx"]
            group["mass"], group["radius"] = [2.0], [4.0]
            group["mass"].attrs["units"], group["radius"].attrs["units"] = units["mass"], length
    scene = scene_of(tmp_path, "a.hdf5", top=ASTRONOMICAL)
    assert scene.data[0].position[0, 0] * AU == pytest.approx(2000.0)
    assert scene.data[0].velocity[0, 0] * AU / DAY == pytest.approx(3.0)
    assert "particles/0000000002 is read, set 1 of 2 (from 0)" in scene.notes[0][0]
    assert scene_of(tmp_path, "a.hdf5", "snapshot = 0").data[0].position[0, 0] == 1000.0


@pytest.mark.needs("h5py")
def test_an_h5md_is_read_at_a_step_in_its_units(tmp_path: Path) -> None:
    """H5MD 1.1: an element is a group with value (steps, n, 3), step and time; value has the attribute unit."""
    import h5py

    with h5py.File(tmp_path / "a.h5md", "w") as file:
        for name, unit in (("position", "nm"), ("velocity", "nm ps-1"), ("force", "kJ mol-1 nm-1")):
            group = file.create_group(f"particles/all/{name}")
            group["value"] = np.arange(12.0).reshape(2, 2, 3)
            group["value"].attrs["unit"] = unit
            group["time"], group["step"] = [0.0, 1.0], [0, 1]
    bodies = scene_of(tmp_path, "a.h5md", "mass = 1\nradius = 1e-10").data[0]
    np.testing.assert_allclose(bodies.position, np.arange(6.0, 12.0).reshape(2, 3) * 1e-9)
    np.testing.assert_allclose(bodies.velocity, np.arange(6.0, 12.0).reshape(2, 3) * 1e3)


@pytest.mark.needs("h5py")
@pytest.mark.parametrize(
    ("group", "h", "header"),
    [
        ("Header", 0.5, {"UnitLength_in_cm": 3e21, "UnitMass_in_g": 2e43, "UnitVelocity_in_cm_per_s": 1e5}),
        ("Header", 0.7, {"UnitLength_In_CGS": 3e21, "UnitMass_In_CGS": 2e43, "UnitVelocity_In_CGS": 1e5}),
        ("Parameters", 1.0, {"UnitLength_in_cm": 3e21, "UnitMass_in_g": 2e43, "UnitVelocity_in_cm_per_s": 1e5}),
        (
            "Units",
            1.0,
            {"Unit length in cgs (U_L)": [3e21], "Unit mass in cgs (U_M)": 2e43, "Unit time in cgs (U_t)": 3e16},
        ),
    ],
    ids=["Gadget-2, AREPO", "GIZMO", "Gadget-4", "SWIFT"],
)
def test_units_in_the_header_of_a_snapshot_count(tmp_path: Path, group: str, h: float, header: dict[str, Any]) -> None:
    """User guide for GADGET-2, section 5.2: UnitLength_in_cm is the unit "in cm/h", UnitMass_in_g "in g/h".

    GIZMO's own reader, load_from_snapshot.py, divides coordinates and masses by HubbleParam, and velocities not.
    """
    import h5py

    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        file.create_group("Header").attrs.update(
            {"NumPart_ThisFile": [0, 1], "MassTable": [0.0, 0.0047], "HubbleParam": h, "NumFilesPerSnapshot": 1}
        )
        file.require_group(group).attrs.update(header)
        file["PartType1/Coordinates"] = [[8.0, 0.0, 0.0]]
        file["PartType1/Velocities"] = [[0.0, 220.0, 0.0]]
    body = scene_of(tmp_path, "a.hdf5", 'radius = "1 pc"').data[0]
    assert body.position[0, 0] == pytest.approx(8.0 * 3e19 / h) and body.velocity[0, 1] == pytest.approx(220e3)
    assert body.mass[0] == pytest.approx(0.0047 * 2e40 / h)


def test_an_ending_that_is_a_word_is_no_unit(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z,vx_ms,vy_ms,vz_ms,mass_g,radius_in\n0,0,0,1,2,3,4,5\n")
    assert "no column for radius" in refusal(tmp_path, "a.csv")
    body = scene_of(tmp_path, "a.csv", "radius = 1").data[0]
    assert body.velocity.tolist() == [[1.0, 2.0, 3.0]] and body.mass.tolist() == [4e-3]


def test_a_ratio_in_the_name_of_a_column_is_not_its_last_part(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z,mass,h/r\n0,0,0,1,0.05\n")
    assert "no column for radius" in refusal(tmp_path, "a.csv")
    (tmp_path / "a.csv").write_text("x,y,z,q/m,radius\n0,0,0,1,0.05\n")
    assert "no column for mass" in refusal(tmp_path, "a.csv")


# --- angles and orbits

ORBITS = "name,m,a,e,inc,Omega,omega,M\nq,0,1,0,0,0,0,1.5707963267948966\n"
ABOUT = "radius = 1e-3\norbit = {{ central_mass = 1{} }}"
PLAIN = 'units = "au, day, M_sun"\ngravity.constant = 1\ncontact.enabled = false'


def orbiting(folder: Path, text: str, more: str = "", top: str = PLAIN) -> BodyColumns:
    """Read orbits."""
    (folder / "a.csv").write_text(text)
    return scene_of(folder, "a.csv", ABOUT.format(more), top).data[0]


def test_a_quarter_of_an_orbit_in_radians_is_asked_for_and_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(ORBITS)
    said = refusal(tmp_path, "a.csv", ABOUT.format(""), PLAIN)
    assert "inc, Omega, omega, M are all within ±2π" in said and 'orbit = { …, angle = "rad" }' in said
    quarter = orbiting(tmp_path, ORBITS, ', angle = "rad"').position[0]
    np.testing.assert_allclose(quarter, [0.0, 1.0, 0.0], atol=1e-15)
    units = '[units]\nlength = "au"\ntime = "day"\nmass = "M_sun"\nangle = "rad"\n[gravity]\nconstant = 1\n'
    scene = scene_of(tmp_path, "a.csv", ABOUT.format(""), f"contact.enabled = false\n{units}")
    np.testing.assert_allclose(scene.data[0].position[0], [0.0, AU, 0.0], atol=1e-4)
    assert "angles in rad" in scene.notes[0][0]
    suffix = ORBITS.replace("inc,Omega,omega,M", "inc_rad,Omega_rad,omega_rad,M_rad")
    np.testing.assert_allclose(orbiting(tmp_path, suffix).position[0], quarter, atol=1e-15)
    degrees = ORBITS.replace("inc,Omega,omega,M", "inc_deg,Omega_deg,omega_deg,M_deg").replace(
        "1.5707963267948966", "90"
    )
    np.testing.assert_allclose(orbiting(tmp_path, degrees).position[0], quarter, atol=1e-15)


def test_angles_that_cannot_be_radians_are_asked_for_in_a_scene_in_radians(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(ORBITS.replace("0,0,0,1.57", "0,280,0,1.57"))
    units = '[units]\nangle = "rad"\n'
    said = refusal(tmp_path, "a.csv", ABOUT.format(""), f"contact.enabled = false\n{units}")
    assert "which suggests degrees" in said and 'angle = "deg"' in said


def test_two_heavy_bodies_orbit_in_the_period_of_both_masses(tmp_path: Path) -> None:
    """Kepler's third law: n² a³ = G (M + m); at the pericentre, v² = G (M + m) (1 + e) / (a (1 - e))."""
    found = orbiting(tmp_path, "m,a,e,inc,Omega,omega,M\n0.5,1.0,0.3,0,0,0,0\n")
    assert found.velocity[0, 1] == pytest.approx(np.sqrt(1.5 * 1.3 / 0.7), rel=1e-15)


def test_a_pair_rests_about_its_barycentre_with_the_advised_central_body(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("m,a,e,inc,Omega,omega,M\n0.5,1.0,0.3,10,20,30,40\n")
    star = '[[body]]\nname = "star"\nmass = 1\nradius = 1e-3\n'
    bodies = 'radius = 1e-3\norbit = { central_body = "star" }\n'
    advice = scene_of(tmp_path, "a.csv", bodies + star, PLAIN).notes[0][-1]
    keys = advice.partition("if star has ")[2].replace(" and velocity", "\nvelocity")
    scene = scene_of(tmp_path, "a.csv", bodies + star + keys, PLAIN)
    resting, companion = scene.body[0], scene.data[0]
    np.testing.assert_allclose(resting.position + 0.5 * companion.position[0], 0.0, atol=1e-15)
    np.testing.assert_allclose(resting.velocity + 0.5 * companion.velocity[0], 0.0, atol=1e-15)
    heavier = Scene.load(tmp_path / "scene.toml", overrides=["body.0.mass=3"])
    alone = orbiting(tmp_path, (tmp_path / "a.csv").read_text())
    np.testing.assert_allclose(companion.position - resting.position, alone.position, atol=1e-15)
    np.testing.assert_allclose(
        np.linalg.norm(heavier.data[0].velocity - heavier.body[0].velocity),
        np.linalg.norm(alone.velocity) * np.sqrt(3.5 / 1.5),
    )
    assert '0 [[body]] are called "star"; there is none' in refusal(tmp_path, "a.csv", bodies, PLAIN)
    both = bodies.replace("{ central", "{ central_mass = 1, central")
    assert "either a central_mass or a central_body" in refusal(tmp_path, "a.csv", both + star, PLAIN)


def test_a_point_cloud_is_refused_with_the_way_to_convert_it(tmp_path: Path) -> None:
    for ending, remedy in (("ply", "save its points as .vtp or .csv"), ("pcd", "write it as .xyz")):
        (tmp_path / f"a.{ending}").write_text("ply\n")
        assert remedy in refusal(tmp_path, f"a.{ending}", "mass = 1\nradius = 1")


@pytest.mark.needs("rebound")
def test_rebound_has_the_same_orbit_of_a_heavy_body(tmp_path: Path) -> None:
    import rebound

    simulation = rebound.Simulation()
    simulation.add(m=1.0)
    simulation.add(m=0.4, a=1.0, e=0.3, inc=0.2, Omega=1.0, omega=2.0, M=3.0)
    found = orbiting(tmp_path, "m,a,e,inc,Omega,omega,M\n0.4,1.0,0.3,0.2,1,2,3\n", ', angle = "rad"')
    np.testing.assert_allclose(found.position[0], simulation.particles[1].xyz, atol=1e-14)
    np.testing.assert_allclose(found.velocity[0], simulation.particles[1].vxyz, atol=1e-14)


HORIZONS = """Target body name: {name} ({number})   {{source: DE441}}
Center body name: {centre}           {{source: DE441}}
Output units    : {units}
Reference frame : {frame}
***
 JDTDB, Calendar Date (TDB), X, Y, Z, VX, VY, VZ,
***
$$SOE
{epoch}, A.D. 2025-Jan-01, {values},
$$EOE
"""
IN_KM = {"units": "KM-S", "values": f"{AU / 1e3}, 0, 0, 0, 29.78, 0"}


def horizons(**changed: str) -> str:
    """Return a reply of Horizons with a body at 1 au."""
    usual = {
        "name": "Earth",
        "number": "399",
        "centre": "Sun (10)",
        "frame": "Ecliptic of J2000.0",
        "epoch": "2460676.5",
    }
    return HORIZONS.format(**usual | IN_KM | changed)


def test_bodies_of_horizons_in_two_units_are_read_in_both(tmp_path: Path) -> None:
    mars = horizons(name="Mars", units="AU-D", values="0, 1.5, 0, -0.0128, 0, 0")
    (tmp_path / "a.txt").write_text(horizons() + mars)
    bodies = scene_of(tmp_path, "a.txt", "radius = 1\nmass = 1").data[0]
    np.testing.assert_allclose(bodies.position, [[AU, 0.0, 0.0], [0.0, 1.5 * AU, 0.0]], rtol=1e-15)
    np.testing.assert_allclose(bodies.velocity, [[0.0, 29780.0, 0.0], [-0.0128 * AU / DAY, 0.0, 0.0]], rtol=1e-14)


JPL = "full_name,a,e,i,om,w,ma,epoch\n1 Ceres,2.77,0.0785,10.6,80.3,73.4,60.1,2460676.5\n"


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, ""),
        ({"frame": "ICRF"}, "its frame of reference is ecliptic of J2000, but ICRF in a.txt"),
        (
            {"epoch": "2451545.0"},
            "its epoch is JD 2460676.5, and the epoch of a.txt is JD 2451545; choose",
        ),
        ({"centre": "Solar System Barycenter (0)"}, "its centre is Sun, but Solar System Barycenter"),
    ],
    ids=["the same", "frame", "epoch", "centre"],
)
def test_frames_epochs_and_centres_of_the_files_of_a_scene_agree(
    tmp_path: Path, changed: dict[str, str], said: str
) -> None:
    (tmp_path / "a.txt").write_text(horizons(**changed))
    (tmp_path / "b.csv").write_text(JPL)
    more = (
        'radius = 1\nmass = 1\n[[bodies]]\nfile = "b.csv"\nradius = 1\nmass = 1\norbit = { central_mass = "1 M_sun" }'
    )
    if said:
        assert said in refusal(tmp_path, "a.txt", more)
    else:
        assert scene_of(tmp_path, "a.txt", more).count == 2


def test_an_epoch_of_the_scene_brings_orbits_to_that_of_the_vectors(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(horizons(epoch="2451545.0"))
    (tmp_path / "b.csv").write_text(JPL)
    more = 'radius = 1\nmass = 1\n[[bodies]]\nfile = "b.csv"\nradius = 1\nmass = 1\n'
    assert scene_of(tmp_path, "a.txt", more + 'orbit = { central_mass = "1 M_sun", epoch = 2451545.0 }').count == 2


# --- vectors under other names


@pytest.mark.parametrize(
    ("first", "second"),
    [("velocities", "angular_velocity"), ("velo", "AngularVelocity"), ("linVelVec", "angVelVec")],
)
def test_vectors_are_known_by_the_names_of_every_program_in_every_format(
    tmp_path: Path, first: str, second: str
) -> None:
    columns = f"Properties=pos:R:3:{first}:R:3:{second}:R:3:radius:R:1:mass:R:1"
    (tmp_path / "a.xyz").write_text(f"1\n{columns}\n0 0 0 1 2 3 4 5 6 0.1 1\n")
    arrays: dict[str, Any] = {"pos": [[0, 0, 0]], first: [[1, 2, 3]], second: [[4, 5, 6]], "radii": [0.1], "mass": [1]}
    np.savez(tmp_path / "a.npz", **arrays)
    head = ",".join(f'"{name}:{axis}"' for name in ("Points", first, second) for axis in range(3))
    (tmp_path / "a.csv").write_text(f"{head},radius,mass\n0,0,0,1,2,3,4,5,6,0.1,1\n")
    for file in ("a.xyz", "a.npz", "a.csv"):
        body = scene_of(tmp_path, file).data[0]
        assert body.velocity.tolist() == [[1.0, 2.0, 3.0]] and body.angular_velocity.tolist() == [[4.0, 5.0, 6.0]]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("vparticle", 'write columns = { velocity = "vparticle" } if so, or velocity = [0, 0, 0]'),
        ("linear", 'write columns = { velocity = "linear" } if so'),
        ("momenta", "divide it by the mass in the file, or velocity = [0, 0, 0]"),
        ("omegabody", 'write columns = { angular_velocity = "omegabody" } if so, or angular_velocity = [0, 0, 0]'),
        ("angmom", "divide it by the moment of inertia in the file, or angular_velocity = [0, 0, 0]"),
    ],
)
def test_a_vector_that_may_be_a_velocity_is_a_question(tmp_path: Path, name: str, said: str) -> None:
    arrays: dict[str, Any] = {"position": np.zeros((1, 3)), "radius": [0.1], "mass": [1.0], name: np.ones((1, 3))}
    np.savez(tmp_path / "a.npz", **arrays)
    question = refusal(tmp_path, "a.npz")
    assert f"{name} may hold the " in question and said in question


@pytest.mark.needs("gsd")
def test_hoomds_type_shapes_give_diameters_and_a_growing_file_has_no_values_of_its_first_frame(tmp_path: Path) -> None:
    """HOOMD's schema: a chunk that is missing equals that of frame 0 if N is the same, and else has its default."""
    import gsd.hoomd

    with gsd.hoomd.open(str(tmp_path / "a.gsd"), "w") as file:
        for count in (2, 3):
            frame = gsd.hoomd.Frame()
            frame.configuration.box = [10, 10, 10, 0, 0, 0]
            frame.particles.N = count
            frame.particles.position = [[3.0 * k, 0, 0] for k in range(count)]
            frame.particles.typeid = [k % 2 for k in range(count)]
            frame.particles.types = ["A", "B"]
            frame.particles.type_shapes = [{"type": "Sphere", "diameter": 2.0}, {"type": "Sphere", "diameter": 0.5}]
            frame.particles.mass = [5.0, 6.0] if count == 2 else None
            file.append(frame)
    top = 'units = "dimensionless"\ngravity.constant = 0'
    assert scene_of(tmp_path, "a.gsd", "snapshot = 0", top).data[0].radius.tolist() == [1.0, 0.25]
    assert "no column for mass" in refusal(tmp_path, "a.gsd", "", top)
    assert scene_of(tmp_path, "a.gsd", "mass = 1", top).data[0].radius.tolist() == [1.0, 0.25, 1.0]


# --- steps, planes, flags, boxes

LONG = "t,name,x,y,z,m,r\n0,A,0,0,0,1,0.1\n0,B,5,0,0,2,0.1\n10,A,1,0,0,1,0.1\n10,B,6,0,0,2,0.1\n"


def test_one_step_of_a_long_table_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(LONG)
    last = scene_of(tmp_path, "a.csv")
    assert last.data[0].position[:, 0].tolist() == [1.0, 6.0] and last.data[0].name == ["A", "B"]
    assert "a.csv: step 1 of 2 (from 0), t = 10, is read" in last.notes[0]
    for choice in ("snapshot = 0", "snapshot_time = 2"):
        assert scene_of(tmp_path, "a.csv", choice).data[0].position[:, 0].tolist() == [0.0, 5.0]
    assert "snapshot_time = 20 s is outside of its 2 steps, from 0 to 10 s" in refusal(
        tmp_path, "a.csv", "snapshot_time = 20"
    )
    for name in ("time", "frame", "step", "snapshot"):
        for body in ("id", "particle"):
            text = LONG.replace("t,name", f"{name},{body}").replace(",A,", ",1,").replace(",B,", ",2,")
            (tmp_path / "a.csv").write_text(text)
            assert scene_of(tmp_path, "a.csv").count == 2


def test_a_table_of_several_times_that_names_no_bodies_is_a_question(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(LONG.replace(",name", "").replace(",A", "").replace(",B", ""))
    said = refusal(tmp_path, "a.csv")
    assert "column t has 2 values and no column names the bodies" in said and "or count = 4" in said
    assert scene_of(tmp_path, "a.csv", "snapshot = -1").count == 2
    allowed = scene_of(tmp_path, "a.csv", "count = 4", "contact.allow_overlap = true")
    assert allowed.count == 4


def test_arrays_with_the_bodies_first_are_recognised_or_asked_for(tmp_path: Path) -> None:
    steps = np.arange(54.0).reshape(3, 6, 3)
    np.savez(tmp_path / "a.npz", position=steps)
    said = refusal(tmp_path, "a.npz", "radius = 0.1\nmass = 1")
    assert "3 steps of 6 bodies, or 6 steps of 3; write count = 6 or count = 3" in said
    first = scene_of(tmp_path, "a.npz", "radius = 0.1\nmass = 1\ncount = 3").data[0]
    np.testing.assert_array_equal(first.position, steps[:, -1])
    np.savez(tmp_path / "a.npz", position=steps, mass=np.ones(3))
    np.testing.assert_array_equal(scene_of(tmp_path, "a.npz", "radius = 0.1").data[0].position, steps[:, -1])
    np.savez(tmp_path / "a.npz", position=steps, time=np.arange(3.0))
    np.testing.assert_array_equal(scene_of(tmp_path, "a.npz", "radius = 0.1\nmass = 1").data[0].position, steps[-1])


def test_a_table_in_a_plane_is_read_at_z_0(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,vx,vy,r,m\n1,2,3,4,0.1,1\n")
    assert 'write columns = { position = ["x", "y"] } if the bodies are in the plane z = 0' in refusal(
        tmp_path, "a.csv"
    )
    body = scene_of(tmp_path, "a.csv", 'columns = { position = ["x", "y"] }').data[0]
    assert body.position.tolist() == [[1.0, 2.0, 0.0]] and body.velocity.tolist() == [[3.0, 4.0, 0.0]]


def test_flags_are_read_in_words_and_a_wrong_one_is_named_by_its_row(tmp_path: Path) -> None:
    rows = ("True", "F", "yes", "0")
    (tmp_path / "a.csv").write_text(
        "x,y,z,r,m,fixed\n" + "".join(f"{k},0,0,0.1,1,{row}\n" for k, row in enumerate(rows))
    )
    assert scene_of(tmp_path, "a.csv").data[0].fixed.tolist() == [True, False, True, False]
    (tmp_path / "a.csv").write_text("x,y,z,r,m,fixed\n0,0,0,0.1,1,True\n1,0,0,0.1,1,perhaps\n")
    assert "column fixed, row 1: 'perhaps' is neither true nor false" in refusal(tmp_path, "a.csv")


def test_a_box_of_the_file_is_compared_with_the_domain(tmp_path: Path) -> None:
    (tmp_path / "a.dump").write_text(LAMMPS_DUMP.format(units="si"))
    assert (
        "its box of 8 × 4 × 8 is periodic along x and y, which is ignored" in scene_of(tmp_path, "a.dump").notes[0][-1]
    )
    walls = 'gravity.constant = 0\n[domain]\nboundary = ["periodic", "periodic", "walls"]\nsize = [8, 4, 8]\n'
    said = refusal(tmp_path, "a.dump", "", walls)
    assert "its box is 0 to 8 × 0 to 4 × 0 to 8" in said and "write origin = [4, 2, 4] in [[bodies]]" in said
    inside = scene_of(tmp_path, "a.dump", "origin = [4, 2, 4]", walls)
    np.testing.assert_allclose(inside.data[0].position, [[0.0, 0.0, 0.416]], atol=1e-15)
    assert not any("its box" in note for note in inside.notes[0])
    other = scene_of(tmp_path, "a.dump", "origin = [4, 2, 4]", walls.replace("[8, 4", "[9, 4"))
    assert "its periodic box is 8 × 4 × 8, and domain.size is 9 × 4 × 8" in other.notes[0][-1]


MERCURY = """1 0 0 0 0 1 1 2
0.5 0.25 0.5 0 0 0 0.5 0 0 0 0 0 0 0
2 0.5 0 0 0 1 1 2
0.5 0.25 0.4 0 0 -1 0.125 0 0 0 1 2 3 0
0.5 0.25 1.6 0 0 1 0.25 0 0 0 0 0 0 1
"""


def test_a_data_file_of_mercury_is_read_at_a_step(tmp_path: Path) -> None:
    (tmp_path / "a.data").write_text(MERCURY)
    scene = scene_of(tmp_path, "a.data", "density = 1000")
    assert scene.data[0].position.tolist() == [[0.5, 0.25, 0.4], [0.5, 0.25, 1.6]]
    assert scene.data[0].angular_velocity[0].tolist() == [1.0, 2.0, 3.0]
    assert scene.data[0].radius.tolist() == [0.125, 0.25]
    assert scene.notes[0][0] == "a.data: step 1 of 2 (from 0) of MercuryDPM, t = 0.5, is read"
    assert scene_of(tmp_path, "a.data", "density = 1000\nsnapshot_time = 0.1").count == 1
    assert "no column for mass" in refusal(tmp_path, "a.data")
    (tmp_path / "plane.data").write_text("1 0.5 0 0 1 1\n0.1 0.2 0.3 0.4 0.05 0 -2 0\n")
    body = scene_of(tmp_path, "plane.data", "density = 1000").data[0]
    assert body.position.tolist() == [[0.1, 0.2, 0.0]] and body.angular_velocity.tolist() == [[0.0, 0.0, 2.0]]
    (tmp_path / "short.data").write_text(MERCURY.rpartition("0.5 0.25")[0])
    assert "the step from line 3 on has 1 of its 2 particles" in refusal(tmp_path, "short.data")


def test_arrays_that_have_their_own_steps_are_not_divided_again(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", position=np.arange(27.0).reshape(3, 3, 3), time=np.arange(3.0))
    assert scene_of(tmp_path, "a.npz", "radius = 0.1\nmass = 1\nsnapshot = 0").count == 3


def test_names_in_a_comment_are_those_of_the_columns_and_not_a_sentence_with_as_many_words(tmp_path: Path) -> None:
    (tmp_path / "a.dat").write_text("# t[Myr], x[pc], y[pc], z[pc]\n# NOTE: see the paper\n1 2 3 4\n2 2 3 5\n")
    said = refusal(tmp_path, "a.dat", "mass = 1\nradius = 1")
    assert "column t[Myr] has 2 values and no column names the bodies" in said
    body = scene_of(tmp_path, "a.dat", "mass = 1\nradius = 1\nsnapshot = -1").data[0]
    np.testing.assert_allclose(body.position[0], np.array([2.0, 3.0, 5.0]) * KPC / 1000.0)


def test_units_in_the_comments_of_the_exoplanet_archive_count(tmp_path: Path) -> None:
    lines = ("pl_bmassj: Planet Mass [Jupiter mass]", "pl_rade: Planet Radius [Earth radii]", "x: X [AU]")
    head = "".join(f"# COLUMN {line}\n" for line in lines)
    (tmp_path / "a.csv").write_text(f"{head}#\npl_bmassj,pl_rade,x,y,z\n2,3,1,0,0\n")
    names = 'mass = "pl_bmassj", radius = "pl_rade"'
    assert "of which only some state a unit" in refusal(tmp_path, "a.csv", f"columns = {{ {names} }}")
    named = f'columns = {{ {names}, position = ["x", "y [au]", "z [au]"] }}'
    body = scene_of(tmp_path, "a.csv", named).data[0]
    assert body.position.tolist() == [[AU, 0.0, 0.0]] and body.radius[0] == 3.0 * EARTH_RADIUS
    assert body.mass[0] == pytest.approx(2.0 * 1.2668653e17 / 6.6743e-11, rel=1e-15)


def test_a_column_of_dates_with_a_remark_divides_a_long_table(tmp_path: Path) -> None:
    rows = "".join(f"{name},{2460676.5 + day},{day},0,0,1,0.1\n" for name in ("Sun", "Earth") for day in (0, 1))
    (tmp_path / "a.csv").write_text(f"name,date (JD),x (AU),y (AU),z (AU),mass (kg),radius (m)\n{rows}")
    scene = scene_of(tmp_path, "a.csv", top="contact.allow_overlap = true")
    assert scene.data[0].name == ["Sun", "Earth"] and scene.data[0].position[:, 0].tolist() == [AU, AU]


def test_names_that_all_repeat_equally_often_without_a_time_are_a_question(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("name,x,y,z,m,r\n" + "A,0,0,0,1,0.1\nB,5,0,0,1,0.1\n" * 2)
    said = refusal(tmp_path, "a.csv")
    assert "each of 2 values of name occurs 2 times, as if the rows were steps" in said and "count = 4" in said
    assert scene_of(tmp_path, "a.csv", "count = 4", "contact.allow_overlap = true").count == 4


def test_an_axis_may_stand_before_the_name_of_a_vector(tmp_path: Path) -> None:
    axes = [f"{axis} {name}" for name in ("Position (km)", "Velocity (km/s)") for axis in "XYZ"]
    (tmp_path / "a.csv").write_text(f"{','.join(axes)},Mass (kg),Radius (km)\n1,2,3,4,5,6,7,8\n")
    body = scene_of(tmp_path, "a.csv").data[0]
    assert body.position.tolist() == [[1e3, 2e3, 3e3]] and body.velocity.tolist() == [[4e3, 5e3, 6e3]]


def test_files_of_a_scene_from_different_times_are_noted(tmp_path: Path) -> None:
    for name, time in (("a", 1.5), ("b", 2.5)):
        (tmp_path / f"{name}.xyz").write_text(f"1\nProperties=pos:R:3 Time={time}\n{time} 0 0\n")
    more = 'mass = 1\nradius = 0.1\n[[bodies]]\nfile = "b.xyz"\nmass = 1\nradius = 0.1'
    notes = scene_of(tmp_path, "a.xyz", more).notes
    assert "b.xyz: its time is 2.5 s, and the time of a.xyz is 1.5 s" in notes[1]
