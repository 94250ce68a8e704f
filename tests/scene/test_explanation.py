"""A key that does not exist is answered with the one that was meant, wherever in a scene that is."""

from __future__ import annotations

import pytest

from carom.errors import SceneError
from carom.scene.explanation import hint
from carom.scene.load import scene_from_text

ONE_BODY = "[[body]]\nradius = 1.0\n"


RESTITUTIONS = '"contact.restitution", "plane.0.restitution", "wall.0.restitution" or "material.0.restitution"?'


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("restitution", RESTITUTIONS),
        ("contact.restitutoin", '"restitution"?'),
        ("restitutoin", RESTITUTIONS),
        ("sphere", '"body"?'),
        ("name", '"title"?'),
        ("particles", '"group"?'),
        ("body.0.pos", '"position"?'),
        ("body.0.diameter", '"radius"? It is half of the diameter.'),
        ("body.0.omega", '"angular_velocity"?'),
        ("body.0.center", '"region.centre"?'),
        ("body.0.duration", '"time.duration" or "expect.duration"?'),
        ("group.0.region.centr", '"centre"?'),
        ("time.dt", '"time.fixed_dt"?'),
        ("contact.bounce", '"contact.restitution"?'),
        ("contacts", '"contact"?'),
        ("contact.friction", '"contact.static_friction"?'),
        ("contact.mu", '"contact.static_friction"?'),
        ("contact.cor", '"contact.restitution"?'),
        ("drag.viscosity", '"drag.relaxation_time"?'),
        ("gravity.acceleration", '"uniform"?'),
        ("gravity.g", '"uniform"?'),
        ("time.steps", '"time.duration"?'),
        ("domain.method", '"gravity.method"?'),
        ("time.seed", '"seed"?'),
    ],
)
def test_a_key_is_looked_for_in_every_section(key: str, meant: str) -> None:
    path = tuple(int(part) if part.isdigit() else part for part in key.split("."))
    said = hint(path)
    expected = meant.replace('"region.centre"', '"group.0.region.centre" or "outlet.0.region.centre"')
    assert said == f"; did you mean {expected}"


def test_a_body_is_told_that_a_material_has_its_restitution() -> None:
    with pytest.raises(SceneError) as caught:
        scene_from_text(ONE_BODY, "x.toml", ["body.0.restitution=0.5"])
    assert str(caught.value) == (
        "the override body.0.restitution=0.5: unknown key body.0.restitution; set it in a [[material]] that the body "
        "names, or for all bodies by contact.restitution"
    )


def test_a_key_like_no_other_is_answered_with_those_of_its_section() -> None:
    assert hint(("record", "xyzzy")) == "; known here: every, colour_by, impacts, check_every, energy_tolerance, series"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[contact]\nrolling_friction = 0.1\n", 'did you mean "rolling_resistance.rolling_friction"?'),
        (
            "[[wall]]\nradius = 1.0\n",
            'did you mean "cylinder.radius", "sphere.radius", "cone.radius" or "disc.radius"?',
        ),
        ("[[wall]]\ncylinder = { radius = 1.0, centre = [0, 0, 0] }\n", "known here: radius, point, axis"),
        ("[[wall]]\nshape = 'cylinder'\n", "cylinder, sphere, cone, disc, rectangle"),
        ("[[wall]]\ndisc.radius = 1.0\nmotion = { angular_velocity = 1.0 }\n", "known here: rotation, velocity, "),
        ("[contact.rolling_resistance]\nmu_r = 0.1\n", "known here: rolling_friction, twisting_friction"),
    ],
)
def test_laws_shapes_and_motions_name_their_own_keys(text: str, said: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_from_text(text + ONE_BODY, "x.toml")
    assert said in str(caught.value)


def test_a_section_like_no_other_is_answered_with_the_sections() -> None:
    with pytest.raises(SceneError, match=r"unknown key xyzzy; known here: title, .*, body, "):
        scene_from_text(ONE_BODY + "[[xyzzy]]\nradius = 1.0\n", "x.toml")
