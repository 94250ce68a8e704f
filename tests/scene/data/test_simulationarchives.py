"""The physics stated in a Simulationarchive of REBOUND is taken over, or refused by name."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carom.errors import SceneError
from carom.physics.space import Space
from carom.scene.load import Scene

pytestmark = pytest.mark.needs("rebound")

APART = "contact.enabled = false\n"


def save(path: Path, prepare: Callable[[Any], None] = lambda simulation: None, units: Any = None) -> Any:
    """Write a star of mass 1 with two bodies of mass 0.01; return the simulation."""
    import rebound

    simulation = rebound.Simulation()
    if units:
        simulation.units = units
    simulation.add(m=1.0, name="sun")
    simulation.add(m=0.01, a=1.0)
    simulation.add(m=0.01, a=0.8, e=0.1)
    simulation.testparticle_hidewarnings = 1
    prepare(simulation)
    simulation.save_to_file(str(path), delete_file=True)
    return simulation


def scene_of(folder: Path, top: str = APART, file: str = "a.bin", more: str = "") -> Scene:
    text = f'{top}\n[time]\nduration = 20.0\n[[bodies]]\nfile = "{file}"\nradius = 1e-6\n{more}'
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return Scene.load(folder / "scene.toml")


def notes_of(scene: Scene) -> str:
    return "\n".join(note for notes in scene.notes for note in notes)


def two_active_of(count: int, kind: int = 0) -> Callable[[Any], None]:
    def prepare(simulation: Any) -> None:
        simulation.N_active, simulation.testparticle_type = count, kind

    return prepare


def soft(simulation: Any) -> None:
    simulation.softening = 0.2


def varied(simulation: Any) -> None:
    simulation.add_variation()


def other_constant(simulation: Any) -> None:
    simulation.G = 0.7


@pytest.mark.parametrize(
    "prepare",
    [lambda simulation: None, two_active_of(1), two_active_of(2), two_active_of(2, 1), soft, varied, other_constant],
)
def test_the_bodies_of_an_archive_move_as_they_do_in_rebound(tmp_path: Path, prepare: Callable[[Any], None]) -> None:
    simulation = save(tmp_path / "a.bin", prepare)
    space = Space(scene_of(tmp_path), 1)
    for _ in space.run():
        pass
    simulation.integrate(20.0)
    there = np.array([particle.xyz for particle in simulation.particles])
    # 5 turns, both to rounding, which grows as t^{3/2}
    assert np.abs(space.state.position - there).max() < 1e-12
    assert list(space.names) == ["sun", "body 1", "body 2"]


def test_an_archive_says_what_is_taken_from_it_and_what_is_not(tmp_path: Path) -> None:
    save(tmp_path / "a.bin", two_active_of(1))
    scene = scene_of(tmp_path)
    assert [note for note in notes_of(scene).splitlines() if "position from position" not in note] == [
        "a.bin: N_active = 1: 2 test particles, whose masses do not attract, have mass 0 here",
        "a.bin: gravity.constant = 1 is taken from the file",
        'a.bin: integrator = "ias15" is not taken over; time.integrator = "gauss-radau15" is this method',
    ]
    assert scene.gravity.constant == 1.0
    assert "constant = 1.0" in scene.toml
    (tmp_path / "again.toml").write_text(scene.toml, encoding="utf-8")
    assert Scene.load(tmp_path / "again.toml").gravity.constant == 1.0
    assert scene.changed(["time.duration=5"]).notes == scene.notes
    assert "G = 1 is not used" in notes_of(scene_of(tmp_path, APART + "gravity.constant = 0"))
    save(tmp_path / "a.bin")
    assert "its bodies pass through each other; contact.enabled = false" in notes_of(scene_of(tmp_path, ""))


def test_the_constant_of_an_archive_is_taken_in_the_units_of_the_scene(tmp_path: Path) -> None:
    simulation = save(tmp_path / "a.bin", units=("days", "AU", "Msun"))
    own = scene_of(tmp_path, APART + 'units = "au, day, M_sun"')
    assert own.gravity.constant == simulation.G
    si = scene_of(tmp_path, APART + '[units]\nlength = "au"\ntime = "day"\nmass = "M_sun"')
    assert si.gravity.constant == pytest.approx(6.674e-11, rel=1e-3)  # REBOUND's own value has 5 digits
    assert si.gravity.constant == pytest.approx(simulation.G * 149597870700.0**3 / 86400.0**2 / 1.98841e30, rel=1e-4)


def shear(simulation: Any) -> None:
    simulation.configure_box(10.0) if hasattr(simulation, "configure_box") else setattr(simulation, "root_size", 10.0)
    simulation.boundary = "shear"


def periodic(simulation: Any) -> None:
    shear(simulation)
    simulation.boundary = "periodic"


REFUSED: dict[str, tuple[Callable[[Any], None], str, str]] = {
    "another constant": (
        lambda simulation: None,
        "gravity.constant = 6.67e-11",
        "gravity.constant is 1.0 in it, but 6.67",
    ),
    "another softening": (soft, "gravity.softening = 0.1", "gravity.softening is 0.2 in it, but 0.1 here"),
    "bodies that attract some": (two_active_of(1, 1), "", "testparticle_type = 1 with N_active = 1: 2 bodies attract"),
    "a shearing box": (shear, "", 'its boundary is "shear"'),
    "a periodic box": (periodic, "gravity.constant = 0", 'its box is periodic; set domain.boundary = "periodic"'),
    "a box of another size": (
        periodic,
        'gravity.constant = 0\ndomain = {boundary = "periodic", size = [10, 10, 20]}',
        'its box is periodic; set domain.boundary = "periodic" and domain.size = [10, 10, 10]',
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_carom_does_not_have_or_the_scene_contradicts_is_refused(tmp_path: Path, case: str) -> None:
    prepare, top, said = REFUSED[case]
    save(tmp_path / "a.bin", prepare)
    with pytest.raises(SceneError) as caught:
        scene_of(tmp_path, APART + top)
    assert said in str(caught.value)
    assert "bodies.0: a.bin: " in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_archives_with_different_constants_are_refused(tmp_path: Path) -> None:
    save(tmp_path / "a.bin")
    save(tmp_path / "b.bin", other_constant)
    with pytest.raises(SceneError, match=r"bodies\.1: b\.bin: gravity\.constant is 0\.7 in it, but 1\.0 here"):
        scene_of(tmp_path, more='[[bodies]]\nfile = "b.bin"\nradius = 1e-6\n')


def test_an_archive_that_is_cut_off_gives_its_intact_snapshots_without_a_raw_warning(tmp_path: Path) -> None:
    simulation = save(tmp_path / "a.bin", two_active_of(1))
    for time in (1.0, 2.0):
        simulation.integrate(time)
        simulation.save_to_file(str(tmp_path / "a.bin"))
    whole, intact = (tmp_path / "a.bin").read_bytes(), scene_of(tmp_path, more="snapshot = 1\n").data[0]
    (tmp_path / "a.bin").write_bytes(whole[:-100])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = scene_of(tmp_path)
    assert scene.data[0] == intact
    assert "a.bin: the file is damaged or ends early; of 2 intact snapshots number 1, t = 1, is read" in notes_of(scene)
    with pytest.raises(SceneError, match="there is no snapshot 2; the file has 2"):
        scene_of(tmp_path, more="snapshot = 2\n")


def test_a_snapshot_between_half_steps_is_synchronised(tmp_path: Path) -> None:
    def leap(simulation: Any) -> None:
        simulation.integrator, simulation.dt = "whfast", 0.05
        simulation.integrator.safe_mode = 0
        simulation.steps(7)

    simulation = save(tmp_path / "a.bin", leap)
    found = scene_of(tmp_path).data[0]
    simulation.synchronize()
    assert np.abs(found.position - [particle.xyz for particle in simulation.particles]).max() < 1e-15


def with_functions(simulation: Any) -> None:
    simulation.additional_forces = lambda reb_sim: None
    simulation.collision, simulation.collision_resolve = "direct", "merge"


def whfast(simulation: Any) -> None:
    simulation.integrator, simulation.dt = "whfast", 0.05


NOTED: dict[str, tuple[Callable[[Any], None], str]] = {
    "whfast": (
        whfast,
        'integrator = "whfast" with dt = 0.05 is not taken over; time.integrator = "wisdom-holman" is this method',
    ),
    "leapfrog": (
        lambda simulation: setattr(simulation, "integrator", "leapfrog"),
        'integrator = "leapfrog" with dt = 0.001 is not taken over; time.integrator = "leapfrog-dkd" is this method',
    ),
    "trace": (
        lambda simulation: setattr(simulation, "integrator", "trace"),
        'integrator = "trace" with dt = 0.001 is not taken over; carom lacks this method',
    ),
    "functions": (with_functions, "REBOUNDx …) are not in an archive: what they do is missing here"),
}


@pytest.mark.parametrize("case", NOTED)
def test_what_an_archive_lacks_or_carom_chooses_itself_is_said(tmp_path: Path, case: str) -> None:
    prepare, said = NOTED[case]
    save(tmp_path / "a.bin", prepare)
    notes = notes_of(scene_of(tmp_path))
    assert said in notes and "REBOUND warns" not in notes


@pytest.mark.parametrize(
    ("rebounds", "caroms"), [("ias15", "gauss-radau15"), ("leapfrog", "leapfrog-dkd"), ("whfast", "wisdom-holman")]
)
def test_the_integrator_that_is_named_as_the_same_method_has_the_same_error(
    tmp_path: Path, rebounds: str, caroms: str
) -> None:
    def prepare(simulation: Any) -> None:
        simulation.integrator, simulation.dt = rebounds, 0.02
        for planet in (1, 2):  # light enough for an integrator of Kepler orbits
            simulation.particles[planet].m = 1e-3

    simulation = save(tmp_path / "a.bin", prepare)
    step = "" if rebounds == "ias15" else "\nfixed_dt = 0.02"
    text = APART + f'[time]\nduration = 2.0\nintegrator = "{caroms}"{step}\n[[bodies]]\nfile = "a.bin"\nradius = 1e-6\n'
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    scene = Scene.load(tmp_path / "scene.toml")
    assert "is not taken over" not in notes_of(scene)
    space = Space(scene, 1)
    for _ in space.run():
        pass
    simulation.integrate(2.0)
    there = np.array([particle.xyz for particle in simulation.particles])
    # 100 steps of a method of second order have errors of 1e-4 or more, which both share up to rounding; the corrector
    # of Wisdom-Holman, which REBOUND leaves out by default, changes 1e-6
    assert np.abs(space.state.position - there).max() < (1e-5 if rebounds == "whfast" else 1e-12)


def test_an_archive_of_several_snapshots_says_which_one_is_read(tmp_path: Path) -> None:
    simulation = save(tmp_path / "a.bin")
    simulation.particles[1].r = 0.02
    for time in (1.0, 2.0):
        simulation.integrate(time)
        if time == 2.0:
            simulation.remove(2)  # as a merger does
        simulation.save_to_file(str(tmp_path / "a.bin"))
    last, first = scene_of(tmp_path), scene_of(tmp_path, more="snapshot = 0\n")
    assert "snapshot 2 of 3 (from 0), t = 2, is read" in notes_of(last) and last.count == 2
    assert "snapshot 0 of 3 (from 0), t = 0, is read" in notes_of(first) and first.count == 3
    with pytest.raises(SceneError, match="no snapshot 3; the file has 3, from t = 0 to 2"):
        scene_of(tmp_path, more="snapshot = 3\n")


def test_a_periodic_box_of_the_same_size_is_accepted(tmp_path: Path) -> None:
    save(tmp_path / "a.bin", periodic)
    top = 'gravity.constant = 0\ndomain = {boundary = "periodic", size = [10, 10, 10]}\n'
    assert scene_of(tmp_path, APART + top).domain.period == (10.0, 10.0, 10.0)


def test_a_snapshot_is_chosen_by_its_time_in_the_units_of_the_scene(tmp_path: Path) -> None:
    simulation = save(tmp_path / "a.bin", units=("AU", "yr", "Msun"))
    for time in (1.0, 2.5):
        simulation.integrate(time)
        simulation.save_to_file(str(tmp_path / "a.bin"))
    units = f'units = "au, yr, M_sun"\n{APART}'
    for moment, index in (("1.0", 1), ("2", 2), ('"365.25 d"', 1), ("-1e-12", 0), ("2.50000001", 2)):
        scene = scene_of(tmp_path, units, more=f"snapshot_time = {moment}\n")
        assert f"snapshot {index} of 3 (from 0)" in notes_of(scene)
        assert (
            scene.data[0].position.tolist()
            == scene_of(tmp_path, units, more=f"snapshot = {index}\n").data[0].position.tolist()
        )
    with pytest.raises(SceneError, match=r"snapshot_time = 3 is outside of its 3 snapshots, from t = 0 to 2.5"):
        scene_of(tmp_path, units, more="snapshot_time = 3\n")
    with pytest.raises(SceneError, match="snapshot and snapshot_time are both given; leave one out"):
        scene_of(tmp_path, units, more="snapshot_time = 1\nsnapshot = 0\n")
    (tmp_path / "a.csv").write_text("x,y,z,m\n0,0,0,1\n", encoding="utf-8")
    with pytest.raises(SceneError, match="finds no times of steps in it; choose one with snapshot"):
        scene_of(tmp_path, file="a.csv", more="snapshot_time = 1\n")


@pytest.mark.parametrize("boundary", ["none", "open"])
def test_ghost_boxes_whose_bodies_attract_are_refused(tmp_path: Path, boundary: str) -> None:
    def prepare(simulation: Any) -> None:
        simulation.root_size, simulation.boundary = 10.0, boundary
        simulation.N_ghost_x = simulation.N_ghost_y = 2

    # with boundary = "none", too, the forces of REBOUND are 25 times as large
    save(tmp_path / "a.bin", prepare)
    with pytest.raises(SceneError, match=r"N_ghost_x, N_ghost_y, N_ghost_z = 2, 2, 0: .* attracts 5 × 5 × 1 copies"):
        scene_of(tmp_path)
    assert "copies" not in notes_of(scene_of(tmp_path, f"gravity.constant = 0\n{APART}"))


def test_a_periodic_box_without_ghost_boxes_says_that_bodies_meet_across_its_faces_only_here(tmp_path: Path) -> None:
    def prepare(simulation: Any) -> None:
        periodic(simulation)
        simulation.collision = "direct"

    save(tmp_path / "a.bin", prepare)
    box = 'gravity.constant = 0\ndomain = {boundary = "periodic", size = [10, 10, 10]}\n'
    assert "N_ghost_x, N_ghost_y, N_ghost_z = 0, 0, 0: its bodies meet" in notes_of(scene_of(tmp_path, box))
