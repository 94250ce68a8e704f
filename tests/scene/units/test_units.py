"""Units: texts such as "3 km" in a scene, [units] for plain numbers, and scenes in units of their own."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from typing import Any

import pytest

from carom.errors import SceneError
from carom.scene.load import Scene, scene_from_text
from carom.scene.units.dimension import (
    DIMENSIONS,
    ENERGY,
    LENGTH,
    TIME,
    Dimension,
    UnitError,
    _joined,
    _with_signs,
    names,
    quantity,
    unit,
)
from carom.scene.units.system import SI, UnitSystem
from carom.scene.variation import texts_of, values_of

ONE_BODY = "[[body]]\nradius = 1.0\n"


def loaded(text: str, overrides: list[str] | None = None) -> Scene:
    return scene_from_text(text, "scene.toml", overrides)


def complaint(text: str, overrides: list[str] | None = None) -> str:
    with pytest.raises(SceneError) as caught:
        loaded(text, overrides)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "number", "size"),
    [
        ("3 km", "body.0.radius", 3000.0),
        ("3km", "body.0.radius", 3000.0),
        ("0.1 ft", "body.0.radius", 0.03048),  # rounded once: 0.1 * 0.3048 is 0.030480000000000004
        ("1 au", "body.0.radius", 149597870700.0),
        ("12 h", "time.duration", 43200.0),
        ("1.5 days", "time.duration", 129600.0),
        ("5 g/cm^3", "body.0.density", 5000.0),
        ("5 g cm⁻³", "body.0.density", 5000.0),
        ("5 g cm-3", "body.0.density", 5000.0),
        ("5 g/cm**3", "body.0.density", 5000.0),
        ("2 solar mass", "body.0.mass", 3.9768197413961014e30),
        ("1 (km/s)^2 pc / solar mass", "gravity.constant", 1.551831756099717e-08),
        ("6.6743e-8 cm^3 g^-1 s^-2", "gravity.constant", 6.6743e-11),
        ("1 kpc/Myr", "drag.medium_velocity.0", 30.856775814913672e18 / 31557600e6),
        ("10 min", "record.every", 600.0),
        ("2 mm", "time.target_dx", 0.002),
        ("3 µm", "gravity.softening", 3e-6),
    ],
)
def test_a_text_with_a_unit_is_the_same_number_in_si(text: str, number: str, size: float) -> None:
    need = ["drag.relaxation_time=1", "drag.medium_velocity=[0, 0, 0]"] if number.startswith("drag") else []
    scene: Any = loaded("[[body]]\n", [*need, f'{number}="{text}"'])
    for key in number.split("."):
        scene = scene[int(key)] if key.isdigit() else getattr(scene, key)
    assert scene == size


def test_texts_stand_in_lists_tables_and_ranges() -> None:
    scene = loaded(
        """
        [[body]]
        position = ["1 km", 2, "-3 cm"]
        angular_velocity = [0, 0, "60 rpm"]
        [[group]]
        count = 1
        radius = "20 cm"
        region = { shape = "box", size = ["1 km", "2 km", 3000] }
        [[group]]
        count = 1
        radius = { min = "1 mm", max = "1 cm" }
        velocity = { mean = [0, 0, "36 km/h"], dispersion = "1 cm/s" }
        spin = { dispersion = "180 deg/s" }
        """
    )
    box, spread = scene.group
    assert scene.body[0].position == (1000.0, 2.0, -0.03)
    assert scene.body[0].angular_velocity[2] == 6.283185307179586
    assert (box.radius.min, box.radius.max) == (0.2, 0.2)
    assert box.region and box.region.size == (1000.0, 2000.0, 3000.0)
    assert (spread.radius.min, spread.radius.max) == (0.001, 0.01)
    assert (spread.velocity.mean, spread.velocity.dispersion) == ((0.0, 0.0, 10.0), 0.01)
    assert spread.spin.dispersion == 3.141592653589793


def test_a_scene_with_units_keeps_its_text() -> None:
    text = '[time]\nduration = "1 h" # an hour\n' + ONE_BODY
    assert loaded(text).toml == text
    assert 'max_dt = "1 min"' in loaded(text, ["time.max_dt=1 min"]).toml


MISTAKES = {
    "another dimension": ("3 kg", ['"kg" is a mass, not a length', 'a length, such as "3 km"']),
    "no dimension of ours": ("3 W", ['"W" is not a length', 'such as "3 km"']),
    "unknown unit": ("3 kilmeters", ['no unit "kilmeters"', 'did you mean "kilometers"?', 'such as "3 km"']),
    "wrong capitals": ("3 Km", ['did you mean "km"?']),
    "no unit": ("3", ["needs a unit", 'such as "3 km"', "for m write the number without quotes"]),
    "no number": ("big", ["expected a number", 'such as "3 km"']),
    "not finite": ("nan km", ["expected a number"]),
    "too large": ("1e400 km", ["must be a finite number"]),
    "too many digits of an exponent": ("1e99999999 km", ["is not a unit"]),
    "a comma": ("1,5 km", ['a decimal comma; write "1.5 km"']),
    "several numbers": ("0,0,-9.81", ["several numbers need brackets: [0,0,-9.81]"]),
    "a list as text": ("[0, 0, -9 m]", ["a list, in which each text needs quotes"]),
    "a power that would take for ever": ("1 km^999999999", ["is not a unit"]),
    "powers of powers": ("1 ((km^9)^9)^9", ["is not a unit"]),
    "a program": ("1 __import__('os')", ["is not a unit"]),
    "a long text": ("1 " + "m" * 100_000, ["expected a number"]),
    "negative": ("-3 km", ["'-3 km'", "must be more than 0"]),
}


@pytest.mark.parametrize(("text", "parts"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_wrong_quantity_is_refused_in_one_line_with_place_key_and_example(text: str, parts: list[str]) -> None:
    said = complaint(f'[[body]]\nradius = "{text}"\n')
    assert said.startswith("scene.toml:2: body.0.radius = ") and "\n" not in said and len(said) < 300
    assert [part for part in parts if part not in said] == []


def test_every_wrong_quantity_is_named() -> None:
    said = complaint('[time]\nduration = "3 m"\n[[body]]\nposition = ["1 km", "2 s", 3]\n').splitlines()
    assert [line.split(" = ")[0] for line in said] == ["scene.toml:2: time.duration", "scene.toml:4: body.0.position.1"]


def test_wrong_quantities_are_named_beside_all_other_mistakes() -> None:
    time = '[time]\nduration = "3 m"\nfixed_dt = -1.0\ndurations = 3\n'
    said = complaint(time + '[[body]]\nradius = "-1 km"\nposition = ["1 km", "2 s", 3]\n').splitlines()
    places = [line.split(" = ")[0] for line in said]
    assert places[:2] == ["scene.toml:2: time.duration", "scene.toml:7: body.0.position.1"]
    assert sorted(places[2:]) == [
        "scene.toml:3: time.fixed_dt",
        'scene.toml:4: unknown key time.durations; did you mean "duration"?',
        "scene.toml:6: body.0.radius",
    ]


@pytest.mark.parametrize(
    ("slip", "meant"), [("12 hh", "h"), ("12 mh", "h"), ("1 kday", "day"), ("1 mmin", "min"), ("1 hyr", "yr")]
)
def test_units_that_nobody_prefixes_take_no_prefix(slip: str, meant: str) -> None:
    said = complaint(f'[time]\nduration = "{slip}"\n{ONE_BODY}')
    assert f'there is no unit "{slip.split()[1]}" (did you mean "{meant}"?)' in said


@pytest.mark.parametrize("name", ["kft", "kau", "ksolar_mass", "kmetre", "kilom", "pcs", "kpcs", "hs", "kms", "inchs"])
def test_prefixes_and_plurals_are_only_where_they_are_in_use(name: str) -> None:
    with pytest.raises(UnitError, match="no unit"):
        unit(name)


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("µm", 1e-6),
        ("kilometres", 1e3),
        ("Mpc", 3.085677581491367e22),
        ("kyr", 3.15576e10),
        ("megayears", 3.15576e13),
        ("Gly", 9.4607304725808e24),
        ("ns", 1e-9),
        ("msec", 1e-3),
        ("mg", 1e-6),
        ("kt", 1e6),
        ("mL", 1e-6),
        ("kHz", 1e3),
        ("MN", 1e6),
        ("GPa", 1e9),
        ("keV", 1.602176634e-16),
        ("kcal", 4184.0),
        ("mrad", 1e-3),
        ("marcsec", 4.84813681109536e-09),
        ("hours", 3600.0),
        ("hrs", 3600.0),
        ("solar masses", 1.9884098706980507e30),
    ],
)
def test_prefixes_and_plurals_in_use_are_read(name: str, size: float) -> None:
    assert float(unit(name).size) == size


@pytest.mark.parametrize(
    ("text", "handed_to_pint"),
    [
        ("m (km/s)^2", "m*(km/s)**2"),
        ("pc (km/s)^2 / solar mass", "pc*(km/s)**2 / solar_mass"),
        ("m^3 kg^-1 s^-2", "m**3*kg**-1*s**-2"),
        ("(kg m) / (s ^ 2)", "(kg*m) / (s**2)"),
        ("kg·m^2", "kg*m**2"),
        ("° (s)", "°*(s)"),
    ],
)
def test_products_and_powers_have_signs_since_versions_of_pint_read_them_differently_without(
    text: str, handed_to_pint: str
) -> None:
    assert _with_signs(_joined(text)) == handed_to_pint


def test_a_number_without_a_dimension_has_no_unit() -> None:
    assert "must be a number" in complaint(ONE_BODY + '[contact]\nrestitution = "0.5 m"\n')


def test_keys_that_take_words_refuse_quantities_and_misspellings() -> None:
    scene = loaded('[time]\ntarget_dx = "auto"\n[record]\nevery = "step"\n' + ONE_BODY)
    assert (scene.time.target_dx, scene.record.every) == ("auto", "step")
    assert "'auto' or 'step'" in complaint('[record]\nevery = "stepp"\n' + ONE_BODY)


IN_AU = """
[units]
length = "au"
time = "day"
mass = "solar mass"
[time]
duration = 2
max_dt = "1 h"
[gravity]
constant = 2.959e-4
[[body]]
position = [0.1, 0, "1 km"]
velocity = [0, 0.5, 0]
mass = 0.1
radius = 0.01
"""


def test_units_are_those_of_plain_numbers() -> None:
    scene = loaded(IN_AU)
    body = scene.body[0]
    assert (scene.time.duration, scene.time.max_dt) == (172800.0, 3600.0)
    assert body.position == (14959787070.0, 0.0, 1000.0)
    assert body.velocity[1] == 149597870700 * 5 / 864000
    assert body.mass == float(Fraction("1.3271244e20") / Fraction("6.6743e-11") / 10)
    assert scene.gravity.constant == pytest.approx(6.674e-11, rel=1e-4)  # of k², given with four digits


def test_a_number_in_units_has_the_bits_of_the_text_with_that_unit() -> None:
    plain = loaded('[units]\nlength = "au"\n[[body]]\nradius = 0.3\nposition = [0.1, 0.7, 1e-9]\n').body[0]
    text = loaded('[[body]]\nradius = "0.3 au"\nposition = ["0.1 au", "0.7 au", "1e-9 au"]\n').body[0]
    assert plain == text


def test_defaults_are_in_si_whatever_the_units() -> None:
    scene = loaded('[units]\nlength = "km"\ntime = "h"\n[[body]]\n')
    assert (scene.time.duration, scene.body[0].radius, scene.gravity.constant) == (10.0, 1.0, 6.6743e-11)


def test_a_velocity_may_have_a_unit_of_its_own() -> None:
    scene = loaded('[units]\nlength = "au"\nvelocity = "km/s"\n[[body]]\nvelocity = [30, 0, 0]\n')
    assert scene.body[0].velocity[0] == 30000.0


def test_an_override_is_in_the_units_of_the_scene() -> None:
    assert loaded(IN_AU, ["time.duration=3"]).time.duration == 3 * 86400.0
    assert loaded(IN_AU, ["time.duration=3 s"]).time.duration == 3.0


def test_the_promised_duration_keeps_its_unit() -> None:
    promise = '[time]\nduration = "2 h"\n[expect]\nimpacts = 3\n' + ONE_BODY
    assert loaded(promise, ["time.duration=1 h"]).expect.duration == 7200.0
    default = '[units]\ntime = "h"\n[expect]\nimpacts = 3\n[time]\n' + ONE_BODY
    assert loaded(default, ["time.duration=1"]).expect.duration == 10.0


WRONG_UNITS = {
    "another dimension": ('length = "day"', ["units.length", '"day" is a time, not a length', '"m"']),
    "unknown unit": ('mass = "solar mas"', ["units.mass", "solar mass"]),
    "unknown dimension": ('lenght = "au"', ["units.lenght", 'did you mean "length"']),
    "a number": ("length = 3", ["units.length", "text in quotes"]),
}


@pytest.mark.parametrize(("line", "parts"), WRONG_UNITS.values(), ids=WRONG_UNITS.keys())
def test_wrong_units_are_refused_in_one_line(line: str, parts: list[str]) -> None:
    said = complaint(f"[units]\n{line}\n{ONE_BODY}")
    assert said.startswith("scene.toml:2: ") and "\n" not in said
    assert [part for part in parts if part not in said] == []


OWN = 'units = "au, day, solar mass"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[group]]\nradius = { min = 3, max = 2 }", "group.0.radius: min is above max"),
        ('[[group]]\nregion = { shape = "shell", inner_radius = 3, radius = 2 }', "inner_radius is not below radius"),
        ('[[group]]\nregion = { shape = "shell" }', "needs inner_radius = … and radius = …"),
        ('[domain]\nboundary = "periodic"\n[[body]]', "needs size = [x, y, z]"),
    ],
)
def test_a_refusal_does_not_speak_of_metres_where_the_scene_is_in_kilometres(text: str, said: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_from_text(f'[units]\nlength = "km"\n{text}', "")
    assert said in str(caught.value)
    assert "metres" not in str(caught.value) and "000" not in str(caught.value)


def test_a_scene_in_its_own_units_keeps_its_numbers() -> None:
    scene = loaded(OWN + "[time]\nduration = 365\n[[body]]\nradius = 1e-5\nmass = 1\n")
    assert (scene.time.duration, scene.body[0].radius, scene.body[0].mass) == (365.0, 1e-5, 1.0)


def test_the_default_gravitational_constant_follows_the_units() -> None:
    nominal = 1.3271244e20 * 86400**2 / 149597870700**3  # GM of the Sun in au³/day²
    assert loaded(OWN + ONE_BODY).gravity.constant == pytest.approx(nominal, rel=1e-15)
    assert loaded(OWN + "[gravity]\nconstant = 3.0\n" + ONE_BODY).gravity.constant == 3.0


def test_a_text_in_a_scene_with_its_own_units_is_converted_to_them() -> None:
    scene = loaded(OWN + '[time]\nduration = "12 h"\n' + ONE_BODY)
    assert scene.time.duration == 0.5


def test_dimensionless_numbers_need_a_gravitational_constant_and_take_no_units() -> None:
    without = 'units = "dimensionless"\n'
    assert "gravity.constant is missing" in complaint(without + ONE_BODY)
    assert loaded(without + "[gravity]\nconstant = 1\n" + ONE_BODY).gravity.constant == 1.0
    assert "expected a plain number" in complaint(
        without + '[gravity]\nconstant = 1\n[time]\nduration = "1 h"\n' + ONE_BODY
    )


@pytest.mark.parametrize(
    ("units", "part"),
    [
        ("au, day", "a mass is missing"),
        ("au, km, day", '"km" is a second length'),
        ("au, day, kg, J", '"J" is an energy'),
        ("au, day, kg/s", "is neither a length, a time nor a mass"),
        ("", '"" is not a unit'),
        ("SI", "expected a length, a time and a mass"),
    ],
)
def test_own_units_are_a_length_a_time_and_a_mass(units: str, part: str) -> None:
    said = complaint(f'units = "{units}"\n{ONE_BODY}')
    assert said.startswith("scene.toml:1: units = ") and part in said and '"au, day, solar mass"' in said


def test_numbers_are_written_with_the_units_of_the_scene() -> None:
    au, km = UnitSystem.of_text("day, au, solar mass"), UnitSystem({"length": "km", "energy": "erg"})
    shown = [units.text(3.0, ENERGY) for units in (SI, au, km)]
    assert shown == ["3 J", "3 solar mass au²/day²", "3e+07 erg"]
    assert [units.text(3.0, LENGTH) for units in (SI, au, km)] == ["3 m", "3 au", "0.003 km"]
    assert au.unit(DIMENSIONS[8]) == "au³/(solar mass day²)"
    assert UnitSystem.of_text("dimensionless").text(3.0, ENERGY) == "3"


def test_series_are_in_si_or_in_the_units_of_the_simulation() -> None:
    assert UnitSystem({"length": "km"}).recorded_unit("J") == "J"
    assert UnitSystem.of_text("au, day, solar mass").recorded_unit("1/s") == "1/day"
    assert UnitSystem.of_text("dimensionless").recorded_unit("J") == "1"


@pytest.mark.parametrize("units", [SI, UnitSystem({"time": "h"}), UnitSystem.of_text("au, h, kg")])
def test_a_number_of_the_simulation_can_be_written_into_its_scene(units: UnitSystem) -> None:
    text = units.literal(0.1 + 0.2, TIME)
    plain = text.strip('"')
    back = units.converted(float(plain), TIME) if text == plain else units.number(plain, TIME)
    assert back == 0.1 + 0.2


@pytest.mark.parametrize("dimension", DIMENSIONS, ids=lambda each: each.name)
def test_the_unit_and_the_example_of_a_dimension_are_of_that_dimension(dimension: Dimension) -> None:
    assert quantity(dimension.example, dimension) > 0
    if dimension.unit != "1/s":  # hertz, which nobody writes for a rate of growth
        assert quantity(f"1 {dimension.unit}", dimension) == 1


def test_every_unit_is_defined_and_has_no_other_meaning() -> None:
    found = list(names())
    assert len(found) == len(set(found))
    assert all(unit(name).size > 0 for name in found)


def test_an_unknown_unit_is_no_long_search() -> None:
    with pytest.raises(UnitError, match="no unit"):
        unit("q" * 78)


def test_values_of_a_sweep_have_units() -> None:
    assert values_of("1 km:5 km:3") == ("1 km", "3 km", "5 km")
    assert texts_of("1h:100h:3log") == ["1 h", "10 h", "100 h"]
    assert values_of("1 h,2 h") == ("1 h", "2 h")
    with pytest.raises(ValueError, match="one unit at both ends"):
        values_of("1 km:5 m:3")


def test_vectors_and_quoted_texts_with_commas_are_one_value_each() -> None:
    assert texts_of("[0, 0, -1],[0, 0, -2]") == ["[0, 0, -1]", "[0, 0, -2]"]
    assert texts_of("'a, b'") == ["'a, b'"]


def test_a_scene_without_units_imports_no_library_of_units() -> None:
    program = (
        "import sys; from carom.scene.load import Scene; Scene.load('cloud-collapse'); "
        "assert 'pint' not in sys.modules; Scene.load('cloud-collapse', ['time.duration=1 h']); "
        "assert 'pint' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
