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
        (
            "restitution",
            RESTITUTIONS,
        ),
        ("contact.restitutoin", '"restitution"?'),
        (
            "restitutoin",
            RESTITUTIONS,
        ),
        ("sphere", '"body"?'),
        ("particles", '"group"?'),
        ("body.0.pos", '"position"?'),
        ("body.0.diameter", '"radius"?'),
        ("body.0.omega", '"angular_velocity"?'),
        ("body.0.center", '"region.centre"?'),
        ("body.0.duration", '"time.duration" or "expect.duration"?'),
        ("group.0.region.centr", '"centre"?'),
        ("time.dt", '"time.fixed_dt"?'),
        ("contact.bounce", '"contact.restitution"?'),
        ("contacts", '"contact"?'),
        ("contact.friction", '"contact.static_friction"?'),
        ("domain.method", '"gravity.method"?'),
        ("time.seed", '"seed"?'),
    ],
)
def test_a_key_is_looked_for_in_every_section(key: str, meant: str) -> None:
    path = tuple(int(part) if part.isdigit() else part for part in key.split("."))
    said = hint(path)
    expected = meant.replace('"region.', '"group.0.region.')
    assert said == f"; did you mean {expected}"


def test_a_body_is_told_that_a_material_has_its_restitution() -> None:
    with pytest.raises(SceneError) as caught:
        scene_from_text(ONE_BODY, "x.toml", ["body.0.restitution=0.5"])
    assert str(caught.value) == (
        "the override body.0.restitution=0.5: unknown key body.0.restitution; give it to a [[material]] that the body "
        "names, or to all by contact.restitution"
    )


def test_a_key_like_no_other_is_answered_with_those_of_its_section() -> None:
    assert hint(("record", "xyzzy")) == "; known here: every, colour_by, impacts, check_every, energy_tolerance, series"


def test_an_override_of_a_section_that_does_not_exist_is_answered_like_a_key() -> None:
    with pytest.raises(SceneError, match=r'there is no sphere\.0 in the scene; did you mean "body"\?'):
        scene_from_text(ONE_BODY, "x.toml", ["sphere.0.radius=2"])


def test_a_section_like_no_other_is_answered_with_the_sections() -> None:
    with pytest.raises(SceneError, match=r"unknown key xyzzy; known here: title, .*, body, "):
        scene_from_text(ONE_BODY + "[[xyzzy]]\nradius = 1.0\n", "x.toml")
