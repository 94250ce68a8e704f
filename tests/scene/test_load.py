"""A person's mistake gets one message that names file, line and key, and says what would be right."""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from carom.errors import SceneError
from carom.physics.placement import place
from carom.plan.checks import refuse_impossible
from carom.scene.load import Scene, scene_from_text
from carom.scene.scene_file import bundled_scenes, starter

ONE_BODY = "[[body]]\nradius = 1.0\n"


def complaint(tmp_path: Path, text: str, overrides: list[str] | None = None) -> str:
    """Load a text as a scene file and place its bodies; return the messages."""
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        scene = Scene.load(path, overrides)
        refuse_impossible(scene)
        place(scene)
    return str(caught.value)


MISTAKES = {
    "not TOML": ("title = \n" + ONE_BODY, ["scene.toml", "not TOML", "line 1"]),
    "a decimal comma": ("seed = 1,5\n" + ONE_BODY, ["scene.toml:1: not TOML", "write a decimal point, not a comma"]),
    **{
        f"a mistake in {value}": (f"seed = {value}\n" + ONE_BODY, ["scene.toml:1: not TOML", remedy])
        for value, remedy in {
            ".5": "write a digit before the point, such as 0.5",
            "[1.0, -.5]": "write a digit before the point, such as 0.5",
            "1.": "write a digit after the point, such as 1.0",
            "[1., 2]": "write a digit after the point, such as 1.0",
            "True": "write true, without a capital",
            "periodic": 'write text in quotes, as in "periodic"',
            "3 mm": 'write a quantity in quotes, as in "3 km"',
            "[1, 2e5m]": 'write a quantity in quotes, as in "3 km"',
        }.items()
    },
    "a decimal comma in a text": (
        "[time]\nduration = '3,5 s'\n" + ONE_BODY,
        ["scene.toml:2: time.duration = '3,5 s': a decimal comma; write \"3.5 s\""],
    ),
    "not text": ("title = '\x00'\n" + ONE_BODY, ["scene.toml", "not TOML"]),
    "unknown key": ("[contact]\nrestitutoin = 0.5\n" + ONE_BODY, [":2:", "restitutoin", 'did you mean "restitution"']),
    "unknown section": ("[contacts]\n" + ONE_BODY, [":1:", "contacts", 'did you mean "contact"']),
    "wrong type": ('[time]\nduration = "long"\n' + ONE_BODY, [":2:", "time.duration", "number"]),
    "a string for a count": ('[[group]]\ncount = "ten"\n', [":2:", "group.0.count", "whole number"]),
    "negative radius": ("[[body]]\nradius = -1.0\n", [":2:", "body.0.radius", "more than 0"]),
    "negative mass": ("[[body]]\nmass = -1\n", [":2:", "body.0.mass", "at least 0"]),
    "infinite mass": ("[[body]]\nmass = inf\n", [":2:", "body.0.mass", "finite"]),
    "NaN in a vector": ("[[body]]\nposition = [0, nan, 0]\n", [":2:", "body.0.position", "finite"]),
    "NaN in a range": ("[[group]]\nradius = { min = nan, max = 1 }\n", [":2:", "radius.min", "finite"]),
    "two numbers for a vector": ("[[body]]\nvelocity = [0, 0]\n", [":2:", "body.0.velocity", "[x, y, z]"]),
    "restitution above 1": ("[contact]\nrestitution = 1.4\n" + ONE_BODY, [":2:", "restitution = 1.4", "at most 1"]),
    "restitution below 0": ("[contact]\nrestitution = -0.1\n" + ONE_BODY, [":2:", "restitution", "at least 0"]),
    "negative friction, which the other coefficient follows": (
        "[contact]\nstatic_friction = -1.0\n" + ONE_BODY,
        [":2:", "static_friction = -1.0", "at least 0"],
    ),
    "sliding harder than sticking": (
        "[contact]\nstatic_friction = 0.2\nkinetic_friction = 0.5\n" + ONE_BODY,
        [":1:", "kinetic_friction = 0.5 is above static_friction = 0.2"],
    ),
    "no bodies": ('title = "void"\n', ["no bodies", "[[body]]"]),
    "overlapping bodies": (
        '[[body]]\nname = "a"\n[[body]]\nname = "b"\nposition = [1.5, 0, 0]\n',
        ['"a"', '"b"', "overlap by 0.5 m", "allow_overlap"],
    ),
    "a region too small": (
        "[[group]]\ncount = 1000\nradius = 1.0\nregion = { shape = 'ball', radius = 10.0 }\n",
        ["group.0.region", "would fill 1 of it", "0.38"],
    ),
    "a body larger than its region": (
        "[[group]]\ncount = 1\nradius = 2.0\nregion = { shape = 'box', size = [30, 30, 3] }\n",
        ["group.0", "does not fit"],
    ),
    "a ball without a radius": ("[[group]]\nregion = { shape = 'ball' }\n", [":2:", "region", "needs radius"]),
    "periodic without a size": ("[domain]\nboundary = 'periodic'\n" + ONE_BODY, [":1:", "needs size"]),
    "a size without walls": (
        "[domain]\nsize = [9, 9, 9]\n" + ONE_BODY,
        [":1:", 'add boundary = "walls" or "periodic"'],
    ),
    "single brackets for two bodies": ("[body]\n[body]\n", ["not TOML", "line 2", "[[body]]"]),
    "a key twice": ("seed = 1\nseed = 2\n" + ONE_BODY, ["not TOML", "line 2", "a key is given twice"]),
    "a place in a vector": ("[[body]]\nposition = [0, nan, 0]\n", ["body.0.position.1 = nan", "(position: m"]),
    "a word of TOML": ("gravity.constant = true\n" + ONE_BODY, ["gravity.constant = true: must be a number"]),
    "a material that is none": (
        '[[body]]\nmaterial = "rubber"\n',
        ['no material "rubber"; there is no [[material]], only "default"'],
    ),
    "walls without a size": ("[domain]\nboundary = 'walls'\n" + ONE_BODY, [":1:", "needs size"]),
    "periodic with self-gravity": (
        "[domain]\nboundary = 'periodic'\nsize = [9, 9, 9]\n" + ONE_BODY,
        ["self-gravity", "does not converge", "gravity.constant = 0"],
    ),
    "periodic with a uniform field": (
        "[gravity]\nconstant = 0\nuniform = [0, 0, -1]\n[domain]\nboundary = 'periodic'\nsize = [9, 9, 9]\n" + ONE_BODY,
        ["gravity.uniform", "fall through the box forever"],
    ),
    "a periodic box narrower than two bodies": (
        "[gravity]\nconstant = 0\n[domain]\nboundary = 'periodic'\nsize = [9, 9, 3]\n" + ONE_BODY,
        ["domain.size", "four times the largest radius"],
    ),
    "forces of the middle of the step where bodies may rest on each other": (
        "[time]\nintegrator = 'leapfrog-dkd'\n" + ONE_BODY + ONE_BODY + "position = [3, 0, 0]\n",
        ['time.integrator = "leapfrog-dkd"', "contacts need the forces at the end", 'use "leapfrog"'],
    ),
    "10¹² bodies": ("[[group]]\ncount = 1000000000000\nradius = 1e-3\n", ["1e+12 bodies", "GB of memory"]),
    "duration 0": ("[time]\nduration = 0\n" + ONE_BODY, [":2:", "time.duration = 0", "more than 0"]),
    "a number for a section": ("time = 3\n" + ONE_BODY, [":1:", "time = 3", "section"]),
    "density and mass": ("[[body]]\nmass = 1\ndensity = 1\n", ["body.0", "leave one out"]),
    "a time between frames below 0": (
        "[record]\nevery = -1\n" + ONE_BODY,
        [":2:", "record.every = -1: must be more than 0"],
    ),
    "more iterations than there may be": (
        "[contact]\nsweeps = 20_000\n" + ONE_BODY,
        [":2:", "contact.sweeps = 20000: must be at most 10000"],
    ),
    "neither one of the words nor a number": (
        "[contact]\nsweeps = 2.5\n[record]\nevery = 'often'\n[time]\ncfl = 'small'\n" + ONE_BODY,
        [
            "contact.sweeps = 2.5: must be 'auto', 'converged', 'as-needed' or 'quick', or a whole number",
            "record.every = 'often': must be 'auto' or 'step', or a number",
            "time.cfl = 'small': must be 'auto', or a number",
        ],
    ),
    "one warning in place of a list": (
        "[expect]\nwarned = 'limit'\n" + ONE_BODY,
        [":2:", "expect.warned = 'limit': must be a list"],
    ),
    "an expected state without its error": (
        "[[expect.state]]\nbody = 'a'\nvelocity = [0, 0, 1]\n[[body]]\nname = 'a'\n",
        ["scene.toml:1:", "expect.state.0: velocity without velocity_error; give both"],
    ),
    "an error without its expected state": (
        "[[expect.state]]\nbody = 'a'\nposition_error = 1.0\n[[body]]\nname = 'a'\n",
        ["expect.state.0: position_error without position; give both"],
    ),
    "nothing that is expected of a body": (
        "[[expect.state]]\nbody = 'a'\n[[body]]\nname = 'a'\n",
        ["expect.state.0: nothing is expected of the body; give position, velocity, angular_velocity"],
    ),
    "a state of an unknown body": (
        "[[expect.state]]\nbody = 'b'\nvelocity = [0, 0, 1]\nvelocity_error = 0.1\n[[body]]\nname = 'a'\n",
        ["scene.toml:2: expect.state.0.body: no [[body]] of that name", "a"],
    ),
    "a state of two bodies": (
        "[[expect.state]]\nbody = 'a'\nvelocity = [0, 0, 1]\nvelocity_error = 0.1\n" + 2 * "[[body]]\nname = 'a'\n",
        ["expect.state.0.body: several [[body]] tables have this name"],
    ),
    "a number in place of parts": ("[model]\nforce = 3\n" + ONE_BODY, [":2:", "model.force = 3: must be a list"]),
    "a pair of one name": (
        "[[pair]]\nmaterials = 'default'\nrestitution = 0.5\n" + ONE_BODY,
        [":2:", "pair.0.materials = 'default': must be a list of two"],
    ),
    "one column of three for a position": (
        "[[bodies]]\nfile = 'a.csv'\ncolumns = { position = ['a'] }\n",
        [":3:", "bodies.0.columns.position", "must be the names of three columns"],
    ),
    "a number in place of bodies": ("body = 3\n", [":1:", "body = 3: must be a list of sections"]),
    "a number in place of a vector": ("[[body]]\nvelocity = 3\n", ["velocity = 3: must be three numbers [x, y, z]"]),
    "a word that is none of the choices": (
        "[time]\nintegrator = 'rk4'\n" + ONE_BODY,
        [
            ":2:",
            "integrator",
            "'auto', 'euler', 'leapfrog', 'leapfrog-dkd', 'yoshida4', 'gauss-radau15' or 'wisdom-holman'",
        ],
    ),
    "a plane that faces nowhere": (
        ONE_BODY + "[[plane]]\nnormal = [0, 0, 0]\n",
        [":3:", "plane.0", "normal = [0, 0, 0] has no direction", "[0, 0, 1]"],
    ),
    "a plane on which sliding is harder than sticking": (
        ONE_BODY + "[[plane]]\nstatic_friction = 0.2\nkinetic_friction = 0.5\n",
        [":3:", "plane.0", "kinetic_friction = 0.5 is above static_friction = 0.2"],
    ),
    "a plane that gives more than it gets": (
        ONE_BODY + "[[plane]]\nrestitution = 1.1\n",
        [":4:", "plane.0.restitution", "at most 1"],
    ),
    "a misspelt key of a plane": (ONE_BODY + "[[plane]]\nnormals = [0, 0, 1]\n", [":4:", 'did you mean "normal"']),
    "fixed, but moving": (
        "[[body]]\nfixed = true\nvelocity = [1, 0, 0]\n",
        [":1:", "body.0", "fixed = true with a velocity"],
    ),
    "fixed, but turning": (
        "[[body]]\nfixed = true\nangular_velocity = [0, 0, 1]\n",
        ["body.0", "fixed = true with a velocity or an angular_velocity"],
    ),
    "a material that there is not": (
        "[[material]]\nname = 'steel'\n[[body]]\nradius = 1.0\nmaterial = 'steal'\n",
        [":5:", 'body.0.material: no material "steal"', 'did you mean "steel"?', "default, steel"],
    ),
    "a group of a material that there is not": (
        "[[group]]\nmaterial = 'steel'\n",
        [":2:", 'group.0.material: no material "steel"', 'there is no [[material]], only "default"'],
    ),
    "a plane of a material that there is not": (
        "[[plane]]\nmaterial = ''\n" + ONE_BODY,
        [":2:", 'plane.0.material: no material ""'],
    ),
    "two materials of one name": (
        "[[material]]\nname = 'steel'\n[[material]]\nname = 'steel'\n" + ONE_BODY,
        [":4:", 'material.1.name: a second material "steel"', "rename"],
    ),
    "a material without a name": ("[[material]]\ndensity = 1.0\n" + ONE_BODY, [":1:", "material.0.name is missing"]),
    "a material called default": (
        "[[material]]\nname = 'default'\n" + ONE_BODY,
        ["material.0", "is the material of [contact]; choose another"],
    ),
    "a material whose sliding is harder than its sticking": (
        "[[material]]\nname = 'steel'\nstatic_friction = 0.2\nkinetic_friction = 0.5\n" + ONE_BODY,
        [":1:", "material.0", "kinetic_friction = 0.5 is above static_friction = 0.2"],
    ),
    "a colour that is none": (
        "[[material]]\nname = 'steel'\ncolour = 'gray'\n" + ONE_BODY,
        [":3:", 'material.0.colour: "gray" is not "#rrggbb"', 'did you mean "grey"?'],
    ),
    "a density of the body and of its material": (
        "[[material]]\nname = 'steel'\ndensity = 7800.0\n[[body]]\nmaterial = 'steel'\ndensity = 7900.0\n",
        [":6:", "body.0.density", 'material = "steel" has one; remove one of the two'],
    ),
    "an inertia factor of the group and of its material": (
        "[[material]]\nname = 'shell'\ninertia_factor = 0.6\n[[group]]\nmaterial = 'shell'\ninertia_factor = 0.4\n",
        [":6:", "group.0.inertia_factor", "remove one of the two"],
    ),
    "a plane with a material and a coefficient": (
        "[[material]]\nname = 'steel'\n[[plane]]\nmaterial = 'steel'\nrestitution = 0.3\n" + ONE_BODY,
        [":5:", "plane.0.restitution", 'material = "steel"', "remove one of the two"],
    ),
    "a pair of a material that there is not": (
        "[[material]]\nname = 'steel'\n[[pair]]\nmaterials = ['steel', 'ruber']\nrestitution = 0.3\n" + ONE_BODY,
        [":4:", 'pair.0.materials: no material "ruber"'],
    ),
    "a pair given twice": (
        "[[material]]\nname = 'a'\n[[pair]]\nmaterials = ['a', 'default']\nrestitution = 0.3\n"
        "[[pair]]\nmaterials = ['default', 'a']\nstatic_friction = 0.3\n" + ONE_BODY,
        [":7:", "pair.1.materials: a second pair of default and a", "merge the two"],
    ),
    "a pair that says nothing": (
        "[[material]]\nname = 'a'\n[[pair]]\nmaterials = ['a', 'a']\n" + ONE_BODY,
        ["pair.0", "gives none of restitution, static_friction, kinetic_friction"],
    ),
    "a pair whose sliding is harder than its sticking": (
        "[[material]]\nname = 'a'\n[[pair]]\nmaterials = ['a', 'a']\nstatic_friction = 0.1\nkinetic_friction = 0.2\n"
        + ONE_BODY,
        ["pair.0", "kinetic_friction = 0.2 is above static_friction = 0.1"],
    ),
    "a pair of three": (
        "[[material]]\nname = 'a'\n[[pair]]\nmaterials = ['a', 'a', 'a']\nrestitution = 0.1\n" + ONE_BODY,
        ["pair.0.materials", "two"],
    ),
    "walls of a material where there are none": (
        "[domain]\nmaterial = 'default'\n" + ONE_BODY,
        ["domain", "without walls"],
    ),
    "colours of materials that there are not": (
        "[record]\ncolour_by = 'material'\n" + ONE_BODY,
        ['record.colour_by = "material"', "without a [[material]]"],
    ),
    "a coefficient of a body": ("[[body]]\nrestitution = 0.3\n", [":2:", "set it in a [[material]]"]),
    "a body in a plane": (
        "[[body]]\nposition = [0, 0, 0.75]\n[[plane]]\nname = 'floor'\n",
        ["body.0 overlaps floor by 0.25 m", "allow_overlap"],
    ),
    "a body in a wall": (
        "[domain]\nboundary = 'walls'\nsize = [9, 9, 9]\n[[body]]\nname = 'a'\nposition = [4, 0, 0]\n",
        ['body.0 ("a")', "overlaps wall at +x by 0.5 m", "move it out"],
    ),
    "a body outside the walls": (
        "[domain]\nboundary = 'walls'\nsize = [9, 9, 9]\n[[body]]\nposition = [0, -40, 0]\n",
        ["body.0", "overlaps wall at -y by 36.5 m"],
    ),
    "periodic with a plane": (
        "[gravity]\nconstant = 0\n[domain]\nboundary = 'periodic'\nsize = [9, 9, 9]\n" + ONE_BODY + "[[plane]]\n",
        ["domain.boundary", "with a [[plane]]", '"walls" or "open"'],
    ),
    "a group behind a plane": (
        "[[group]]\ncount = 3\nregion = { shape = 'ball', radius = 5.0, centre = [0, 0, -9] }\n"
        "[[plane]]\nname = 'floor'\n",
        ["group.0.region", "no space for the bodies outside floor"],
    ),
    "a group outside the walls": (
        "[domain]\nboundary = 'walls'\nsize = [9, 9, 9]\n"
        "[[group]]\ncount = 3\nregion = { shape = 'ball', radius = 3.0, centre = [20, 0, 0] }\n",
        ["group.0.region", "no space for the bodies outside wall at +x"],
    ),
    "an opening angle beyond 1": (
        "[gravity]\nopening_angle = 1.5\n" + ONE_BODY,
        ["gravity.opening_angle", "at most 1"],
    ),
    "impacts in a step of two drifts": (
        "[contact]\ntiming = 'time-of-impact'\n[time]\nintegrator = 'leapfrog-dkd'\n[gravity]\nconstant = 0\n"
        "[[group]]\nvelocity = { dispersion = 1.0 }\n",
        ["contact.timing", "drifts twice", "leapfrog"],
    ),
    "a radius whose cube is no number": ("[[body]]\nradius = 1e200\n", [":2:", "body.0.radius", "choose other units"]),
    "a mass too small to divide by": ("[[body]]\nmass = 1e-200\n", [":2:", "body.0.mass", "choose other units"]),
    "a whole number of 400 digits": ("[[body]]\nradius = 1" + "0" * 400 + "\n", [":2:", "body.0.radius"]),
    "radii whose power is no number": (
        "[[group]]\nradius = { min = 1e-9, max = 1, distribution = 'power-law', exponent = -50 }\n",
        [":2:", "group.0.radius", "exponent = -50 is too steep"],
    ),
    "a moment of inertia that is too small": (
        "[[body]]\nradius = 1e-90\n",
        ["the moment of inertia of body 0 is too large or too small"],
    ),
    "a group far from the origin": (
        "[[group]]\ncount = 30_000\nregion = { radius = 100, centre = [1e20, 0, 0] }\n",
        ["group.0", "positions are 1.64e+04 m apart", "enlarge the radius"],
    ),
    "a body far from the origin": (
        ONE_BODY + "position = [0, 1e20, 0]\n",
        ["body.0", "positions are 1.64e+04 m apart", "contact.enabled = false"],
    ),
    "a group larger than its periodic box": (
        "[gravity]\nconstant = 0\n[domain]\nboundary = 'periodic'\nsize = [9, 9, 9]\n[[group]]\ncount = 100_000\n",
        ["domain.size", "would fill 575 of the box"],
    ),
    "a group larger than the space between walls": (
        "[domain]\nboundary = 'walls'\nsize = [20, 60, 20]\n[[group]]\ncount = 20_000\nradius = 0.5\n",
        ["domain.size", "would fill 0.436 of the box"],
    ),
    "lists within lists": ("title = " + "[" * 40 + "]" * 40, ["scene.toml", "more than 32 levels deep"]),
    "a thousand lists within lists": ("title = " + "[" * 5000 + "]" * 5000, ["scene.toml", "more than 32 levels deep"]),
    "tables within tables": ("title = " + "{ a = " * 1000 + "1" + " }" * 1000, ["more than 32 levels deep"]),
    "a key of a million parts": (ONE_BODY + ".".join("a" * 1_000_000) + " = 1\n", [":3:", "more than 32 parts"]),
    "a header of a million parts": ("[" + " . ".join(['"a"'] * 500_000) + "]\n", [":1:", "more than 32 parts"]),
    "a whole number of 5000 digits": ("seed = " + "9" * 5000, ["scene.toml", "not TOML", "digits"]),
    "a sweep of 300 million values": (
        ONE_BODY + "[sweep]\nvary = { seed = '0:1:300000000' }\n",
        [":4:", "sweep.vary", "more than 100000 runs"],
    ),
    "a sweep of many ranges": (
        ONE_BODY + "[sweep]\nvary = { a = '0:1:60000', b = '0:1:60000' }\n",
        [":4:", "sweep.vary", "more than 100000 values"],
    ),
    "a sweep between ends too far apart": (
        ONE_BODY + "[sweep]\nvary = { seed = '-1e308:1e308:3' }\n",
        [":4:", "sweep.vary", "finite"],
    ),
    "impacts at times that run backwards": (
        "[contact]\ntiming = 'time-of-impact'\n[time]\nintegrator = 'yoshida4'\n"
        "[[group]]\nvelocity = { dispersion = 1.0 }\n",
        ["contact.timing", "time.integrator", "leapfrog", "end-of-step"],
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_with_its_place(mistake: str, tmp_path: Path) -> None:
    text, expected = MISTAKES[mistake]
    said = complaint(tmp_path, text)
    for part in expected:
        assert part in said
    assert "Traceback" not in said and "pydantic" not in said


def test_a_file_that_is_not_there_suggests_the_nearest_scene() -> None:
    with pytest.raises(SceneError, match=r'no such file.*did you mean the bundled scene "cloud-collapse"'):
        Scene.load("cloud-colapse")


def test_a_folder_is_not_a_scene(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="a folder, not a scene"):
        Scene.load(tmp_path)


def test_bytes_that_are_not_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(b"title = '\xff\xfe'\n")
    with pytest.raises(SceneError, match="not UTF-8"):
        Scene.load(path)


def test_several_mistakes_are_named_at_once(tmp_path: Path) -> None:
    said = complaint(tmp_path, "[contact]\nrestitution = 2\nsweeps = 0\n[[body]]\nradius = -1\n")
    assert [line.split(":")[1] for line in said.splitlines()] == ["2", "3", "5"]


def test_of_thousands_of_mistakes_the_first_few_are_explained_and_the_others_counted(tmp_path: Path) -> None:
    # each explanation reads the file once: 5000 took 40 s
    said = complaint(tmp_path, "".join(f"k{i} = 1\n" for i in range(2000)) + ONE_BODY).splitlines()
    assert len(said) == 9
    assert said[0].startswith(f"{tmp_path}/scene.toml:1: unknown key k0") and said[-1] == "… and 1992 more"


def test_a_dictionary_that_contains_itself_is_refused() -> None:
    data: dict[str, Any] = {}
    data["time"] = data
    with pytest.raises(SceneError, match="more than 32 levels deep"):
        Scene.from_dict(data)


def test_without_overrides_the_text_of_a_scene_is_kept_as_it_is_written() -> None:
    text = "# spaces   and\r\n[[body]]\r\nradius=1.0   # comments\r\n"
    assert scene_from_text(text, "here").toml == text


def test_an_override_changes_one_key_and_is_kept_in_the_text(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text("# a comment\n[time]\nduration = 1.0\n" + ONE_BODY, encoding="utf-8")
    scene = Scene.load(path, ["time.duration=2", "gravity.method=direct", "body.0.radius=3", "title=other"])
    assert (scene.time.duration, scene.gravity.method, scene.body[0].radius, scene.title) == (2, "direct", 3, "other")
    assert "# a comment" in scene.toml and "duration = 2" in scene.toml


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("duration", "expected key=value"),
        ("=3", "expected key=value"),
        ("body.4.radius=1", "there is no body.4"),
        ("title.x=1", "title is a value"),
        ("contact.restitution=7", "the override contact.restitution=7: contact.restitution = 7: must be at most 1"),
        ("contact.bounce=1", "the override contact.bounce=1: unknown key contact.bounce"),
        ("body.²=1", "there is no body.²"),
        ("body." + "9" * 5000 + ".radius=1", "there is no body.999"),
        ("a." * 40 + "b=1", "more than 32 parts"),
        ("title=" + "[" * 40 + "]" * 40, "more than 32 levels deep"),
    ],
)
def test_an_override_that_is_wrong_is_named(override: str, expected: str, tmp_path: Path) -> None:
    assert expected in complaint(tmp_path, 'title = "x"\n' + ONE_BODY, [override])


def test_the_friction_coefficient_not_given_follows_the_other() -> None:
    body = [{"radius": 1.0}]
    smooth = Scene.from_dict({"body": body, "contact": {"static_friction": 0.0}})
    rough = Scene.from_dict({"body": body, "contact": {"kinetic_friction": 0.9}})
    assert smooth.contact.kinetic_friction == 0.0
    assert rough.contact.static_friction == 0.9


def test_explicit_bodies_may_overlap_where_the_scene_says_so() -> None:
    bodies = [{"position": [0, 0, 0]}, {"position": [1.5, 0, 0]}]
    scene = Scene.from_dict({"body": bodies, "contact": {"allow_overlap": True}})
    assert len(place(scene).mass) == 2


def test_bodies_that_just_touch_are_not_overlapping() -> None:
    place(Scene.from_dict({"body": [{"position": [0.1, 0, 0]}, {"position": [2.1, 0, 0]}]}))


@pytest.mark.parametrize("name", bundled_scenes())
def test_every_bundled_scene_loads_and_promises_something(name: str) -> None:
    scene = Scene.load(name)
    assert scene.title != Scene.model_fields["title"].default
    assert scene.expect.model_dump(exclude_none=True)
    assert scene.toml.startswith("#"), "a comment says what to look for"


def test_the_starter_names_every_section(tmp_path: Path) -> None:
    path = tmp_path / "starter.toml"
    path.write_text(starter(), encoding="utf-8")
    scene = Scene.load(path)
    place(scene)
    written = scene.toml
    for section in Scene.model_fields.keys() - {"promise"}:  # carom writes it
        assert re.search(rf"\[{section}\]|{section} =", written), f"{section} is not in the starter"


def test_the_schema_for_editors_has_units() -> None:
    schema = Scene.model_json_schema()
    assert schema["$defs"]["Time"]["properties"]["max_dt"]["description"].startswith("s, ")


PROMISE = "[time]\nduration = 4.0\n[expect]\nimpacts = 3\nfinal_kinetic = 0.1\n" + ONE_BODY


@pytest.mark.parametrize(
    ("overrides", "promised"),
    [
        ([], None),
        (["time.duration=4.0"], None),
        (["time.duration=1.0"], 4.0),
        (["time={duration=1.0}"], 4.0),
        (["time.duration=1.0", "expect.impacts=1"], 4.0),  # the other promise is of the scene's own end
        (["time.duration=1.0", "expect.impacts=1", "expect.final_kinetic=0.5"], None),
        (["time.duration=1.0", "expect={impacts=1}"], None),
        (["time.duration=1.0", "expect.duration=1.0"], 1.0),
    ],
)
def test_a_promise_about_the_end_stays_with_the_duration_it_was_written_for(
    overrides: list[str], promised: float | None
) -> None:
    scene = scene_from_text(PROMISE, "x.toml", overrides)
    assert scene.expect.duration == promised
    assert scene_from_text(scene.toml, "x.toml").expect.duration == promised, "a recording says it, too"


def test_a_scene_without_a_promise_about_the_end_gets_no_duration_for_one() -> None:
    scene = scene_from_text("[expect]\nmax_overlap = 0.1\n" + ONE_BODY, "x.toml", ["time.duration=1.0"])
    assert scene.expect.duration is None


def test_a_scene_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(ONE_BODY, encoding="utf-8-sig")
    assert Scene.load(path).count == 1


def test_a_box_that_an_override_opens_keeps_its_size(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text('[domain]\nboundary = "walls"\nsize = [9, 9, 9]\n' + ONE_BODY, encoding="utf-8")
    assert Scene.load(path, ["domain.boundary=open"]).domain.boundary == "open"


@pytest.mark.parametrize("overrides", ["time.duration=5", {"time.duration": 5}])
def test_overrides_that_are_no_list_are_refused_as_such(overrides: Any) -> None:
    scene = Scene.from_dict({"body": [{"radius": 1.0}]})
    with pytest.raises(TypeError, match="overrides: expected a list of texts such as"):
        scene.changed(overrides)


@pytest.mark.parametrize("blank", ["", "  "])
def test_a_scene_whose_title_is_blank_is_untitled(blank: str) -> None:
    document = f'title = "{blank}"\ntime.duration = 1.0\n[[body]]\n'
    assert scene_from_text(document, "scene.toml", []).title == "Untitled scene"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[time]\nduration = 1\n[time]\n[[body]]\n", r"scene\.toml:3: not TOML: .*; merge the two sections \[time\]"),
        (f"[[body]]\nmass = {'9' * 5000}\n", r"scene\.toml:2: not TOML: a whole number of more than 4300 digits$"),
    ],
)
def test_a_text_that_the_parser_refuses_is_told_with_its_line_and_what_would_be_right(
    text: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(SceneError, match=said):
        Scene.load(tmp_path / "scene.toml")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[body]]\n\n[[time]]\nduration = 2\n", r"scene\.toml:3: time = .* must be a section with keys"),
        ("[[body]]\n[[boddy]]\n", r'scene\.toml:2: unknown key boddy; did you mean "body"'),
    ],
)
def test_a_wrong_list_of_sections_is_refused_with_its_line(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(SceneError, match=said):
        Scene.load(tmp_path / "scene.toml")


def test_an_unknown_section_of_an_override_is_the_fault_of_the_override() -> None:
    with pytest.raises(SceneError, match=r"^the override foo\.bar=1: unknown key foo"):
        scene_from_text("[[body]]\n", "scene.toml", ["foo.bar=1"])


def test_a_text_that_no_file_can_hold_is_refused() -> None:
    with pytest.raises(SceneError, match="half of a character"):
        Scene.from_dict({"body": [{"name": "\ud800"}]})


def test_a_whole_number_that_no_float_holds_is_not_finite(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(f"[[body]]\n[time]\nduration = {'9' * 400}\n")
    with pytest.raises(SceneError, match=r"scene\.toml:3: .*must be a finite number"):
        Scene.load(tmp_path / "scene.toml")


def test_every_whole_number_of_a_scene_has_a_largest_value_that_counters_hold() -> None:
    def integers(schema: Any) -> Iterator[dict[str, Any]]:
        parts = schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else []
        if isinstance(schema, dict) and schema.get("type") == "integer":
            yield schema
        for part in parts:
            yield from integers(part)

    found = list(integers(Scene.model_json_schema()))
    assert len(found) > 5
    assert all(min(one.get("exclusiveMaximum", 2**64), one.get("maximum", 2**64)) <= 2**63 for one in found)


@pytest.mark.parametrize("number", [2**53, 10**39, 16**40])
def test_a_promise_of_more_impacts_than_can_be_counted_is_refused(number: int, tmp_path: Path) -> None:
    assert "expect.impacts = " in complaint(tmp_path, f"expect.impacts = {number}\n[[body]]")


def test_a_title_is_shown_in_one_line() -> None:
    assert Scene.from_dict({"title": "a\nb", "body": [{"radius": 1.0}]}).title == "a b"


def test_a_count_that_no_machine_has_room_for_is_refused_with_its_line(tmp_path: Path) -> None:
    group = '[[group]]\ncount = 1000000000000\nradius = 1\nregion = { shape = "ball", radius = 5 }\n'
    (tmp_path / "scene.toml").write_text(f"[[body]]\n{group}")
    with pytest.raises(SceneError, match=r"scene\.toml:3: .* lower the count"):
        refuse_impossible(Scene.load(tmp_path / "scene.toml"))


def test_a_scene_may_come_through_a_pipe_whose_writer_is_slow(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")

    def write() -> None:
        with (tmp_path / "pipe.toml").open("w", encoding="utf-8") as pipe:
            for line in ("[[body]]", "radius = 2.0"):
                time.sleep(0.05)
                print(line, file=pipe, flush=True)

    writer = threading.Thread(target=write)
    writer.start()
    assert Scene.load(tmp_path / "pipe.toml").body[0].radius == 2.0
    writer.join()


def test_a_silent_or_endless_pipe_and_a_device_are_no_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    monkeypatch.setattr("carom.scene.scene_file.PATIENCE", 0.1)
    monkeypatch.setattr("carom.scene.scene_file.LARGEST_FILE", 1000)
    with pytest.raises(SceneError, match=r"pipe\.toml: nothing has written to this pipe for 0\.1 s"):
        Scene.load(tmp_path / "pipe.toml")
    with pytest.raises(SceneError, match="/dev/zero: a device, not a scene"):
        Scene.load("/dev/zero")
    endless = os.open(tmp_path / "pipe.toml", os.O_RDWR)
    os.write(endless, b" " * 2000)
    with pytest.raises(SceneError, match="more than 1000 bytes, which are too many"):
        Scene.load(tmp_path / "pipe.toml")
    os.close(endless)
