"""Ways in which certificates over a mass range have been forged, each by name, alone and with the prototype."""

import subprocess
import sys
from collections.abc import Callable
from copy import deepcopy
from fractions import Fraction
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from forging import Table, put, resealed, sealed_text, times
from honest_certificates import SHARE, Honest, certified, honest, share_of_work, valid

from beamdesign import check, write_prototype
from beamdesign.checker import Unreadable
from beamdesign.controllers import Lag
from beamdesign.proofs.writer import prototype_table
from beamdesign.prototype import Arm, Compliance, Goal, Payload


@pytest.fixture
def stable() -> Honest:
    """Of the paper's remedy from 3 to 6.8 kg."""
    return honest("beamdesign.mass_range", "stable")


SERVO = Lag(gain_A_per_V=0.003, pole_Hz=3.0, zero_Hz=500.0)


@pytest.mark.parametrize(
    "change",
    [
        {"arm": Arm(offset_m=(0.0, 0.9, 0.0))},
        {"compliance": Compliance(end_stiffness_N_per_m=3e5, force_filter_Hz=100.0, servo=SERVO)},
        {"payload": Payload(inner_end_mass_kg=4.5, outer_end_mass_kg=(0.0, 50.0))},
        {"goal": Goal(peak_sensitivity=1.2)},
        {"effects": {"sensor_lag": {}}},
    ],
    ids=["arm", "compliance", "payload", "goal", "effects"],
)  # fmt: skip
def test_it_is_not_of_another_prototype(stable: Honest, tmp_path: Path, change: dict[str, Any]):
    other = stable.prototype.but(**change)
    write_prototype(other, tmp_path / "prototype.toml")
    for given in (tmp_path / "prototype.toml", prototype_table(other, 6.8)):
        assert valid(stable.text)
        assert not valid(stable.text, given)


ARABIC = str.maketrans("0123456789", "\u0660\u0661\u0662\u0663\u0664\u0665\u0666\u0667\u0668\u0669")


@pytest.mark.parametrize(
    "written",
    ["3.0 ", " 3", "3_0", "+3", "3e0", ".5", "5.", "0x3", "1/0", "3/-1", "3".translate(ARABIC), "3" * 4000, 3.0, 3],
)
@pytest.mark.parametrize(
    "place", [("claim", 0, "limit"), ("rig", "outer_mass_kg"), ("outer_end_mass_kg", 0), ("goal", "peak_sensitivity")]
)
def test_numbers_are_of_one_grammar(stable: Honest, place: tuple[Any, ...], written: Any):
    table = stable.table
    put(table, place, written)
    with pytest.raises(Unreadable):
        check(resealed(table))


def test_no_figure_is_overridden():
    effects = honest("beamdesign.mass_range", "effects")
    for table in (effects.table | {"member": {"frozen": {"sensor_lag": {"break_Hz": "2000"}}}}, effects.table):
        if "member" not in table:
            table["effect"][1]["frozen"] = {"break_Hz": "2000"}
        with pytest.raises(Unreadable):
            check(resealed(table))


def _narrower(table: Table) -> None:
    table["effect"][2] |= {"gain": ["0.999", "1.001"], "performing_gain": ["0.999", "1.001"]}


def _without_member(table: Table) -> None:
    table["effect"][0]["span"]["spring_N_per_m"]["ends"] = ["0", "0"]


def _negative(table: Table) -> None:
    table["effect"][1]["parameters"]["break_Hz"] = "-400"


def _faster(table: Table) -> None:
    table["effect"][1]["elements"]["volts"] = []


def _renamed(table: Table) -> None:
    table["name"] = f"{table['name']} with {table['effect'].pop(0)['name']}"


@pytest.mark.parametrize("change", [_narrower, _without_member, _negative, _faster, _renamed])
def test_effects_are_those_of_the_prototype(change: Callable[[Table], None], tmp_path: Path):
    """From a file alone nobody can tell what an effect is made of, which is then told for each."""
    effects = honest("beamdesign.mass_range", "effects")
    table = effects.table
    names = [effect["name"] for effect in table["effect"]]
    assert names == ["seal_friction", "sensor_lag", "unequal_piston_areas"]
    change(table)
    write_prototype(effects.prototype, tmp_path / "prototype.toml")
    told = check(resealed(table), tmp_path / "prototype.toml")
    assert not told.valid or all(any(name in words for words in told.open) for name in names)
    assert not valid(resealed(table), effects.given)


@pytest.mark.parametrize("name", ["'''", '"""', '[rig]\nouter_mass_kg = "3.9"', 'sha256 = "0"'])
def test_figures_of_another_rig_in_a_text_are_not_its_own(stable: Honest, name: str):
    heavier = stable.prototype.but(inner_beam=stable.prototype.inner_beam.but(effective_mass_kg=2.6))
    other = certified(heavier, (3.0, 6.8)).table
    other["name"] = f"{name}\n{stable.text}\n{name}"
    assert valid(resealed(other))
    assert not valid(resealed(other), stable.given)
    plain = "\n".join(line for line in stable.text.splitlines() if not line.startswith("sha256"))
    written = resealed(other).replace(tomli_w.dumps({"name": other["name"]}), f"name = '''\n{plain}'''\n")
    assert valid(sealed_text(written))
    assert not valid(sealed_text(written), stable.given)


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("claims",), [{"kind": "gain_margin", "limit": "9", "holds": True}]),
        (("bandwidth_Hz",), "50"),
        (("rig", "outer_length_m"), "1.5"),
        (("goal", "bandwidth_Hz"), "50"),
        (("payload", "proved"), "50"),
        (("arm",), {"proved": "1"}),
        (("claim", 0, "reason"), "it has been proved"),
        (("stability", "stable_for"), "every mass"),
        (("controller", "note"), "stable"),
        (("controller", "law", "unit"), "A/V"),
        (("stability", "range", 0, "until"), "9"),
    ],
)
def test_what_nothing_asks_for_is_refused(stable: Honest, place: tuple[Any, ...], value: Any):
    table = stable.table
    put(table, place, value)
    with pytest.raises(Unreadable):
        check(resealed(table))


def test_comments_are_told_to_prove_nothing(stable: Honest):
    bare = check(resealed(stable.table))
    behind = resealed(stable.table).replace("stable = true\n", "stable = true # at 0 to 50 kg\n", 1)
    for text in (resealed(stable.table) + "# Proved: bandwidth 50 Hz.\n", behind):
        told = check(sealed_text(text))
        assert told.proved == bare.proved
        assert len(told.open) == len(bare.open) + 1


def test_the_guarantee_of_a_prototype_is_that_of_the_file(stable: Honest, tmp_path: Path):
    path = tmp_path / "certificate.toml"
    path.write_text(stable.text)
    digest = sha256(path.read_bytes()).hexdigest()
    given = {**stable.given, "guarantee": {"certificate": path.name, "certificate_sha256": digest}}
    assert check(path, given).valid
    table = stable.table
    table["claim"] = table["claim"][:1]
    path.write_text(resealed(table))
    assert check(path).valid
    assert not check(path, given).valid


def test_payloads_of_the_prototype_do_not_stand_for_those_proved():
    """Of several loops without a range, next to a [payload] up to 50 kg, no line said that three grams were proved."""
    table = honest("beamdesign.mass_range", "effects").table
    payload = table["payload"] | {"outer_end_mass_kg": ["0", "50"]}
    ends = {"outer_end_mass_kg": ["3", "3.003"], "stability": {"stable": True}, "payload": payload, "claim": []}
    told = check(resealed(table | ends))
    assert told.valid
    for lines in (told.about, told.proved):
        assert any("3 to 3.003 kg" in words for words in lines)


def test_a_guarantee_of_another_file_is_told_not_to_be_looked_at(stable: Honest, tmp_path: Path):
    """It stood beside `valid` as if it were proved, whatever it stated."""
    path = tmp_path / "certificate.toml"
    path.write_text(stable.text)
    states = {"bandwidth_Hz": 99.0, "peak_sensitivity": 1.01, "outer_end_mass_kg": [0.0, 50.0]}
    for name in ("certificate.box.toml", "./certificate.toml", "sub/certificate.toml"):
        stated = states | {"certificate": name, "certificate_sha256": "0" * 64}
        told = check(path, {**stable.given, "guarantee": stated})
        assert len([words for words in told.open if "[guarantee]" in words]) == 1
    assert not any("[guarantee]" in words for words in check(path, stable.given).open)


def test_a_prototype_is_read_whole_or_not_at_all(stable: Honest, tmp_path: Path):
    """Behind eight million bytes stood an effect that was not seen: the rig was called that of the certificate."""
    path = tmp_path / "prototype.toml"
    write_prototype(stable.prototype, path)
    assert check(stable.text, path).valid
    with path.open("a") as file:
        file.write(("#" * 999 + "\n") * 8_010 + "[effects.joint_backlash]\n")
    with pytest.raises(Unreadable, match="the prototype: it holds more than 8000000 bytes"):
        check(stable.text, path)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('limit = "3"', "limit = {}"),
        ("version = 2", "version = {}"),
        ('kind = "lag"', 'kind = "homemade"\nx = {}'),
        ("lower_gains = true", "lower_gains = {}"),
    ],
)
def test_a_whole_number_too_long_to_print_is_refused(stable: Honest, before: str, after: str):
    """Python prints none of more than 4300 digits, and a hexadecimal one has no limit: it ended in a traceback."""
    text = resealed(stable.table)
    assert text.count(before) == 1
    with pytest.raises(Unreadable, match="more than 64 bits"):
        check(sealed_text(text.replace(before, after.format("0x" + "f" * 5000))))


def test_so_is_one_of_a_prototype(stable: Honest, tmp_path: Path):
    path = tmp_path / "prototype.toml"
    write_prototype(stable.prototype, path)
    for entry in ("[actuator]\nkind", "[effects]\nsensor_lag.break_Hz"):
        path.write_text(f"{entry} = 0x{'f' * 5000}\n")
        with pytest.raises(Unreadable, match="the prototype: it holds a whole number"):
            check(stable.text, path)


def test_alloys_are_those_of_the_prototype(stable: Honest, tmp_path: Path):
    """A denser alloy that goes with a heavier beam: known from the table with the alloys' figures, and told else."""
    table = stable.table
    ((name, alloy),) = table["material"].items()
    own = (Fraction(table["rig"]["outer_mass_kg"]) - Fraction("2.93")) / Fraction(alloy["density_kg_per_m3"])
    alloy["density_kg_per_m3"] = "2900"
    heavier = Fraction("2.93") + own * 2900
    table["rig"]["outer_mass_kg"] = f"{heavier.numerator}/{heavier.denominator}"
    forged = resealed(table | {"claim": [], "stability": _short(table["stability"])})
    write_prototype(stable.prototype, tmp_path / "prototype.toml")
    told = check(forged, tmp_path / "prototype.toml")
    assert any(name in words for words in told.open)
    assert not valid(forged, stable.given)


def _short(stability: Table) -> Table:
    """Without what it says of masses that nobody asked for."""
    return {key: value for key, value in stability.items() if not key.startswith("stays")}


ALONE = """
import runpy, sys
class Nothing:
    def find_spec(self, name, path=None, target=None):
        top, _, rest = name.partition(".")
        own = top == "beamdesign" and (not rest or rest.split(".")[0] == "checker")
        if not own and top not in {"flint", *sys.stdlib_module_names}:
            raise ImportError(name + " is not to be imported")
sys.meta_path.insert(0, Nothing())
sys.path.insert(0, sys.argv.pop(1))
sys.argv[0] = "checker"
runpy.run_module("beamdesign.checker", run_name="__main__")
"""


@pytest.mark.parametrize(
    ("what", "status"), [("honest", 0), ("false", 1), ("unsealed", 1), ("unknown", 2), ("none", 2)]
)
def test_exit_statuses_with_flint_and_the_standard_library_alone(
    stable: Honest, tmp_path: Path, what: str, status: int
):
    texts = {"honest": stable.text, "unsealed": stable.text.replace("# Certificate", "# certificate", 1)}
    table = deepcopy(stable.table)
    put(table, ("claim", 0, "limit"), times(table["claim"][0]["limit"], "10"))
    texts["false"] = resealed(table)
    texts["unknown"] = resealed(stable.table | {"bandwidth_Hz": "50"})
    if what in texts:
        (tmp_path / "certificate.toml").write_text(texts[what])
    write_prototype(stable.prototype, tmp_path / "prototype.toml")
    root = str(Path(sys.modules["beamdesign"].__file__ or "").parents[1])
    for given in ([], ["prototype.toml"]):
        done = subprocess.run(
            [sys.executable, "-I", "-W", "error", "-c", ALONE, root, "certificate.toml", *given],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == status, done.stderr
        assert bool(done.stdout) is (status < 2)
        assert "Traceback" not in done.stderr


def _lags(count: int) -> Table:
    return {"volts": [{"numerator": ["1"], "denominator": ["1", "1/1000"]} for _ in range(count)]}


def _coordinates(count: int) -> Table:
    return {"impedance": [{"motion": {f"x{k}": "1" for k in range(count)}, "resists": ["1", "1", "1"]}]}


@pytest.mark.parametrize("elements", [_lags(61), _coordinates(31), _coordinates(5000)])
def test_degrees_have_a_limit(stable: Honest, elements: Table):
    with pytest.raises(Unreadable, match="degree"):
        check(resealed(stable.table | {"effect": [{"name": "x", "parameters": {}, "elements": elements}]}))


def test_states_of_a_controller_have_a_limit():
    table = honest("beamdesign.mass_range", "sensors").table
    table["controller"] |= {"a": [["0"] * 61] * 61, "b": [["0", "0"]] * 61, "c": ["0"] * 61}
    with pytest.raises(Unreadable, match="states"):
        check(resealed(table))


@pytest.mark.parametrize("spans", [7, 6])
def test_work_has_a_limit(stable: Honest, spans: int):
    """Too many combinations; and as many as there may be, of a high degree and with many claims."""
    span = {f"a{k}": {"ends": ["0", "1"]} for k in range(spans)}
    effect = {"name": "x", "parameters": {}, "span": span, "elements": _lags(12)}
    with share_of_work(8 * SHARE), pytest.raises(Unreadable, match="combinations" if spans > 6 else "work"):
        check(resealed(stable.table | {"effect": [effect], "claim": [stable.table["claim"][0]] * 64}))


def test_a_point_is_no_coordinate_and_no_effect_stands_twice(stable: Honest):
    effect = {"name": "x", "parameters": {}, "elements": {"points": {"tip": {"base": "1"}}}}
    with pytest.raises(Unreadable, match="coordinates"):
        check(resealed(stable.table | {"effect": [effect]}))
    effect["elements"] = {}
    assert valid(resealed(stable.table | {"effect": [effect]}))
    with pytest.raises(Unreadable, match="twice"):
        check(resealed(stable.table | {"effect": [effect, effect]}))


def test_no_filter_differentiates(stable: Honest):
    elements = {"volts": [{"numerator": ["1", "1/1000"], "denominator": ["1"]}]}
    with pytest.raises(Unreadable, match="of no rig"):
        check(resealed(stable.table | {"effect": [{"name": "x", "parameters": {}, "elements": elements}]}))


def test_the_first_format_is_to_be_made_again(stable: Honest):
    with pytest.raises(Unreadable, match="again"):
        check(resealed(stable.table | {"version": 1}))


@pytest.mark.parametrize("depth", [31, 40, 5000])
def test_nesting_has_a_limit(stable: Honest, depth: int):
    with pytest.raises(Unreadable):
        check(sealed_text(resealed(stable.table) + f"[deep]\nx = {'[' * depth}{']' * depth}\n"))
