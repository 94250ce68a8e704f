"""Test particles: bodies of mass 0, which are attracted and do not attract."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import carom
from carom.errors import SceneError
from carom.lab.shrink.literal import literal
from carom.physics.forces.gravity import GravityMethod
from carom.physics.forces.gravity.direct import DirectGravity
from carom.physics.forces.gravity.fast_multipole.fast_multipole import FastMultipoleGravity
from carom.physics.forces.gravity.tree import TreeGravity
from carom.physics.placement import place
from carom.physics.space import Space
from carom.recording.edit.clip import clip
from carom.recording.export import write
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.runs.recomputed import snapshots
from carom.runs.replay import replay
from carom.runs.resume import continue_run, resumable_run
from carom.scene.load import Scene
from carom_command import carom as command

FloatArray = NDArray[np.float64]

E = 0.3
TURN = 2.0 * np.pi  # of an orbit of semi-major axis 1 about G M = 1
PERICENTRE = {"position": [1.0 - E, 0.0, 0.0], "velocity": [0.0, float(np.sqrt((1.0 + E) / (1.0 - E))), 0.0]}
STAR = {"name": "star", "mass": 1.0, "radius": 1e-3}
PROBE = {"name": "probe", "mass": 0.0, "radius": 1e-3, **PERICENTRE}


def scene_of(*bodies: dict[str, Any], time: dict[str, Any], **sections: Any) -> Scene:
    own = {"units": "dimensionless", "contact": {"enabled": False}, "gravity": {"constant": 1.0}}
    return Scene.from_dict({**own, "body": list(bodies), "time": time, **sections})


def end_of(scene: Scene) -> Space:
    space = Space(scene, threads=1)
    for _ in space.run():
        pass
    return space


@pytest.mark.parametrize(
    ("integrator", "error"),  # Gauss–Radau to rounding, some 1e-15 a turn; the maps by their order and steps
    [("gauss-radau15", 1e-12), ("wisdom-holman", 1e-11), ("leapfrog", 1e-3)],
)
def test_a_test_particle_is_on_the_orbit_of_kepler_and_does_not_move_the_star(integrator: str, error: float) -> None:
    steps = {} if integrator == "gauss-radau15" else {"fixed_dt": TURN / 2000}
    space = end_of(scene_of(STAR, PROBE, time={"duration": 4.5 * TURN, "integrator": integrator, **steps}))
    apocentre = [-1.0 - E, 0.0, 0.0]
    assert np.abs(space.state.position[1] - apocentre).max() < error
    assert np.abs(space.state.velocity[1] - [0.0, -np.sqrt((1.0 - E) / (1.0 + E)), 0.0]).max() < error
    assert not space.state.position[0].any() and not space.state.velocity[0].any()
    assert space.energy().total == 0.0  # the star's alone


@pytest.mark.parametrize("method", ["tree", "fast-multipole", "direct"])
def test_test_particles_do_not_change_what_each_method_makes_of_the_massive_ones(method: str) -> None:
    # halves of the box have test particles only, so that boxes of no mass occur; errors as those of the opening angle
    rng = np.random.default_rng(1)
    x = rng.uniform(-1.0, 1.0, (3000, 3))
    mass = np.where(x[:, 0] > 0.2, rng.uniform(0.5, 1.0, 3000), 0.0)
    heavy = mass > 0.0

    def accelerations(pull: GravityMethod, x: FloatArray) -> tuple[FloatArray, float]:
        found = np.zeros_like(x)
        energy = pull.accelerate(x, found, potential=True)
        assert energy is not None
        return found, energy

    def made(m: FloatArray) -> GravityMethod:
        if method == "tree":
            return TreeGravity(m, 1.0, 0.01, 0.3, True)
        return FastMultipoleGravity(m, 1.0, 0.01, 0.3) if method != "direct" else DirectGravity(m, 1.0, 0.01)

    found, energy = accelerations(made(mass), x)
    d = x[heavy][None, :, :] - x[:, None, :]
    right = np.einsum("j,ijk->ik", mass[heavy], d / ((d * d).sum(axis=-1) + 1e-4)[..., None] ** 1.5)
    size = np.sqrt((right * right).sum(axis=1))
    error = np.sqrt(((found - right) ** 2).sum(axis=1)) / size
    tolerance = 1e-12 if method == "direct" else 2e-3
    assert np.median(error) < tolerance and error.max() < 50 * tolerance
    alone, its = accelerations(made(mass[heavy]), x[heavy])
    np.testing.assert_allclose(energy, its, rtol=tolerance)
    assert np.median(np.abs(found[heavy] - alone) / size[heavy, None]) < tolerance


@pytest.mark.needs("rebound")
def test_test_particles_move_as_those_of_rebound_beyond_n_active() -> None:
    import rebound

    rng = np.random.default_rng(2)
    simulation = rebound.Simulation()
    simulation.add(m=1.0)
    simulation.add(m=1e-3, a=5.2, e=0.05)
    for _ in range(6):
        simulation.add(m=0.01, a=rng.uniform(0.5, 3.0), e=rng.uniform(0.0, 0.3), inc=rng.uniform(0.0, 0.3))
    simulation.N_active, simulation.testparticle_hidewarnings = 2, 1
    start = [(particle.xyz, particle.vxyz) for particle in simulation.particles]
    mass = [1.0, 1e-3, *[0.0] * 6]
    bodies = [
        {"position": list(x), "velocity": list(v), "mass": m, "radius": 1e-6}
        for (x, v), m in zip(start, mass, strict=True)
    ]
    space = end_of(scene_of(*bodies, time={"duration": 50.0, "integrator": "gauss-radau15"}))
    simulation.integrate(50.0)
    there = np.array([particle.xyz for particle in simulation.particles])
    # both to rounding, which grows as t^{3/2}: 1e-13 after 22 turns of the innermost
    assert np.abs(space.state.position - there).max() < 1e-11


def test_a_pair_of_test_particles_that_meets_does_not_shorten_the_step() -> None:
    close = PROBE | {"position": [PERICENTRE["position"][0], 1e-6, 0.0]}
    rule = {"duration": TURN, "integrator": "leapfrog"}
    one, two = (end_of(scene_of(*bodies, time=rule)) for bodies in ((STAR, PROBE), (STAR, PROBE, close)))
    assert abs(two.step - one.step) <= 0.01 * one.step


def test_a_medium_drags_test_particles_as_any_body() -> None:
    drag = {"relaxation_time": 2.0}
    free = {"radius": 1.0, "velocity": [3.0, 0.0, 0.0], "position": [0.0, 9.0, 0.0]}
    scene = scene_of({"mass": 1.0}, free | {"mass": 0.0}, time={"duration": 4.0}, drag=drag, gravity={"constant": 0.0})
    space = end_of(scene)
    assert space.state.velocity[1, 0] == pytest.approx(3.0 * np.exp(-2.0), rel=1e-13)
    assert np.abs(space.energy().relative_error) == 0.0


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "a contact": ({"contact": {}}, "body.1.mass = 0: the impulse of a test particle in a contact is not defined"),
    "no other": ({"body": [PROBE]}, "body.0.mass = 0: all bodies are test particles"),
    "a group": (
        {"body": [], "group": [{"mass": 0.0}, {"mass": 1.0}], "contact": {}},
        "group.0.mass = 0: the impulse of a test particle",
    ),
    "a virial": (
        {"group": [{"mass": 0.0, "region": {"shape": "plummer", "scale": 5.0}, "velocity": {"virial": 0.5}}]},
        "velocity.virial of test particles",
    ),
    "a contact that is switched on": ({"model": {"force": ["contact"]}}, "contact cannot be forced on"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_not_defined_of_test_particles_is_refused(case: str) -> None:
    others, said = WRONG[case]
    with pytest.raises(SceneError, match=said):
        Space(scene_of(STAR, PROBE, **({"time": {"duration": 1.0}} | others)), threads=1)


def test_arrays_and_files_may_have_test_particles(tmp_path: Path) -> None:
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    sections: dict[str, Any] = {"contact": {"enabled": False}}
    assert Scene.from_arrays(position=x, radius=0.1, mass=[1.0, 0.0], **sections).test_particles == 1
    for mass, inertia, said in (
        ([1.0, -1.0], None, "column mass, row 1: -1 must not be negative"),
        ([1.0, 0.0], [1.0, 1.0], "row 1 has a mass of 0 and a moment of inertia"),
        ([1.0, 1.0], [1.0, 0.0], "row 1 has a mass, but no moment of inertia"),
    ):
        with pytest.raises(SceneError, match=said):
            Scene.from_arrays(position=x, radius=0.1, mass=mass, inertia=inertia, **sections)
    with pytest.raises(SceneError, match=r"bodies\.0: the arrays has 1 body of mass 0: the impulse"):
        Space(Scene.from_arrays(position=x, radius=0.1, mass=[1.0, 0.0]), threads=1)


def test_a_run_and_its_recording_say_how_many_test_particles_there_are(tmp_path: Path) -> None:
    scene = scene_of(STAR, PROBE, PROBE, time={"duration": 0.1})
    (tmp_path / "a.toml").write_text(scene.toml, encoding="utf-8")
    said = "2 of 3 bodies are test particles (mass 0): attracted, but not attracting"
    assert said in " ".join(command("explain", "a.toml", cwd=tmp_path).stdout.split())
    assert said in command("run", "a.toml", "-o", "a.rrd", cwd=tmp_path).stderr
    document = Recording.open(tmp_path / "a.rrd")._entities.static(paths.SCENE)["TextDocument:text"][0]
    assert "| test particles | 2 |" in document


def test_runs_with_test_particles_are_replayed_resumed_clipped_and_read_again(tmp_path: Path) -> None:
    scene = scene_of(STAR, PROBE, time={"duration": 2.0}, record={"every": 0.5})
    recording = carom.run(scene, tmp_path / "a.rrd", threads=1)
    assert replay(recording).same
    assert recording.bodies.mass.tolist() == [1.0, 0.0]
    run = resumable_run(recording, until=3.0)
    assert continue_run(run, run.space(1), tmp_path / "b.rrd").status == "completed"
    clip(recording.path, tmp_path / "c.rrd", 1.0, 2.0, bodies=[1])
    assert replay(Recording.open(tmp_path / "c.rrd")).same
    write(tmp_path / "out.npz", snapshots(recording, None, everything=True), series=True)
    text = 'units = "dimensionless"\ncontact.enabled = false\ngravity.constant = 1\n[[bodies]]\nfile = "out.npz"\n'
    (tmp_path / "again.toml").write_text(text, encoding="utf-8")
    again = Scene.load(tmp_path / "again.toml")
    assert again.data[0].mass.tolist() == [1.0, 0.0]
    document = literal(again, place(again))
    assert [body["mass"] for body in document["body"]] == [1.0, 0.0]
