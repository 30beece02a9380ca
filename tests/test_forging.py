"""Certificates that are forged: whatever is altered, nothing false is ever called valid."""

import subprocess
import sys
import tomllib
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
import truth_of_mass_range
from forging import WAYS, Table, is_number, mutations, places, put, resealed, sealed_text, times
from scipy import signal

from beamdesign.checker import KINDS, Unreadable, check, reading
from beamdesign.checker.prototype import differences
from beamdesign.checker.rig import Rig
from beamdesign.controllers import Lag, Observer, Section, Structured
from beamdesign.proof.certificate import Asked
from beamdesign.proof.certifying import certify
from beamdesign.proof.rig_tables import prototype_table
from beamdesign.prototype import (
    Actuator,
    Arm,
    Beam,
    Compliance,
    Goal,
    Payload,
    Prototype,
    Sensor,
    Servovalve,
    write_prototype,
)

AT_LEAST = 500
"""Mutations for every kind of certificate, shared out among those of a kind."""
CLAIMS = ("decay_rate", 3.0), ("gain_margin", 1.05)
OF_THE_RIG = ("rig", "controller", "effect", "payload", "goal", "arm", "compliance", "material")


@dataclass(frozen=True)
class Honest:
    """A certificate as it was written, and the prototype that it is of."""

    text: str
    prototype: Prototype
    largest_kg: float

    @property
    def table(self) -> Table:
        """As it is read."""
        return tomllib.loads(self.text)

    @property
    def given(self) -> Mapping[str, Any]:
        """The prototype as it is compared."""
        return prototype_table(self.prototype, self.largest_kg)


def _paper() -> Prototype:
    """The appendix of Zalucky and Hardt (1984) in SI, with a lag and 4.5 kg inside; the outer beam by its geometry."""
    return Prototype(
        name="paper",
        outer_beam=Beam(
            stiffness_N_per_m=486_800.0, material="6061-T6", free_length_m=1.195, width_m=0.14, wall_m=0.0023,
            end_mass_kg=2.93, damping_ratio=0.05,
        ),
        inner_beam=Beam(stiffness_N_per_m=157_500.0, effective_mass_kg=1.6, damping_ratio=0.05),
        actuator=Actuator(piston_area_m2=1.13e-4, oil_stiffness_N_per_m=1.3e7),
        servovalve=Servovalve(
            flow_gain_m3_per_s_per_A=1.13e-2, leakage_m3_per_s_per_Pa=3.8e-13, natural_frequency_Hz=150.0,
            damping_ratio=0.5,
        ),
        sensor=Sensor(gain_V_per_m=1180.0),
        controller=Lag(gain_A_per_V=0.15, pole_Hz=1.75, zero_Hz=26.0),
        payload=Payload(inner_end_mass_kg=4.5, outer_end_mass_kg=(0.0, 6.8)),
    )  # fmt: skip


def _honest(prototype: Prototype, masses: tuple[float, float], *claims: tuple[str, float]) -> Honest:
    return Honest(certify(prototype, *masses, [Asked(*claim) for claim in claims]).text, prototype, masses[1])


def _stable() -> Honest:
    return _honest(_paper(), (3.0, 6.8), *CLAIMS)


def _unstable() -> Honest:
    """With both crossings in the range."""
    return _honest(_paper(), (0.0, 20.0))


def _effects() -> Honest:
    """Spans, a gain that varies, one more coordinate, filters."""
    slower = Lag(gain_A_per_V=0.05, pole_Hz=1.75, zero_Hz=26.0)
    effects: dict[str, dict[str, float]] = {"seal_friction": {}, "unequal_piston_areas": {}, "sensor_lag": {}}
    return _honest(_paper().but(controller=slower, effects=effects), (3.0, 4.0))


def _sections() -> Honest:
    """Which also bounds the loop's gain and its effort."""
    section = Section(zero_Hz=30.0, zero_damping_ratio=0.6, pole_Hz=35.0, pole_damping_ratio=0.5)
    law = Structured(gain_A_per_V=0.08, pole_Hz=1.75, zero_Hz=26.0, section=(section,))
    return _honest(_paper().but(controller=law), (3.0, 5.0), CLAIMS[0], ("controller_effort", 0.3))


def _sensors() -> Honest:
    """A lag in a realisation of its own, with a share of the load pressure, behind the sensor's filter."""
    pole, zero = 2 * np.pi * 1.75, 2 * np.pi * 26.0
    law = Observer(
        gain_A_per_V=0.1, sensors=("displacement_m", "load_pressure_Pa"), a=((-pole,),),
        b=((pole * (1 - pole / zero), 1e-9),), c=(1.0,), d=(pole / zero, 1e-9),
    )  # fmt: skip
    return _honest(
        _paper().but(controller=law, sensor=Sensor(gain_V_per_m=1180.0, filter_Hz=400.0)), (4.0, 6.0), CLAIMS[1]
    )


Truth = Callable[[Mapping[str, Any]], bool | None]
FORGED: dict[str, tuple[Truth, dict[str, tuple[Callable[[], Honest], int]]]] = {
    "beamdesign.mass_range": (
        truth_of_mass_range.true,
        {
            "stable": (_stable, 90),
            "unstable": (_unstable, 210),
            "effects": (_effects, 60),
            "sections": (_sections, 60),
            "sensors": (_sensors, 80),
        },
    ),
}
"""For every kind of certificate a model of what it states, and certificates with how many mutations of each."""
EACH = [(kind, name) for kind, (_, made) in FORGED.items() for name in made]


@cache
def honest(kind: str, name: str) -> Honest:
    """One of the certificates."""
    return FORGED[kind][1][name][0]()


@pytest.fixture
def stable() -> Honest:
    """Of the paper's remedy from 3 to 6.8 kg."""
    return honest("beamdesign.mass_range", "stable")


def valid(text: str, prototype: Any = None) -> bool:
    """Whether a certificate is proved again; nothing else may come of it than a verdict, or that it cannot be read."""
    try:
        return check(text, prototype).valid
    except Unreadable:
        return False


def is_another(table: Table, prototype: Mapping[str, Any]) -> bool:
    """Whether a certificate is told to be of another rig than a prototype; that takes no proof."""
    read = reading.Table(table)
    try:
        return any(differences(read, Rig(read), prototype))
    except Unreadable:
        return True


def figures(value: Any) -> Any:
    """A table with its numbers by their value."""
    if isinstance(value, dict):
        return {key: figures(item) for key, item in value.items()}
    if isinstance(value, list):
        return [figures(item) for item in value]
    return Fraction(value) if is_number(value) else value


def test_every_kind_is_forged_often_enough():
    assert FORGED.keys() <= KINDS.keys()
    for _, made in FORGED.values():
        assert sum(count for _, count in made.values()) >= AT_LEAST


def test_every_way_to_alter_a_certificate_is_tried():
    words = [words.split()[0] for words, _ in mutations(honest("beamdesign.mass_range", "effects").table, 1, 300)]
    assert set(words) == {way.__name__.strip("_") for way in WAYS}
    first, again = ([words for words, _ in mutations(honest(*EACH[0]).table, 7, 20)] for _ in range(2))
    assert first == again


@pytest.mark.parametrize(("kind", "name"), EACH)
def test_what_is_honest_is_valid_and_not_false(kind: str, name: str):
    made = honest(kind, name)
    assert valid(made.text)
    assert valid(made.text, made.given)
    assert valid(resealed(made.table), made.given)
    assert FORGED[kind][0](made.table) is not False


@pytest.mark.parametrize(("kind", "name"), EACH)
def test_a_verdict_repeats_every_claim_with_its_number(kind: str, name: str):
    made = honest(kind, name)
    proved = check(made.text).proved
    for claim in made.table.get("claim", []):
        assert any(f"{float(claim['limit']):.7g}" in words for words in proved)


@pytest.mark.parametrize(("kind", "name"), EACH)
def test_nothing_false_is_valid(kind: str, name: str):
    """A valid one may state something else that is true; of the same prototype, only about the same rig."""
    true, made = FORGED[kind][0], honest(kind, name)
    before, count = made.table, FORGED[kind][1][name][1]
    rig = figures({key: before[key] for key in OF_THE_RIG if key in before})
    kept = 0
    for words, forged in mutations(before, seed=1984, count=count):
        text = resealed(forged)
        if not valid(text):
            continue
        kept += 1
        assert true(forged) is not False, words
        if figures({key: forged[key] for key in OF_THE_RIG if key in forged}) != rig:
            assert is_another(forged, made.given), words
    assert 0 < kept < count / 2


# The model itself.


def test_the_model_is_the_loop_of_the_papers_equations():
    """Equations (7) to (18) put together by hand as transfer functions, with one mass on either tip."""
    made = honest("beamdesign.mass_range", "stable")
    rig = {key: float(Fraction(text)) for key, text in made.table["rig"].items() if key != "kind"}
    (loop,), mass = truth_of_mass_range.members(made.table), 5.0
    outer = [rig["outer_mass_kg"] + mass, rig["outer_damping_N_s_per_m"], rig["outer_stiffness_N_per_m"]]
    inner = [rig["inner_mass_kg"] + 4.5, rig["inner_damping_N_s_per_m"], rig["inner_stiffness_N_per_m"]]
    area, oil = rig["piston_area_m2"], rig["oil_stiffness_N_per_m"]
    # outer x = F_d + F, inner y = -F, A s (x - y) = Q - leak F / A - (A / K_c) s F.
    soft = np.array([area / oil, rig["leakage_m3_per_s_per_Pa"] / area])
    both = np.polymul(outer, inner)
    plant = np.polyadd(np.polymul(soft, both), np.polymul([area, 0.0], np.polyadd(outer, inner)))
    valve = np.polymul([1.0, 942.4777960769379, 942.4777960769379**2], [1 / (2 * np.pi * 1.75), 1.0])
    drive = 0.15 * 1180.0 * 942.4777960769379**2 * 1.13e-2 * np.array([1 / (2 * np.pi * 26.0), 1.0])
    opened, returned = np.polymul(plant, valve), np.polymul(drive, inner)
    closed = np.polyadd(opened, returned)
    poles, expected = (sorted(found, key=lambda pole: pole.imag) for found in (loop.poles(mass, 1.0), np.roots(closed)))
    np.testing.assert_allclose(poles, expected, rtol=1e-7)
    moved = np.polymul(np.polyadd(np.polymul(soft, inner), [area, 0.0]), valve)
    w = np.geomspace(1.0, 1e4, 50)
    found = loop.responses(mass, 1.0, w)
    for name, above, below in (
        ("compliance", moved, closed),
        ("peak_sensitivity", opened, closed),
        ("loop_gain", returned, opened),
    ):
        np.testing.assert_allclose(found[name], abs(signal.freqs(above, below, w)[1]), rtol=1e-7)


@pytest.mark.parametrize(("kind", "name"), [place for place in EACH if place[0] == "beamdesign.mass_range"])
def test_the_model_calls_what_was_asked_true(kind: str, name: str):
    """What was worked out as the best that can be claimed is too close to call, and left out."""
    made = honest(kind, name)
    table = made.table
    claims = [claim for claim in table.get("claim", []) if claim["kind"] not in ("compliance", "peak_sensitivity")]
    assert truth_of_mass_range.true(table | {"claim": claims}) is True


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("claim", 0, "limit"), "20"),
        (("claim", 1, "limit"), "5"),
        (("claim", 2, "limit"), "1.5"),
        (("claim", 3, "bandwidth_Hz"), "8"),
        (("claim", 3, "limit"), "0.00000005"),
        (("rig", "valve_frequency_rad_per_s"), "900"),
        (("rig", "inner_end_mass_kg"), "0"),
        (("rig", "sensor_gain_V_per_m"), "2400"),
        (("rig", "outer_mass_kg"), "30"),
        (("controller", "pole_Hz"), "1.7500001"),
        (("controller", "law", "denominator", 0), "1.1"),
        (("outer_end_mass_kg",), ["0", "6.8"]),
        (("stability", "stable"), False),
        (("stability", "range", 0, "stable"), False),
        (("stability", "range", 0, "low"), "4"),
        (("stability", "stays_stable_to_kg"), "17.8"),
        (("stability", "stays_stable_from_kg"), "1.9"),
        (("claim", 0), {"kind": "decay_rate", "limit": "3", "holds": False, "witness": {"outer_end_mass_kg": "4"}}),
    ],
)
def test_the_model_finds_what_is_false(stable: Honest, place: tuple[Any, ...], value: Any):
    table = stable.table
    put(table, place, value)
    assert truth_of_mass_range.true(table) is False
    assert not valid(resealed(table))


@pytest.mark.parametrize(
    ("name", "place", "value"),
    [
        ("unstable", ("stability", "stable"), True),
        ("unstable", ("stability", "range", 1, "stable"), False),
        ("unstable", ("stability", "range", 2, "stable"), True),
        ("unstable", ("stability", "range", 1, "high"), "17.9"),
        ("unstable", ("stability", "range", 0, "sample"), "3"),
        ("unstable", ("stability", "crossing", 0, "squared_frequency"), ["680000", "680001"]),
        ("unstable", ("stability", "crossing", 1, "frequency_Hz"), ["27", "27.1"]),
        ("unstable", ("stability", "crossing"), []),
        ("effects", ("effect", 2, "gain"), ["0.2", "4"]),
        ("effects", ("effect", 1, "elements", "volts", 0, "denominator"), ["2513.2741228718344", "40"]),
        ("effects", ("effect", 0, "elements", "impedance", 0, "resists"), ["0", "-50000"]),
        ("effects", ("effect", 0, "span", "spring_N_per_m", "performing"), ["0", "11999999.999999998"]),
        ("sections", ("controller", "section", 0, "pole_Hz"), "35.0001"),
        ("sections", ("controller", "gain_A_per_V"), "0.07"),
        ("sensors", ("controller", "a", 0, 0), "-11"),
        ("sensors", ("controller", "law", "numerators", 1, 0), "1"),
    ],
)
def test_the_model_finds_what_is_false_elsewhere(name: str, place: tuple[Any, ...], value: Any):
    table = honest("beamdesign.mass_range", name).table
    put(table, place, value)
    assert truth_of_mass_range.true(table) is False
    assert not valid(resealed(table))


# Ways in which certificates have been forged.

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
    other = _honest(heavier, (3.0, 6.8)).table
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
    told = check(sealed_text(resealed(stable.table) + "# Proved: bandwidth 50 Hz.\n"))
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


@pytest.mark.parametrize("spans", [9, 8])
def test_work_has_a_limit(stable: Honest, spans: int):
    """Too many combinations; and as many as there may be, of a high degree and with many claims."""
    span = {f"a{k}": {"ends": ["0", "1"]} for k in range(spans)}
    effect = {"name": "x", "parameters": {}, "span": span, "elements": _lags(8)}
    with pytest.raises(Unreadable, match="combinations" if spans > 8 else "work"):
        check(resealed(stable.table | {"effect": [effect], "claim": [stable.table["claim"][0]] * 200}))


def test_a_point_is_no_coordinate_and_no_effect_stands_twice(stable: Honest):
    effect = {"name": "x", "parameters": {}, "elements": {"points": {"tip": {"base": "1"}}}}
    with pytest.raises(Unreadable, match="coordinates"):
        check(resealed(stable.table | {"effect": [effect]}))
    effect["elements"] = {}
    assert valid(resealed(stable.table | {"effect": [effect]}))
    with pytest.raises(Unreadable, match="twice"):
        check(resealed(stable.table | {"effect": [effect, effect]}))


def test_the_first_format_is_to_be_made_again(stable: Honest):
    with pytest.raises(Unreadable, match="again"):
        check(resealed(stable.table | {"version": 1}))


@pytest.mark.parametrize("depth", [31, 40, 5000])
def test_nesting_has_a_limit(stable: Honest, depth: int):
    with pytest.raises(Unreadable):
        check(sealed_text(resealed(stable.table) + f"[deep]\nx = {'[' * depth}{']' * depth}\n"))


def test_no_place_takes_a_value_of_another_type(stable: Honest):
    """Every single place, with a whole number, a word and a table; of the name any text will do."""
    before = {key: value for key, value in stable.table.items() if key not in ("name", "sha256")}
    for place, value in [*places(before)][1:]:
        for other in (1, "x", {"x": {}}):
            if type(other) is not type(value) or is_number(value):
                table = deepcopy(before) | {"name": "paper"}
                put(table, place, other)
                assert not valid(resealed(table)), (place, other)
