"""Everything the paper states, recomputed: one result that the folder (paper.html, paper.json, figures) is made from.

Where the paper contradicts itself, each slip stands with the figures that decide it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from math import sqrt
from pathlib import Path

from beamdesign.files import write_whole
from beamdesign.json_text import picked
from beamdesign.progress import Progress
from beamdesign.prototype import COMPLIANCE_LIMIT_M_PER_N
from beamdesign.quantity_text import decibels, from_decibels
from beamdesign.report.canvas import save
from beamdesign.report.page import Block, Document, Items, Paragraph, Part, Picture, Table, to_html
from beamdesign.structure import beam
from beamdesign.validation.paper.claims import CM_PER_100_N, Bandwidth, Claim, FigureClaim, bandwidths, claims
from beamdesign.validation.paper.figures import DRAWINGS, Drawing
from beamdesign.validation.paper.rig import (
    FLOW_GAIN_PRESSURE_PA,
    INNER,
    INNER_END_MASS_KG,
    OUTER,
    OUTER_END_MASS_KG,
    SUPPLY_PRESSURE_PA,
    VALVE_DAMPING_RATIO,
    VARIATIONS,
    GainRow,
    at,
    critical_gain_mA_per_V,
    gain_rows,
    lag,
    proportional,
    stable_masses,
)

CHOICES = (
    f"Servovalve damping {VALVE_DAMPING_RATIO}: the paper does not give it. It is the one free constant, and this value"
    " has the predicted critical gains come out.",
    "Beam damping as a fixed dashpot, b = 2 zeta sqrt(K M) of the bare beam: added end mass lowers the damping ratio."
    " The paper does not say; it matters only with mass on the outer beam alone.",
)
"""What the paper leaves open, and how it is settled here."""

_REMEDY_GAIN_MA_PER_V = 150.0
_STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class Slip:
    """A place where the paper contradicts itself, its own data or its drawings.

    Attributes:
        where: section, equation or figure.
        printed: what stands there, in our words.
        read_as: what it is taken for here.
        check: the figures that decide it, recomputed.
    """

    where: str
    printed: str
    read_as: str
    check: str


@dataclass(frozen=True)
class Comparison:
    """The paper beside the model.

    Attributes:
        gains: the four critical gains, with their sensitivity to every open choice.
        bandwidths: the three bandwidths.
        claims: every published number, those of the two tables included.
        slips: where the paper contradicts itself.
        remedy_crossings: outer end mass (kg) and frequency (Hz) at which the paper's remedy for payload, the lag with
            4.5 kg inside at the measured 150 mA/V, gains or loses stability.
    """

    gains: list[GainRow]
    bandwidths: list[Bandwidth]
    claims: list[Claim]
    slips: list[Slip]
    remedy_crossings: list[tuple[float, float]]

    def fields(self) -> dict[str, object]:
        """The JSON result."""
        bandwidth = "case gain_mA_per_V outer_end_mass_kg inner_end_mass_kg paper model"
        claim = "group quantity unit paper model agrees verdict source note"
        return {
            "critical_gains": [row.fields() for row in self.gains],
            "bandwidths_Hz": [picked(row, bandwidth) for row in self.bandwidths],
            "claims": [picked(row, claim) for row in self.claims],
            "slips": self.slips,
            "choices": CHOICES,
            "variations": {key: words for key, (words, _) in VARIATIONS.items()},
            "remedy_crossings": [
                {"outer_end_mass_kg": mass, "frequency_Hz": frequency} for mass, frequency in self.remedy_crossings
            ],
        }


def compare() -> Comparison:
    """Recompute everything."""
    gains, widths = gain_rows(), bandwidths()
    crossings = stable_masses(_REMEDY_GAIN_MA_PER_V, INNER_END_MASS_KG)
    return Comparison(gains, widths, claims(gains, widths), [*_slips(gains)], crossings)


def _slips(rows: list[GainRow]) -> Iterator[Slip]:
    """All of them, recomputed where they can be; `rows` are the critical gains."""
    frequency = beam.first_frequency(OUTER.rigidity, OUTER.mass_per_length, OUTER.free_length_m, OUTER.end_mass_kg)
    sag = OUTER.effective_mass_kg * _STANDARD_GRAVITY / OUTER.stiffness_N_per_m
    wrong = OUTER.effective_mass_kg / (_STANDARD_GRAVITY * sag)
    right = OUTER.effective_mass_kg * _STANDARD_GRAVITY / sag
    gloss, goal = 0.001 / CM_PER_100_N, float(from_decibels(-100.0))
    slow, fast = (CM_PER_100_N * at(rig).static_compliance() for rig in (proportional(24.0), lag(300.0)))
    light, heavy = (critical_gain_mA_per_V(lag(200.0, kg), OUTER_END_MASS_KG) for kg in (4.4, INNER_END_MASS_KG))
    bare, payload = at(proportional(24.0)), rows[2]
    (onset_kg, onset_Hz), *_ = stable_masses(300.0, 0.0)
    # Both masses on both springs have the inner beam's own frequency there, the oil rigid.
    swap = OUTER.stiffness_N_per_m * INNER.effective_mass_kg / INNER.stiffness_N_per_m - OUTER.effective_mass_kg
    filter_costs = 1 - rows[0].varied_mA_per_V["with_filter"] / rows[0].model_mA_per_V
    yield from (
        Slip(
            "equation (2)", "a minus sign before the first natural frequency", "no sign",
            f"The outer tube has {frequency:.1f} Hz by (2) without it and {OUTER.natural_frequency_Hz:.1f} Hz by (4).",
        ),
        Slip(
            "equation (3)", "stiffness as mass over (gravity times sag)", "mass times gravity over sag",
            f"A sag of {1e6 * sag:.1f} um under the outer beam's mass gives {wrong:.0f} as printed and"
            f" {right:.0f} N/m as read.",
        ),
        Slip(
            "equation (11)", "the oil stiffness K_c on the left", "the cylinder force F_c",
            "(7), (8) and (14) use F_c and nothing else defines it; a stiffness cannot equal a stiffness times a"
            " displacement.",
        ),
        Slip(
            "equation (12)", "a feedback gain K_fx that the appendix does not list", "the sensor's gain F, 11.8 V/cm",
            f"With F the proportional loop oscillates at {rows[0].model_mA_per_V:.1f} mA/V, printed 24.",
        ),
        Slip(
            "System Model, the -100 dB goal", "-100 dB explained as 0.001 cm under 100 N",
            f"{COMPLIANCE_LIMIT_M_PER_N:.3g} m/N = 0.0057 cm/kN, as in the abstract",
            f"-100 dB of inch per pound-force is {goal:.4g} m/N; the explanation is {gloss:.3g} m/N or"
            f" {decibels(gloss):.1f} dB, {gloss / goal:.2f} times looser.",
        ),
        Slip(
            "Compensator Design and Experiments", "static errors of 0.00085 cm and of 0.0005 mm under 100 N",
            "neither",
            f"They differ {0.00085 / 0.00005:.0f}-fold. The appendix's figures give {fast:.2g} cm at 300 mA/V and"
            f" {slow:.3g} cm at 24 mA/V; 0.00085 cm would be {decibels(0.00085 / CM_PER_100_N):.1f} dB, which does not"
            " meet the goal.",
        ),
        Slip(
            "Effect of a Load Mass, Experiments", "4.5 kg inside in two places, 4.4 kg in one",
            "4.4 kg for the measured gain, 4.5 kg for Figures 14 and 16",
            f"The critical gain is {light:.1f} mA/V with 4.4 kg and {heavy:.1f} mA/V with 4.5 kg: the printed 200 lies"
            " between them.",
        ),
        Slip(
            "System Model, structural damping", "one damping ratio, not what it means once end mass is added",
            "a fixed dashpot, b = 2 zeta sqrt(K M) of the bare beam",
            f"With 6.8 kg outside the critical gain is {payload.model_mA_per_V:.1f} mA/V with the fixed dashpot and"
            f" {payload.varied_mA_per_V['held_damping_ratio']:.1f} mA/V with the ratio held; the paper has 10.",
        ),
        Slip(
            "System Model, poles and zeros", "seven poles and five zeros, zeros found by raising the feedback gain",
            "five zeros of x / F_d, two of the loop",
            f"x / F_d has {len(bare.compliance_zeros())} zeros whatever the gain; from current to displacement there"
            f" are {len(bare.open_loop_zeros())}, and only these are where closed-loop roots end at high gain.",
        ),
        Slip(
            "Effect of a Load Mass", "the open-loop resonance called the outer beam's own frequency",
            "that of both masses on both springs",
            f"They change places with the inner beam's zero at {swap:.2f} kg; at 300 mA/V the loop is lost from"
            f" {onset_kg:.2f} kg, at {onset_Hz:.1f} Hz.",
        ),
        Slip(
            "Appendix, flow gain", "K_q at 6.9 MPa while the supply is 20 MPa", "as printed",
            "Flow through an orifice rises as sqrt(pressure), here"
            f" {sqrt(SUPPLY_PRESSURE_PA / FLOW_GAIN_PRESSURE_PA):.2f} times; with that the critical gains are "
            + ", ".join(f"{row.varied_mA_per_V['supply_flow_gain']:.3g}" for row in rows)
            + " mA/V, measured "
            + ", ".join(f"{row.case.measured_mA_per_V:g}" for row in rows)
            + ".",
        ),
        Slip(
            "System Model, 400 Hz filter", "said not to affect the dynamics significantly", "left out, as in the paper",
            f"It costs {100 * filter_costs:.0f} % of the critical gain of the proportional loop.",
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class Written:
    """What was written.

    Attributes:
        page: the HTML page.
        figures: the PNG and SVG files.
        checks: what the paper says about its figures.
    """

    page: Path
    figures: list[Path]
    checks: list[FigureClaim]


def write_page(comparison: Comparison, folder: Path, progress: Progress) -> Written:
    """Draw the figures and write the page.

    Args:
        comparison: what to show.
        folder: an existing folder; files of the same names are replaced.
        progress: told the share done and what is being drawn.
    """
    drawings: list[Drawing] = []
    files: list[Path] = []
    for number, draw in enumerate(DRAWINGS):
        progress(number / len(DRAWINGS), draw.__name__.replace("_", " "))
        drawings.append(draw())
        files += save(drawings[-1].figure, folder / drawings[-1].name)
    page = folder / "paper.html"
    write_whole(page, to_html(document_of(comparison, drawings)))
    return Written(page, files, [check for drawing in drawings for check in drawing.checks])


def document_of(comparison: Comparison, drawings: list[Drawing]) -> Document:
    """Every number of the paper beside the model's, its slips, and its figures drawn again."""
    differing = sum(not claim.agrees for claim in comparison.claims)
    verdict = (
        "A. Zalucky and D. E. Hardt, Active Control of Robot Structure Deflections, ASME Journal of Dynamic Systems,"
        " Measurement, and Control 106 (1984) 63–69. Every number of the paper that its appendix allows to be"
        f" recomputed stands here beside the model's: {len(comparison.claims)} numbers, of which {differing} differ by"
        " more than 5 % and more than the rounding of the print. Critical gains, bandwidths and crossings come from"
        " exact polynomials, not from sweeps."
    )
    crossings = " and ".join(
        f"{mass:.3f} kg (crossing at {hertz:.1f} Hz)" for mass, hertz in comparison.remedy_crossings
    )
    remedy = (
        f"The paper adds 4.5 kg inside so that 6.8 kg can be carried. At {_REMEDY_GAIN_MA_PER_V:g} mA/V its own model"
        f" is stable only between {crossings} of mass on the outer beam: with no payload it oscillates."
    )
    slips = tuple((slip.where, slip.printed, slip.read_as, slip.check) for slip in comparison.slips)
    drawn_from = (
        "Drawn from the model; where the paper says in words what its figure shows, that is marked. Its root locus,"
        " Bode diagrams and measured points are not published as numbers."
    )
    parts = (
        Part("Two choices the paper leaves open", (Items(CHOICES),)),
        Part("Critical gains", _gains(comparison)),
        Part("The remedy needs its payload", (Paragraph(remedy),)),
        Part("Number by number", _claims(comparison)),
        Part("Slips of the paper", (Table(("where", "printed", "read here as", "recomputed"), slips),)),
        Part("Figures", (Paragraph(drawn_from), *(block for one in drawings for block in _figure(one)))),
    )
    return Document("Zalucky and Hardt (1984)", "Paper recomputed", verdict, (), parts, subject="")


def _number(value: float) -> str:
    """Four significant digits, without an exponent where that reads better."""
    return f"{value:.4g}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"


def _gains(comparison: Comparison) -> tuple[Block, ...]:
    rows = comparison.gains
    whole = tuple(
        (
            row.case.name,
            *map(_number, (row.case.predicted_mA_per_V, row.case.measured_mA_per_V, row.model_mA_per_V)),
            _number(row.model.frequency_Hz),
        )
        for row in rows
    )
    varied = (
        ("as above", *(_number(row.model_mA_per_V) for row in rows)),
        *((words, *(_number(row.varied_mA_per_V[key]) for row in rows)) for key, (words, _) in VARIATIONS.items()),
        ("paper, measured", *(_number(row.case.measured_mA_per_V) for row in rows)),
        (
            "share of the distance to the measurement that filter and smaller side close",
            *(f"{100 * row.explained:.0f} %" for row in rows),
        ),
    )
    heads = ("case", "paper, predicted", "paper, measured", "model", "oscillation, Hz")
    return (
        Table(heads, whole, "Critical gains, mA/V", numbers=(1, 2, 3, 4)),
        Table(
            ("model", *(row.case.name for row in rows)),
            varied,
            "The model's critical gain under other choices, one at a time, mA/V",
            numbers=(1, 2, 3, 4),
        ),
    )


def _claims(comparison: Comparison) -> tuple[Block, ...]:
    tables = []
    for group, found in groupby(comparison.claims, key=lambda claim: claim.group):
        claims = list(found)
        rows = tuple(
            (c.quantity, _number(c.paper), _number(c.model), c.unit, c.verdict, c.source, c.note) for c in claims
        )
        heads = ("quantity", "paper", "model", "unit", "verdict", "where", "note")
        marks = tuple("" if claim.agrees else "differs" for claim in claims)
        tables.append(Table(heads, rows, group[:1].upper() + group[1:], (1, 2), marks=marks))
    return tuple(tables)


def _figure(drawing: Drawing) -> tuple[Block, ...]:
    caption = f"{drawing.title}. Paper: {drawing.claim} Model: {drawing.caption}"
    picture = Picture("", drawing.name, caption)
    if not drawing.checks:
        return (picture,)
    rows = tuple((check.claim, check.paper, check.model, "yes" if check.holds else "no") for check in drawing.checks)
    marks = tuple("" if check.holds else "fails" for check in drawing.checks)
    return picture, Table(("claim", "paper", "model", "holds"), rows, marks=marks)
