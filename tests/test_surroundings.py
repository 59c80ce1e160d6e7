"""The helper functions: published tables, check cases, and the compiled operations beside Python."""

import csv
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

import hybrid
from hybrid.cli import main
from hybrid.errors import PatchError
from hybrid.expressions import FUNCTIONS, RESERVED_NAMES, evaluate
from hybrid.fields import TIME_AXIS
from hybrid.helpers import HELPERS
from hybrid.modes import RESERVED_SIGNALS
from hybrid.parsing import parse
from hybrid.patchfile import parse_patch
from hybrid.surroundings import earth_fixed, geodetic, gravity_j2, gravity_j2_polar, us76

FT = 0.3048
SLUG = 14.59390293720636
EPS = np.finfo(float).eps

# U.S. Standard Atmosphere, 1976, table I (geometric altitude): Z m, T K, P Pa, rho kg/m3, sound m/s,
# as printed, with five digits.
US76 = """
-1000 294.651 1.1393e+5 1.3470 344.11
0     288.150 1.01325e+5 1.2250 340.29
5000  255.676 5.4048e+4 7.3643e-1 320.55
10000 223.252 2.6500e+4 4.1351e-1 299.53
20000 216.650 5.5293e+3 8.8910e-2 295.07
30000 226.509 1.1970e+3 1.8410e-2 301.71
40000 250.350 2.8714e+2 3.9957e-3 317.19
50000 270.650 7.9779e+1 1.0269e-3 329.80
60000 247.021 2.1958e+1 3.0968e-4 315.07
70000 219.585 5.2209e+0 8.2829e-5 297.06
80000 198.639 1.0524e+0 1.8458e-5 282.54
"""


def last_digit(text):
    """A unit of the last printed digit: some are rounded, others cut."""
    mantissa, _, exponent = text.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def value(text, **scope):
    return evaluate(parse(text, set(scope)), scope)


@pytest.mark.parametrize("line", US76.strip().splitlines())
def test_the_standard_atmosphere_is_that_of_the_printed_table(line):
    height, *printed = line.split()
    names = ("temperature_us76", "pressure_us76", "density_us76", "sound_speed_us76")
    for name, text in zip(names, printed, strict=True):
        found = value(f"{name}(h)", h=float(height))
        assert abs(found - float(text)) <= last_digit(text), name


def test_the_atmosphere_goes_on_without_a_jump_at_every_layer():
    # Geometric heights of the bases, from their geopotential ones; 2 mm are 4e-7 of a scale height.
    for base in (0.0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3, 84852.0):
        height = 6356766.0 * base / (6356766.0 - base)
        below, above = us76(height - 1e-3), us76(height + 1e-3)
        assert below == pytest.approx(above, rel=1e-6)
        assert below[1] > above[1]


def test_far_below_the_ground_there_is_no_air():
    assert math.isnan(us76(-6356766.0)[0])
    assert math.isnan(us76(math.nan)[1])


def test_gravity_with_j2_is_the_gradient_of_its_potential():
    def potential(x, y, z, gm=3.986004418e14, a=6378137.0, j2=1.08262982e-3):
        r = math.sqrt(x * x + y * y + z * z)
        return gm / r * (1.0 - j2 * (a / r) ** 2 * (1.5 * (z / r) ** 2 - 0.5))

    rng = np.random.default_rng(5)
    for _ in range(20):
        place = rng.normal(size=3)
        place *= rng.uniform(6.4e6, 5e7) / np.linalg.norm(place)
        step = 1e-4 * np.linalg.norm(place)
        found = gravity_j2(*place)
        for axis in range(3):
            ahead = np.eye(3)[axis] * step
            slope = (potential(*(place + ahead)) - potential(*(place - ahead))) / (2.0 * step)
            # A central difference errs by step^2/6 of the third derivative, 6 g/r^2 at most, twice over
            # for the oblate part, and by the rounding of the potential, g r, over a step.
            g = np.linalg.norm(found)
            assert abs(found[axis] - slope) <= g * (2e-8 + 4.0 * EPS / 1e-4)
        distance = float(np.linalg.norm(place))
        latitude = math.asin(place[2] / distance)
        down, north = gravity_j2_polar(distance, latitude)
        outwards = place / distance
        across = math.hypot(place[0], place[1])
        northwards = np.array(
            [-outwards[2] * place[0], -outwards[2] * place[1], across * across / distance]
        )
        northwards /= across
        assert down == pytest.approx(-np.dot(found, outwards), rel=1e-14)
        assert north == pytest.approx(np.dot(found, northwards), abs=1e-14)
        assert gravity_j2(*place, 1e15, 1.0, 0.0) == pytest.approx(
            -1e15 * place / distance**3, rel=1e-14
        )


# Documentation of brahe, "Geodetic transformations": San Francisco, to a millimetre.
def test_a_published_place_on_wgs84():
    found = earth_fixed(math.radians(37.7749), math.radians(-122.4194), 16.0)
    assert found == pytest.approx((-2706181.627, -4261070.165, 3885735.291), abs=0.5e-3)
    back = geodetic(-2706181.627, -4261070.165, 3885735.291)
    assert np.degrees(back[:2]) == pytest.approx((37.7749, -122.4194), abs=1e-8)
    assert back[2] == pytest.approx(16.0, abs=1e-3)


@pytest.mark.parametrize("height", [-6e6, -1e4, 0.0, 4e5, 3.6e7, 1e9])
def test_the_way_back_from_earth_fixed_axes_errs_by_rounding(height):
    # The place is exact in long double and then rounded: half a unit of 2^-52 of the distance each way.
    a, f = np.longdouble(6378137), 1 / np.longdouble("298.257223563")
    e2 = f * (2 - f)
    distance = 6378137.0 + abs(height)
    for latitude in np.linspace(-math.pi / 2, math.pi / 2, 181):
        sine, cosine = np.sin(np.longdouble(latitude)), np.cos(np.longdouble(latitude))
        normal = a / np.sqrt(1 - e2 * sine**2)
        place = (normal + height) * cosine, 0.0, (normal * (1 - e2) + height) * sine
        found = geodetic(*map(float, place))
        assert abs(found[0] - latitude) <= 4e-16
        assert abs(found[2] - height) <= 4.5 * EPS * distance


def rows(file):
    with file.open(encoding="utf-8") as stream:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(stream)]


@pytest.mark.parametrize("case", ["01", "09", "11"])
def test_air_and_gravity_of_the_nesc_check_cases(reference, case):
    # sim_04 prints twelve digits. Its density and speed of sound differ by 2e-6 and 1e-6 from those
    # of sim_05 in case 11, as their values at sea level do.
    table = rows(reference(f"nesc_atmos/atmos_{case}_sim_04.csv"))
    assert len(table) > 50
    for row in table:
        height = row["altitudeMsl_ft"] * FT
        density = value("density_us76(h)", h=height) / (SLUG / FT**3)
        assert density == pytest.approx(row["airDensity_slug_ft3"], rel=2e-6)
        sound = value("sound_speed_us76(h)", h=height) / FT
        assert sound == pytest.approx(row["speedOfSound_ft_s"], rel=2e-6)
        angles = math.radians(row["latitude_deg"]), math.radians(row["longitude_deg"])
        pull = np.linalg.norm(gravity_j2(*earth_fixed(*angles, height))) / FT
        assert pull == pytest.approx(row["localGravity_ft_s2"], rel=1e-9)
        if "eiPosition_ft_X" in row:  # inertial axes, which share the z axis
            latitude, _, found = geodetic(*(row[f"eiPosition_ft_{axis}"] * FT for axis in "XYZ"))
            assert found / FT == pytest.approx(row["altitudeMsl_ft"], abs=1e-3)
            assert math.degrees(latitude) == pytest.approx(row["latitude_deg"], abs=1e-9)


ASKED = {
    "density_exponential": "density_exponential(high, 1.2 * dense, 7000 * one)",
    "gravity_sphere": "gravity_sphere(far)",
    "gravity_down_j2": "gravity_down_j2(far, tilt)",
    "gravity_north_j2": "gravity_north_j2(far, tilt)",
}


def test_every_operation_computes_what_plain_python_does(play):
    asked = dict(ASKED)
    for name, helper in HELPERS.items():
        first = helper.takes[0][0]
        arguments = {"height": "high", "x": "far, far/3, -far/2", "latitude": "tilt, -2*tilt, high"}
        asked.setdefault(name, f"{name}({arguments.get(first)})")
    program = "".join(f"    out_{name}: {text}\n" for name, text in asked.items())
    text = f"""
title: Helpers
parameters: {{one: 1 m, dense: 1 kg/m^3, step: 3 km, turn: 0.2 rad}}
digital:
  period: 1 s
  remember: {{high: -9 km, far: 6400 km, tilt: -1.6}}
  program:
    high: previous(high) + step
    far: previous(far) + 100 * step
    tilt: previous(tilt) + turn / 2
{program}
run: {{until: 30 s}}
"""
    played = play(text)
    scope = {"one": 1.0, "dense": 1.0}
    for row in range(1, 31):  # the first is before any result
        scope |= {name: float(played[name][row]) for name in ("high", "far", "tilt")}
        for name, expression in asked.items():
            expected = evaluate(parse(expression, set(scope)), scope)
            found = played[f"out_{name}"][row]
            # The same formulas, but a product and a sum may be rounded as one: a few units in the last
            # place of the largest intermediate result, which a component near zero does not show.
            size = {"rad": 1.0}.get("", abs(expected))
            if name.startswith(("gravity_", "x_", "y_", "z_", "height_")):
                size = max(size, 10.0 if name.startswith("gravity") else scope["far"])
            assert abs(found - expected) <= 32 * EPS * max(size, abs(expected)), (name, row)
    assert FUNCTIONS.keys() >= asked.keys()


RISE = """
title: Rising
parameters: {rate: 1 km}
digital:
  period: 1 s
  compute_time: 0.5 s
  remember: {height: 79 km}
  program:
    height: previous(height) + rate
    rho: density_us76(height)
run: {until: 10 s}
readouts: {thin: {final: rho}}
"""


def test_a_run_says_when_it_left_the_atmosphere(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rise.yaml").write_text(RISE)
    assert main(["run", "rise.yaml", "--json", "--no-chart"]) == 0
    found = json.loads(capsys.readouterr().out)
    # 80 km in the cycle at 0 s, 87 km in that at 7 s, 90 km in the last, at 10 s.
    assert found["outside"] == [
        {
            "function": "density_us76",
            "word": "rho",
            "argument": "height",
            "value": 87e3,
            "range": [-5e3, 86e3],
            "units": "m",
            "time_s": 7.0,
            "times": 4,
            "worst": 90000.0,
            "action": "continued",
        }
    ]
    said = "density_us76 in word 'rho' was asked for height = 87000 m, outside -5000 to 86000 "
    assert found["status_note"] == said + "(4 times, first at 7 s; at worst 90000 m; continued)"
    # Isothermal from the top of the standard on: H = R T / (M g) = 5472.2 m, of geopotential height.
    base, top = (6356766.0 * h / (6356766.0 + h) for h in (86e3, 89e3))
    expected = 6.957820e-6 * math.exp(-(top - base) / (8314.32 / 28.9644 * 186.946 / 9.80665))
    assert found["readouts"]["thin"]["value"] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "us76(height)",
            "us76(2 * rate * height)",
            "the height, '2*rate*height' [m^2], must be in m",
        ),
        ("us76(height)", "us76(height, rate)", "density_us76() takes 1 argument, not 2"),
        ("density_us76", "densty_us76", "did you mean 'density_us76'"),
        (
            "density_us76(height)",
            "gravity_sphere(height, rate)",
            "the gm, 'rate' [m], must be in m^3/s^2",
        ),
        ("density_us76(height)", "latitude_wgs84(height)", "takes 3 arguments, not 1"),
        (
            "density_us76(height)",
            "x_wgs84(rate, 0, 0)",
            "the latitude, 'rate' [m], must be a pure number",
        ),
        (
            "rho: density_us76(height)",
            "rho: density_us76(height) + rate",
            "must have the same units",
        ),
        ("rate: 1 km", "rate: 1 km\n  thin: density_us76(-6356766)", "has no finite value"),
    ],
)
def test_mistakes_with_helpers_are_one_line(old, new, said):
    text = RISE.replace("{rate: 1 km}", "\n  rate: 1 km").replace(old, new)
    assert text.count(new) == 1
    with pytest.raises(PatchError) as caught:
        parse_patch(text, "rise.yaml")
    assert said in str(caught.value)
    assert str(caught.value).startswith("rise.yaml:")
    assert "\n" not in str(caught.value)


def test_a_bare_literal_is_in_si_units():
    parse_patch(RISE.replace("density_us76(height)", "density_us76(9144)"))
    assert value("density_us76(9144)") == value("density_us76(h)", h=9144.0)


def test_every_function_is_in_the_readme():
    text = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
    assert not [name for name in FUNCTIONS if not re.search(rf"\b{name}\b", text)]


def test_every_name_that_is_reserved_is_in_the_readme():
    text = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    named = re.findall(r"[A-Za-z_]\w*", " ".join(re.findall(r"`([^`]+)`", text)))
    (entry,) = re.findall(r"- Names of signals.*?\n- ", text, re.DOTALL)
    own = re.findall(r"\w+", " ".join(re.findall(r"`([^`]+)`", entry)))
    assert set(named) >= RESERVED_NAMES
    others = RESERVED_NAMES - set(FUNCTIONS)  # these have an entry of their own
    assert others | RESERVED_SIGNALS | {TIME_AXIS} == set(own)


KNOWN = """\
title: Heights that are known before the run
machine: ideal
parameters:
  h: 200 km
  top: 86 km
  none: 0 kg/m^3
  rho: density_us76(h)
analog:
  air: {constant: density_us76(h), full_scale: 1 kg/m^3}
  thin: {constant: "select(h > top, none, density_us76(h))", full_scale: 1 kg/m^3}
interface:
  seen: {adc: air}
digital:
  period: 10 ms
  program:
    y: density_us76(h)
    z: seen + 2*rho
run: {until: 1 s}
"""


def test_a_height_beyond_the_standard_is_told_where_it_is_known_before_the_run():
    """In a parameter, in a constant and in a word; not in the branch that is left out, nor of what is
    given from outside in place of the parameter that asked."""
    patch = parse_patch(KNOWN, "known.yaml")
    asks = "asks density_us76 for height = 200000 m, outside -5000 to 86000 (continued)"
    by_line = {
        7: f"parameter 'rho' {asks}",
        9: f"constant of component 'air' {asks}",
        16: f"word 'y' {asks}",
    }
    warnings = hybrid.check(patch, trial=False).warnings
    assert sorted(warnings) == sorted(
        f"known.yaml:{line}: {told}" for line, told in by_line.items()
    )
    note = hybrid.run(patch).status_note
    assert sorted(note.split("; ")) == sorted(by_line.values())
    rho_given = hybrid.run(patch, {"rho": 1.0}).status_note
    assert sorted(rho_given.split("; ")) == sorted(list(by_line.values())[1:])
    for inside in (86e3, 0.0, -5e3):
        assert not hybrid.run(patch, {"h": inside}).status_note
        assert not hybrid.check(patch, {"h": inside}, trial=False).warnings
    assert "height = 86000.1 m, outside" in hybrid.run(patch, {"h": 86000.1}).status_note


def test_such_heights_are_told_of_errors_and_of_the_processor_too():
    """The errors of the machine and of a component, the operations' times, the full scale of a word."""
    share = "density_us76(h)/density_us76(0)"
    text = KNOWN.replace("density_us76(h)\nanalog", "1 kg/m^3\nanalog").replace(
        "machine: ideal", f"machine: {{preset: ideal, tolerance: {share}}}"
    )
    text = text.replace("constant: density_us76(h),", f"constant: 0, offset: {share},")
    text = text.replace("    y: density_us76(h)", "    y: 2*seen").replace(
        "period: 10 ms",
        "period: 10 ms\n"
        "  compute_time: counted\n"
        f"  processor: {{add: 1e-6*{share}, multiply: 0, divide: 0}}\n"
        f'  word: {{fixed: 24, full_scale: "1e20*{share}"}}',
    )
    asks = "asks density_us76 for height = 200000 m, outside -5000 to 86000 (continued)"
    patch = parse_patch(text, "known.yaml")
    warnings = hybrid.check(patch, trial=False).warnings
    told = [line for line in warnings if "asks" in line]
    assert sorted(told) == sorted(
        f"known.yaml:{line}: {what} {asks}"
        for line, what in {
            2: "tolerance of machine",
            9: "offset of component 'air'",
            16: "add of processor",
            17: "full_scale of word of digital",
        }.items()
    )
    assert "tolerance of machine asks" in hybrid.run(patch).status_note
    assert "asks" not in "".join(hybrid.check(patch, {"h": 80e3}, trial=False).warnings)
