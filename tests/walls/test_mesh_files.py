"""Files of meshes: formats, where the mesh goes, what is refused or doubted, and what a scene keeps of a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carom import Scene
from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.plan.checks import doubts
from carom.scene.start import names_of_solids
from carom.scene.wall_shapes import shape_called
from carom.walls.mesh.facet_fields import EDGES, FLAT_OWN, FREE, OWN
from meshes import box, floor, stl

pytestmark = pytest.mark.needs("trimesh")
BALL = [{"position": [0, 0, 3], "radius": 0.1}]


def scene(**keys: Any) -> Scene:
    """Return a scene with a ball and a mesh."""
    return Scene.from_dict({"body": BALL, "wall": [{"name": "hopper", "mesh": keys}]})


def triangles_of(loaded: Scene) -> FloatArray:
    """Return the triangles of the wall, (f, 3, 3) m."""
    corners, triangles, _ = shape_called("mesh").mesh(loaded.wall[0].section, np.zeros(3), 1.0)
    return corners[triangles]


def test_all_formats_give_the_same_triangles(tmp_path: Path) -> None:
    import trimesh

    text = stl(tmp_path / "text.stl", box(0.5, 2))
    whole = trimesh.load_mesh(text, process=False)
    found = [triangles_of(scene(file=str(text)))]
    for name in ("binary.stl", "mesh.obj", "mesh.ply"):
        whole.export(tmp_path / name)
        found.append(triangles_of(scene(file=str(tmp_path / name))))
    assert all(np.array_equal(found[0], other) for other in found[1:])
    assert np.array_equal(found[0], box(0.5, 2))


def test_unit_centre_and_axes_place_a_mesh(tmp_path: Path) -> None:
    file = stl(tmp_path / "a.stl", np.array([[[0, 0, 0], [1000, 0, 0], [0, 0, 2000]]]))
    keys = {"unit": "1 mm", "centre": ["1 m", "2 m", "3 m"], "x_axis": [0, 3, 0], "z_axis": [1, 0, 0]}
    assert triangles_of(scene(file=str(file), **keys)) == pytest.approx(np.array([[[1, 2, 3], [1, 3, 3], [3, 2, 3]]]))


def test_a_scene_keeps_the_mesh_when_its_file_is_gone_and_reads_another_that_an_override_names(tmp_path: Path) -> None:
    first, second = stl(tmp_path / "first.stl", box(0.5, 1)), stl(tmp_path / "second.stl", box(0.5, 2))
    path = tmp_path / "scene.toml"
    path.write_text('[[body]]\nradius = 0.1\n[[wall]]\nmesh = { file = "first.stl", unit = 1.0 } # beside the scene\n')
    loaded = Scene.load(path)
    first.unlink()
    assert np.array_equal(triangles_of(loaded.changed([])), triangles_of(loaded))
    assert len(triangles_of(loaded.changed([f"wall.0.mesh.file={second}"]))) == 48


def test_edges_are_flat_sharp_or_free_and_each_triangle_has_a_name(tmp_path: Path) -> None:
    loaded = scene(file=str(stl(tmp_path / "box.stl", box(0.5, 1))))
    facets = shape_called("mesh").facets
    assert facets is not None
    kinds = np.stack([facets(loaded.wall[0].section).fields[name] for name in EDGES])
    assert [int((kinds == kind).sum()) for kind in (FREE, OWN, FLAT_OWN)] == [0, 12, 6]  # a cube and its diagonals
    assert names_of_solids(loaded)[:2] == ["hopper", "hopper, triangle 0"]
    assert len(names_of_solids(loaded)) == 13


def _bad(folder: Path) -> dict[str, tuple[str, str]]:
    """Return files that are refused: their names, and a part of the message."""
    stl(folder / "none.stl", np.zeros((0, 3, 3)))
    (folder / "words.stl").write_text("not a mesh\n")
    (folder / "words.ply").write_text("not a mesh\n")
    (folder / "scene.step").write_text("")
    stl(folder / "thin.stl", np.array([[[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]]]))
    stl(folder / "twice.stl", np.concatenate((floor(0.5, 1), floor(0.5, 1)[:1, ::-1])))
    (folder / "folder.stl").mkdir()
    fan = [[[0, 0, 0], [0, 0, 1], [np.cos(a), np.sin(a), 0]] for a in (0.0, 1.0, 2.0)]
    stl(folder / "fan.stl", np.array(fan))
    return {
        "missing": ("missing.stl", "no such file"),
        "folder": ("folder.stl", "it is a folder"),
        "no triangles": ("none.stl", "no triangles in it"),
        "no mesh": ("words.stl", "no triangles in it"),
        "no ply": ("words.ply", "not a mesh in PLY"),
        "another format": ("scene.step", "not a mesh in STL, OBJ or PLY"),
        "degenerate": ("thin.stl", "1 of 2 triangles have no area"),
        "there twice": ("twice.stl", "1 of 3 triangles are there twice"),
        "not manifold": ("fan.stl", "not manifold: 3 triangles share the edge about [0.0, 0.0, 0.5]"),
    }


def test_bad_files_are_refused_in_one_sentence_with_the_key(tmp_path: Path) -> None:
    for name, said in _bad(tmp_path).values():
        with pytest.raises(SceneError, match=r"^wall\.0\.mesh\.file: ") as refused:
            scene(file=str(tmp_path / name))
        assert said in str(refused.value), name
        assert "\n" not in str(refused.value)


def test_a_section_without_a_file_or_with_a_damaged_content_is_refused() -> None:
    with pytest.raises(SceneError, match="file is missing"):
        scene(unit=1.0)
    with pytest.raises(SceneError, match="content is damaged"):
        scene(file="a.stl", content="AAAA")


def test_a_wrong_unit_and_a_mesh_inside_out_are_said(tmp_path: Path) -> None:
    outwards = stl(tmp_path / "out.stl", box(0.5, 1))
    inside_out = stl(tmp_path / "box.stl", box(0.5, 1)[:, ::-1])
    open_one = stl(tmp_path / "open.stl", floor(0.5, 1))

    def said(**keys: Any) -> list[str]:
        return [each for each in doubts(scene(**keys)) if each.startswith("wall.0.mesh: ")]

    assert "inside out" in said(file=str(inside_out))[0]
    assert said(file=str(outwards)) == said(file=str(open_one)) == []
    assert "the mesh is 1e+03 m wide" in said(file=str(outwards), unit=1e3)[0]
    assert 'such as unit = "1 mm"' in said(file=str(outwards), unit=1e-3)[0]
