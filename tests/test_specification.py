"""The specification: its figures are those of the record, in the units a workshop reads."""

import re
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
from finished_run import finished_run
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import block_diag, eigh

from beamdesign import Prototype, certify, read_prototype
from beamdesign.build.folder import document_of, proved_statements
from beamdesign.build.ratings import SensorNeed, held_loads, nearest_stock_tube
from beamdesign.build.result_folder import FILES
from beamdesign.build.specification import specification_of
from beamdesign.build.tolerances import LARGEST, FigureTolerance, Tolerances
from beamdesign.controllers import Lag, Proportional
from beamdesign.loop import loop
from beamdesign.prototype import Arm, InStage
from beamdesign.quantities import compliance_kept
from beamdesign.report.page import to_markdown
from beamdesign.spelling import in_markdown
from beamdesign.structure.lumped import lumped_beam, weighing_mass
from beamdesign.structure.section import SHAPES, Tube, stock_tubes
from beamdesign.synthesis.design_run import DesignRun


@pytest.fixture(scope="module")
def run() -> DesignRun:
    return finished_run()


@pytest.fixture(scope="module")
def prototype(run: DesignRun) -> Prototype:
    assert run.prototype is not None
    return run.prototype


@pytest.fixture(scope="module")
def text(run: DesignRun) -> str:
    return markdown(run)


def markdown(run: DesignRun) -> str:
    return to_markdown(document_of(specification_of(run)))


def rows(text: str) -> dict[str, list[str]]:
    """Cells of every table row by its first cell."""
    found = [re.split(r"(?<!\\)\|", line)[1:-1] for line in text.splitlines() if line.startswith("|")]
    return {cells[0].strip(): [cell.strip(" *") for cell in cells[1:]] for cells in found}


def test_no_figure_is_called_the_tightest_where_none_has_a_limit(run: DesignRun) -> None:
    need = SensorNeed(30.0, 2000.0, 300.0, 4.6, 2.1, 1e-4, 0.1, 1e-5, 100.0, 1e-6, 1e-5, None, None)
    wide = FigureTolerance("outer_stiffness", LARGEST, None, 0.1, 0.05, None, None)
    for figure, words in (
        (wide, "each figure alone"),
        (replace(wide, alone=0.2, alone_refuted=0.21), "tightest figure alone: outer_stiffness"),
    ):
        found = Tolerances((figure,), 0.1, None, None, (), ())
        told = replace(specification_of(run), laws=(), sensor=need, tolerances=found).rows()
        assert (words, f"± {100 * figure.alone:g} %", "proved") in told


def number(cell: str) -> float:
    return float(cell.split()[0])


def test_tubes_and_masses_are_the_records(text: str, prototype: Prototype) -> None:
    table = rows(text)
    beams = (prototype.outer_beam, prototype.inner_beam)
    for column, beam in enumerate(beams):
        assert None not in (beam.width_m, beam.wall_m, beam.length_m, beam.free_length_m)
        width, _, wall = (float(size) for size in re.findall(r"[\d.]+", table["outside width × width × wall"][column]))
        assert (width, wall) == pytest.approx((1e3 * beam.width_m, 1e3 * beam.wall_m))
        assert number(table["cut length"][column]) == pytest.approx(1e3 * beam.length_m)
        assert number(table["free, clamp to tip"][column]) == pytest.approx(1e3 * beam.free_length_m)
        assert number(table["clamped"][column]) == pytest.approx(1e3 * (beam.length_m - beam.free_length_m))
        assert table["material"][column] == beam.material.name
        assert number(table["always fixed to the tip (actuator module)"][column]) == beam.end_mass_kg
        # A sharp-cornered square tube of 6061 by hand: 2700 kg/m3, four walls less their corners.
        by_hand = 2700 * beam.length_m * (beam.width_m**2 - (beam.width_m - 2 * beam.wall_m) ** 2)
        assert number(table["mass of the tube"][column]) == pytest.approx(by_hand, rel=1e-3)
    assert number(table["to be added"][1]) == prototype.payload.inner_end_mass_kg


def test_controller_is_given_in_full(text: str, prototype: Prototype) -> None:
    table, controller = rows(text), prototype.controller
    assert isinstance(controller, Lag)
    assert 1e-3 * number(table["gain"][0]) == pytest.approx(controller.gain_A_per_V, rel=1e-9)
    assert number(table["pole"][0]) == pytest.approx(controller.pole_Hz, rel=1e-9)
    assert number(table["zero"][0]) == pytest.approx(controller.zero_Hz, rel=1e-9)


def test_guarantees_are_stated_with_their_certificate(text: str, prototype: Prototype) -> None:
    guarantee = prototype.guarantee
    assert guarantee is not None
    assert guarantee.certificate_sha256 in text
    assert f"beamdesign certify --replay {FILES['certificate']}" in text
    bandwidth = float(re.search(r"every frequency up to ([\d.]+) Hz", text)[1])
    assert bandwidth == pytest.approx(guarantee.bandwidth_Hz, rel=1e-6)
    assert bandwidth <= guarantee.bandwidth_Hz
    peak = float(re.search(r"1/\(1\+L\)\\\| at most ([\d.]+)", text)[1])
    assert guarantee.peak_sensitivity <= peak < 1.001 * guarantee.peak_sensitivity
    claims = text.split("## What is guaranteed")[1].split("\n## ")[0]
    assert claims.count("| proved |") == 5
    assert "refuted" not in text


def test_deflections_are_force_over_stiffness(text: str, run: DesignRun, prototype: Prototype) -> None:
    force, table = run.problem.load.tip_force_N, rows(text)
    inner, outer = (lumped_beam(beam) for beam in (prototype.inner_beam, prototype.outer_beam))
    on, off = (cells for name, cells in table.items() if name.startswith(("servo on: ", "servo off: ")))
    assert number(on[0]) == pytest.approx(1e3 * force / inner.stiffness, rel=1e-3)
    assert number(off[0]) == pytest.approx(1e3 * force / outer.stiffness, rel=1e-3)
    for load in held_loads(prototype, force):  # the published pair leaves 17.7 mm each side at assembly
        assert load.deflection_m + load.gap_left_m == pytest.approx(0.0177)
    assert number(on[1]) == pytest.approx(17.7 - number(on[0]), abs=2e-2)
    # With weight: that of payload and outer beam bends the inner one as the load does, and its own 3/8 m g at the tip.
    heavy, light = (weighing_mass(beam) for beam in (prototype.outer_beam, prototype.inner_beam))
    weight = 9.80665 * (6.8 + heavy + light + prototype.payload.inner_end_mass_kg)
    (weighed,) = (cells for name, cells in table.items() if name.startswith("servo on, beside the weight"))
    assert number(weighed[0]) == pytest.approx(1e3 * (force + weight) / inner.stiffness, rel=1e-3)
    assert number(weighed[1]) == pytest.approx(17.7 - number(weighed[0]), abs=2e-2)


def test_load_pressure_is_the_papers(text: str, prototype: Prototype) -> None:
    # 2000 N on 1.13 cm2 is 17.7 MPa, with the weight still below the 20 MPa supply of Zalucky and Hardt (1984).
    pressure = number(rows(text)["load pressure that holds load and weight at rest, F/A"][0])
    weight_N = 9.80665 * (6.8 + weighing_mass(prototype.outer_beam))
    assert pressure - 1e-6 * weight_N / 1.13e-4 == pytest.approx(17.7, abs=0.05)
    assert pressure < 20.0


def test_acceptance_gains_make_the_loop_oscillate(text: str, prototype: Prototype) -> None:
    controller, masses = prototype.controller, prototype.payload.outer_end_mass_kg
    assert controller is not None
    assert masses is not None
    table = {name: cells for name, cells in rows(text).items() if re.fullmatch(r"[\d.]+ kg", name)}
    assert [number(name) for name in table] == pytest.approx(list(InStage(prototype, masses).looked_at_kg))
    lines = [line for line in text.splitlines() if re.match(r"\| [\d.]+ kg \| [\d.]+ mA/V", line)]
    assert len(lines) == len(table)
    for line in lines:
        mass, gain, frequency = (float(figure) for figure in re.findall(r"\| ([\d.]+) (?:kg|mA/V|Hz)", line)[:3])
        raised = prototype.but(controller=controller.but(gain_A_per_V=1e-3 * gain))
        poles = loop(raised).at(mass).poles()
        critical = poles[np.argmin(abs(abs(poles.imag) - 2 * pi * frequency))]
        assert abs(critical.real) < 2e-3 * abs(critical.imag)  # four digits of gain are shown
        assert abs(critical.imag) == pytest.approx(2 * pi * frequency, rel=1e-3)


def test_names_stay_one_line_of_text(text: str, run: DesignRun) -> None:
    title = text.splitlines()[0]
    assert re.sub(r"\\(.)", r"\1", title) == f"# Specification: {run.problem.name}"
    assert re.search(r"(?<!\\)[<*|]", title) is None


@given(st.text(alphabet="ab9 .\n\r\t\x1c\x85\u2028\\`*_{}[]<>#|!~&", max_size=30))
def test_escaped_text_has_no_live_marks(name: str) -> None:
    escaped = in_markdown(name)
    assert re.sub(r"\\(.)", r"\1", escaped) == re.sub(r"\s+", " ", name)
    assert re.search(r"(?<!\\)(?:\\\\)*[`*_<>|]", escaped) is None
    assert len(escaped.splitlines()) <= 1


@given(width=st.floats(0.02, 0.3), share=st.floats(0.01, 0.3))
def test_nearest_stock_is_stiff_enough_and_no_heavier_than_need_be(width: float, share: float) -> None:
    wall = share * width
    made = Tube(width, wall)
    found, needed = nearest_stock_tube(made), made.second_moment
    enough = [tube for tube in stock_tubes() if tube.wall_m >= wall and tube.second_moment >= needed]
    if enough:
        assert found.area <= min(tube.area for tube in enough) * (1 + 1e-12)
    near_enough = found.wall_m >= wall * (1 - 1e-8) and found.second_moment >= needed * (1 - 1e-8)
    stiffest = max(tube.second_moment for tube in stock_tubes())
    assert near_enough or (not enough and found.second_moment == stiffest)


def test_a_stock_size_is_its_own_nearest() -> None:
    assert all(nearest_stock_tube(tube) == tube for shape in SHAPES for tube in stock_tubes(shape))


def test_a_stock_size_that_is_less_stiff_is_called_so(run: DesignRun, prototype: Prototype) -> None:
    """Of a square tube I = (w^4 - (w - 2 t)^4) / 12; the list ends at 0.2 m and 10 mm, a third less stiff than this."""
    wide = prototype.outer_beam.but(width_m=0.3, wall_m=0.004, stiffness_N_per_m=None, effective_mass_kg=None)
    text = markdown(replace(run, prototype=prototype.but(outer_beam=wide)))
    share = (0.2**4 - 0.18**4) / (0.3**4 - 0.292**4)
    (row,) = (line for line in text.splitlines() if ", less stiff |" in line)
    assert row.startswith(f"| outer | 200 × 200 × 10 mm, less stiff | stiffness -{100 * (1 - share):.1f} %"), row
    assert "less stiff |" not in markdown(run)


def test_proportional_control_has_its_gain_alone(run: DesignRun, prototype: Prototype) -> None:
    plain = prototype.but(controller=Proportional(gain_A_per_V=0.002))
    text = markdown(DesignRun(run.problem, run.sizing, run.tuning, run.certificate, plain))
    assert "pole" not in rows(text)
    assert number(rows(text)["gain"][0]) == 2.0


def test_nothing_is_specified_without_a_result(run: DesignRun) -> None:
    with pytest.raises(ValueError, match="nothing fits"):
        specification_of(DesignRun(run.problem, run.sizing, None, None, None, "nothing fits"))


def test_an_end_that_is_meant_to_yield_is_promised_no_bandwidth() -> None:
    soft = read_prototype(Path(__file__).parent.parent / "studies" / "prototypes" / "compliant.toml")
    found = certify(soft, 6.8, 6.8)
    assert {one.foundation for one in proved_statements(found, soft.goal.compliance_m_per_N)} == {"proved"}
    assert compliance_kept(5.71e-8, 0.0) == "gives way by more than 57.1 nm/N even to a steady force"
    assert compliance_kept(5.71e-8, 2.5) == "gives way by no more than 57.1 nm/N up to 2.5 Hz"


def test_a_sensor_of_which_nothing_is_proved_is_promised_nothing(run: DesignRun) -> None:
    spec = specification_of(run)
    good = SensorNeed(30.0, 2000.0, 300.0, 4.6, 2.1, 1e-4, 0.1, 1e-5, 100.0, 1e-6, 1e-5, None, None)
    none = replace(
        good, stable_from_Hz=None, performs_from_Hz=None, bandwidth_Hz=None, peak_sensitivity=None, noise_m=None
    )
    told, refused = (" ".join(to_markdown(document_of(replace(spec, sensor=need))).split()) for need in (good, none))
    for promise in ("At the second bandwidth", "Stability from that bandwidth is proved"):
        assert promise in told
        assert promise not in refused
    for refusal in (
        "From no first-order break up to 2000 Hz on is stability proved.",
        "With no first-order break up to 2000 Hz were loop bandwidth and peak sensitivity proved within 5 %",
    ):
        assert refusal in refused
        assert refusal not in told


def test_a_bandwidth_is_stated_alike_where_it_is_guaranteed_and_rated(text: str) -> None:
    """To the digits of the guarantee, none of them rounded up."""
    guaranteed = rows(text)["guaranteed bandwidth (proved)"][0]
    assert f"up to the guaranteed bandwidth of {guaranteed}, beside" in " ".join(text.split())


def test_what_is_worked_out_without_effects_or_offsets_says_so(run: DesignRun, prototype: Prototype) -> None:
    lagging = prototype.but(effects={"sensor_lag": {"break_Hz": 2000.0}})
    aside = prototype.but(arm=Arm(offset_m=(0.1, 0.0, 0.0)))
    texts = [
        " ".join(markdown(replace(run, prototype=one)).replace("\\", "").split()) for one in (prototype, lagging, aside)
    ]
    for words, told in (
        ("worked out without sensor_lag; the loop", [False, True, False]),
        ("linear loop that stands at rest for sensor_lag", [False, True, False]),
        ("The linear model has no friction, dead band, saturation or air", [True, False, True]),
        ("loops with payload and sensor on the beam's axis", [False, False, True]),
    ):
        assert [words in text for text in texts] == told


def test_a_rating_that_is_stated_and_less_than_needed_is_told(run: DesignRun, prototype: Prototype) -> None:
    weak = prototype.but(actuator=prototype.actuator.but(stroke_m=1e-3))
    needed, stated, _ = rows(markdown(replace(run, prototype=weak)))["stroke from end to end, × 1.25"]
    assert (number(needed) > 1, stated) == (True, "1 mm, less than needed")
    assert rows(markdown(run))["stroke from end to end, × 1.25"][1] == "–"


def least_damped(rig: Prototype, payload_kg: float, gain_A_per_V: float, elements: int = 12) -> float:
    """Largest real part of the poles of the loop with beams of finite elements (Euler and Bernoulli), 1/s.

    A beam has its damping ratio in every mode that it has with its end mass, without payload.
    """
    matrices, tips = [], []
    for beam, added in ((rig.outer_beam, payload_kg), (rig.inner_beam, rig.payload.inner_end_mass_kg)):
        alloy, tube, length = beam.geometry
        step, size = length / elements, 2 * elements + 2
        part = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]], dtype=float)
        moved = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]], dtype=float)
        turns = np.diag([1.0, step, 1.0, step])
        stiffness, mass = np.zeros((size, size)), np.zeros((size, size))
        for at in range(0, size - 2, 2):
            here = slice(at, at + 4)
            stiffness[here, here] += lumped_beam(beam).stiffness * length**3 / 3 / step**3 * turns @ part @ turns
            mass[here, here] += tube.mass_per_length(alloy.density_kg_per_m3) * step / 420 * turns @ moved @ turns
        stiffness, mass = stiffness[2:, 2:], mass[2:, 2:]
        mass[-2, -2] += beam.end_mass_kg
        squares, modes = eigh(stiffness, mass)
        damping = mass @ modes @ np.diag(2 * beam.damping_ratio * np.sqrt(squares)) @ modes.T @ mass
        mass[-2, -2] += added
        matrices.append((stiffness, damping, mass))
        tips.append(np.eye(2 * elements)[-2])
    stiffness, damping, mass = (block_diag(*pair) for pair in zip(*matrices, strict=True))
    apart, outer = np.concatenate([tips[0], -tips[1]]), np.concatenate([tips[0], 0 * tips[1]])
    count, law, valve = len(mass), rig.controller, rig.servovalve
    area, oil, w = rig.actuator.piston_area_m2, rig.actuator.oil_stiffness_N_per_m, 2 * pi * valve.natural_frequency_Hz
    lag, lead = 2 * pi * law.pole_Hz, 2 * pi * law.zero_Hz
    # displacements, their rates, the cylinder's end, flow and its rate, the lag's state
    a = np.zeros((2 * count + 4, 2 * count + 4))
    force, error = np.zeros(len(a)), np.zeros(len(a))
    force[:count], force[2 * count] = -oil * apart, oil
    error[:count] = -rig.sensor.gain_V_per_m * outer
    current = gain_A_per_V * lag / lead * error
    current[-1] = gain_A_per_V * (1 - lag / lead)
    a[:count, count : 2 * count] = np.eye(count)
    a[count : 2 * count, :count], a[count : 2 * count, count : 2 * count] = (
        -np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping),
    )  # fmt: skip
    a[count : 2 * count] += np.outer(np.linalg.solve(mass, apart), force)
    a[2 * count] = -valve.leakage_m3_per_s_per_Pa / area**2 * force
    a[2 * count, 2 * count + 1] += 1 / area
    a[2 * count + 1, 2 * count + 2] = 1.0
    a[2 * count + 2] = w**2 * valve.flow_gain_m3_per_s_per_A * current
    a[2 * count + 2, 2 * count + 1] -= w**2
    a[2 * count + 2, 2 * count + 2] -= 2 * valve.damping_ratio * w
    a[-1] = lag * error
    a[-1, -1] -= lag
    return float(np.linalg.eigvals(a).real.max())


def test_where_all_modes_oscillate_below_the_limits_it_is_told(run: DesignRun, prototype: Prototype) -> None:
    """Of beams so long that their second modes come near; by finite elements."""
    long = prototype
    for name in ("outer_beam", "inner_beam"):
        beam = getattr(prototype, name)
        longer = beam.but(length_m=1.6 * beam.length_m, free_length_m=1.6 * beam.free_length_m)
        long = long.but(**{name: longer})
    told = [" ".join(markdown(replace(run, prototype=one)).split()) for one in (prototype, long)]
    assert ["With all modes of both a rig as specified" in text for text in told] == [False, True]
    found = re.findall(r"with ([\d.]+) kg from [\d.]+ mA/V down to ([\d.]+) mA/V", told[1])
    assert [float(mass) for mass, _ in found] == pytest.approx([0.0, 3.4, 6.8])
    for mass, gain in found:
        below, above = (least_damped(long, float(mass), share * 1e-3 * float(gain)) for share in (0.99, 1.01))
        assert below < 0 < above
