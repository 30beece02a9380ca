"""The part of the specification that says how to accept what was built."""

from beamdesign.lumped import lumped_beam
from beamdesign.prototype import Prototype
from beamdesign.report.quantity import decimal, quantity
from beamdesign.scenario import LoadSteps, Multisine, ScenarioRecord
from beamdesign.specification.acceptance_bands import MEASURED_WITHIN, Band
from beamdesign.specification.document import Block, Code, Items, Paragraph, Part, Table
from beamdesign.specification.specification import LawSpecification

FOLDER = "acceptance"


def acceptance_part(spec: LawSpecification) -> Part:
    """Excitations, expected measurements with limits, and the folder to fill in."""
    plan, controller, folder = spec.plan, spec.stage.prototype.controller, f"{FOLDER}{spec.stage.suffix}"
    assert plan is not None
    assert controller is not None
    scenario = plan.scenario
    bare = _bare(spec.stage.prototype)
    blocks: list[Block] = [
        Items(
            (
                f"Before the loop is closed, tap each beam alone: outer {quantity(bare[0], 'Hz')} (module on, no"
                " payload),"
                f" inner {quantity(bare[1], 'Hz')} (its end mass on); computed.",
                f"Take the records below with the controller at {quantity(controller.gain_A_per_V, 'A/V')}, each"
                " from rest,"
                f" sampled every {1e3 * scenario.sample_s:g} ms for {scenario.duration_s:g} s. Forces and volts are in"
                f" `{folder}/excitation`, peaks as in the table.",
                "Then raise the gain, all else as specified, until an oscillation keeps up by itself; stop there.",
            )
        ),
        Table(
            ("record", "payload", "excitation", "peak", "band"),
            tuple(_excitation(row) for row in scenario.record),
            "Excitations",
        ),
    ]
    if plan.second_mass:
        blocks.append(Paragraph(f"The range is one mass; for the records a second one was chosen: {plan.second_mass}."))
    frequencies = list(spec.acceptance[0].compliance_m_per_N)
    blocks.append(
        Table(
            ("frequency", *(f"with {quantity(row.outer_end_mass_kg, 'kg')}" for row in spec.acceptance)),
            tuple(
                (
                    quantity(f, "Hz"),
                    *(_limits(row.compliance_m_per_N[f], 1e9, "nm/N") for row in spec.acceptance),
                )
                for f in frequencies
            ),
            "Compliance |x/F_d| at the specified gain: nominal (computed), and pass if between (sampled)",
        )
    )
    rows = []
    for row in spec.acceptance:
        proved = row.critical_gain_proved_A_per_V
        gain = (
            "none: no gain sets in oscillation"
            if row.critical_gain_A_per_V is None
            else _limits(row.critical_gain_A_per_V, 1e3, "mA/V")
        )
        hertz = "–" if row.oscillation_Hz is None else _limits(row.oscillation_Hz, 1.0, "Hz")
        rows.append(
            (quantity(row.outer_end_mass_kg, "kg"), gain, hertz, "–" if proved is None else quantity(proved, "A/V"))
        )
    blocks += [
        Table(
            ("payload", "critical gain", "frequency of the oscillation", "no oscillation up to (proved)"),
            tuple(rows),
            "Critical gain: nominal (computed), and pass if between (sampled)",
        ),
        Items(
            (
                "Limits are the extremes over rigs drawn from the box of specified tolerances, and"
                f" {100 * MEASURED_WITHIN:g} % for the measurement itself. They are sampled: a rig within the"
                " tolerances could lie a"
                " little outside.",
                "The last column is proved: a rig that oscillates below that gain has a figure outside its specified"
                " tolerance, or something that the model does not have.",
                "Pass: every compliance and every critical gain within its limits. Fail otherwise; then diagnose.",
                "The linear model has no friction, dead band, saturation or air. The published rig of this kind"
                " began to"
                " oscillate at 62 to 75 % of the gains its linear model had predicted.",
            )
        ),
        Paragraph(
            f"The folder `{folder}` is a data set to fill in: one CSV file per record in `{folder}/records`, whose"
            " column"
            " names stand there already (`displacement_m` is the sensor's volts over its believed gain, measured"
            " from rest)."
            " Critical gains go into its `dataset.toml`, where lines for them are prepared. Its `prototype.toml` states"
            " as standard deviations what the prototype does, or else the specified tolerances over √3. Then"
        ),
        Code(f"beamdesign gap diagnose {folder}"),
        Paragraph(
            "says where the rig differs from this specification, and why. To rehearse it with a simulated rig first:"
        ),
        Code(
            f"beamdesign simulate {folder}/prototype.toml --scenario {folder}/scenario.toml --out rehearsal\n"
            "# then copy the CSV files of rehearsal into the records of a copy of the folder"
        ),
    ]
    return Part("Acceptance test", tuple(blocks))


def _limits(band: Band, factor: float, unit: str) -> str:
    low, high = (decimal(factor * value, 3) for value in band.limits)
    return f"{decimal(factor * band.nominal, 3)} {unit} ({low} to {high})"


def _excitation(row: ScenarioRecord) -> tuple[str, ...]:
    (signal,) = row.input
    peak = f"{signal.amplitude_N:g} N" if getattr(signal, "amplitude_N", None) else f"{signal.amplitude_V:g} V"  # type: ignore[union-attr]
    where = "force on the outer tip" if getattr(signal, "amplitude_N", None) else "command"
    match signal:
        case Multisine():
            words, band = "many sines at once", f"{signal.low_Hz:g} to {signal.high_Hz:g} Hz"
        case LoadSteps():
            words, band = f"steps both ways, {signal.dwell_s:g} s each", f"rise in {1e3 * signal.rise_s:g} ms"
        case _:
            words, band = signal.kind, ""
    return row.name, quantity(row.outer_end_mass_kg, "kg"), f"{where}: {words}", peak, band


def _bare(rig: Prototype) -> tuple[float, float]:
    from math import pi, sqrt

    outer, inner = lumped_beam(rig.outer_beam), lumped_beam(rig.inner_beam)
    added = rig.payload.inner_end_mass_kg
    return (
        sqrt(outer.stiffness / outer.mass) / (2 * pi),
        sqrt(inner.stiffness / (inner.mass + added)) / (2 * pi),
    )
