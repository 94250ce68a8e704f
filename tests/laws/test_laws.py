"""Contact laws beside Coulomb's: their functions, their sections, and several of them at once."""

from __future__ import annotations

import math
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from carom import Scene
from carom.errors import SceneError
from carom.laws import power_law, restitution_table, rolling_resistance, viscoelastic, walton
from carom.scene.contact_laws import ContactLaw
from carom.scene.load import scene_from_text
from carom.scene.matter import pair_coefficients


def restitution_of_a_viscoelastic_sphere(dissipation: float) -> float:
    """Integrate ξ'' = -(ξ^{3/2} + κ √ξ ξ') from ξ = 0, ξ' = 1 until the force is 0, and return the final speed.

    It is the motion of a Hertzian contact in units of its own length and time (Schwager & Pöschel 2008). The spheres
    separate where the force vanishes, while they are still deformed: they do not attract each other.
    """

    def force(_: float, state: Any) -> float:
        depth, speed = max(state[0], 0.0), state[1]
        return float(depth * math.sqrt(depth) + dissipation * math.sqrt(depth) * speed)

    def separates(time: float, state: Any) -> float:
        return force(time, state) if time > 1e-3 else 1.0

    separates.terminal = True  # type: ignore[attr-defined]
    begin = [1e-9, 1.0]
    path = solve_ivp(
        lambda time, state: [state[1], -force(time, state)],
        (0.0, 100.0),
        begin,
        events=separates,
        rtol=1e-10,
        atol=1e-13,
    )
    return float(-path.y[1, -1])


@pytest.mark.parametrize("dissipation", [0.02, 0.1, 0.3, 1.0, 2.0])
def test_viscoelastic_restitution_is_that_of_the_equation_of_motion(dissipation: float) -> None:
    # κ = β v^{1/5} is the square of the argument of the approximant, which is within 0.01 of the solution.
    p = SimpleNamespace(measured_x=math.sqrt(dissipation), measured_speed=1.0)
    expected = restitution_of_a_viscoelastic_sphere(dissipation)
    assert viscoelastic.restitution(p, 1.0, 0.0) == pytest.approx(expected, abs=0.01)


@given(st.floats(1e-5, 0.999), st.floats(1e-3, 1e3))
def test_viscoelastic_restitution_has_the_stated_value_at_the_stated_speed(e: float, speed: float) -> None:
    p = SimpleNamespace(**viscoelastic.numbers(viscoelastic.Viscoelastic(restitution=e, speed=speed)))
    # bisection of x ends at neighbours; e falls with at most the fourth power of x, and the expression rounds ten times
    assert viscoelastic.restitution(p, speed, 0.0) == pytest.approx(e, rel=1e-14)
    assert viscoelastic.restitution(p, 2.0 * speed, 0.0) < e < viscoelastic.restitution(p, 0.5 * speed, 0.0)


@given(st.floats(-40.0, 40.0))
def test_the_fifth_root_of_a_speed_is_right_at_any_magnitude(octave: float) -> None:
    # e near 1 shows the root: 1 - e = b₂ x² up to x³, with x² = x₀² (v/v₀)^{1/5}
    v = 2.0**octave
    p = SimpleNamespace(measured_x=1e-4, measured_speed=1.0)
    expected = float(Fraction(v)) ** 0.2
    taken = (1.0 - viscoelastic.restitution(p, v, 0.0)) / (viscoelastic.B2 * 1e-8)
    assert taken == pytest.approx(expected, rel=1e-4 + 3e-16 / (1.15e-8 * expected))


def test_a_slow_contact_is_at_rest() -> None:
    p = SimpleNamespace(measured_x=0.1, measured_speed=1.0)
    assert viscoelastic.restitution(p, 0.1, 0.1) == 0.0


@given(st.lists(st.floats(0.0, 1.0), min_size=2, max_size=6), st.floats(0.0, 20.0))
def test_a_table_of_restitution_is_linear_between_its_points(values: list[float], speed: float) -> None:
    speeds = [1.5 * k + 0.5 for k in range(len(values))]
    section = restitution_table.RestitutionTable(speeds=speeds, restitutions=values)
    p = SimpleNamespace(**restitution_table.numbers(section))
    # sums of six products, each at most 14 times 2/1.5
    assert restitution_table.restitution(p, speed, -1.0) == pytest.approx(np.interp(speed, speeds, values), abs=1e-13)


@given(st.floats(0.01, 1.0), st.floats(0.01, 2.0), st.floats(1e-3, 1e3))
def test_a_power_law_is_constant_up_to_its_speed_and_falls_with_its_power_above(
    e: float, exponent: float, speed: float
) -> None:
    p = SimpleNamespace(**power_law.numbers(power_law.PowerLaw(restitution=e, speed=speed, exponent=exponent)))
    assert power_law.restitution(p, 0.5 * speed, 0.0) == power_law.restitution(p, speed, 0.0) == e
    # the power is right to parts in 10¹⁵
    assert power_law.restitution(p, 16.0 * speed, 0.0) == pytest.approx(e * 16.0**-exponent, rel=1e-14)


@given(st.floats(-1.0, 1.0), st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_waltons_friction_never_adds_energy(beta: float, stopping: float, normal: float) -> None:
    p = SimpleNamespace(tangential_restitution=beta, kinetic_friction=0.3)
    impulse = walton.impact_friction(p, normal, stopping)
    # the loss J_t (|u_t| - ½ J_t K_t), with |u_t| = K_t J_stop; 1 + β rounds
    assert 0.0 <= impulse <= 0.3 * normal
    assert impulse * (stopping - 0.5 * impulse) >= -1e-15 * stopping**2


def scene(law: str, *sections: str) -> Scene:
    text = "[[body]]\nposition = [0, 0, 0]\nradius = 1\nmass = 1\n[[plane]]\npoint = [0, 0, -2]\n[time]\nduration = 1\n"
    return scene_from_text(
        "\n".join(["[gravity]\nconstant = 0", f"[contact]\nlaw = {law}", *sections, text]), "laws.toml"
    )


ROLLS = "[contact.rolling_resistance]\nrolling_friction = 0.1"
SLOWS = "[contact.viscoelastic]\nrestitution = 0.8\nspeed = 1"
TABLE = "[contact.restitution_table]\nspeeds = [0, 1]\nrestitutions = [1, 0.5]"


def test_two_laws_share_a_contact() -> None:
    both = pair_coefficients(scene('["viscoelastic", "rolling_resistance"]', ROLLS, SLOWS))
    assert both.laws == ("viscoelastic", "rolling_resistance")
    assert both.names == ("measured_x", "measured_speed", "measured_size", "rolling_friction", "twisting_friction")
    assert both.further[0, 1:].tolist() == [1.0, 0.0, 0.1, 0.0]


@pytest.mark.parametrize(
    ("law", "sections", "says"),
    [
        ('["viscoelastic", "restitution_table"]', [SLOWS, TABLE], "both define the restitution of a contact"),
        ('["viscoelastic", "rolling"]', [SLOWS], 'no contact law "rolling"; did you mean "rolling_resistance"?'),
        ('"viscoelastic"', [], '"viscoelastic" needs the section [contact.viscoelastic] with restitution, speed; add'),
        ('"walton"', [], '"walton" needs the section [contact.walton] with tangential_restitution; add it'),
        ('"coulomb"', [SLOWS], 'needs contact.law = "viscoelastic"'),
        ("[]", [], "names no law"),
        ('"walton"', ["[contact.walton]\ntangential_restitution = 1.5"], "must be at most 1"),
        ('"viscoelastic"', [SLOWS.replace("0.8", "1.2")], "less than 1"),
        ('"restitution_table"', [TABLE.replace("[0, 1]", "[1, 0]")], "speeds must increase"),
        ('"restitution_table"', [TABLE.replace("[1, 0.5]", "[1, 0.5, 0.2]")], "2 speeds, 3 restitutions"),
        ('"restitution_table"', [TABLE.replace("[1, 0.5]", "[0.5]")], "must have at least 2 of them"),
        ('"restitution_table"', [TABLE.replace("[1, 0.5]", str([0.5] * 7))], "at most 6"),
    ],
)
def test_a_mistake_in_a_law_is_named(law: str, sections: list[str], says: str) -> None:
    with pytest.raises(SceneError) as refused:
        scene(law, *sections)
    assert says in str(refused.value)


def test_a_coefficient_out_of_range_in_a_table_is_one_mistake() -> None:
    with pytest.raises(SceneError) as refused:
        scene('"restitution_table"', TABLE.replace("[1, 0.5]", "[1, -0.5]"))
    assert "restitutions.1 = -0.5: must be at least 0" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("module", [rolling_resistance, viscoelastic, restitution_table, walton])
def test_a_law_is_a_section_and_functions(module: Any) -> None:
    law = module.LAW
    assert isinstance(law, ContactLaw) and (law.section.__doc__ or "").startswith(
        f"[contact.{module.__name__.split('.')[-1]}]"
    )
