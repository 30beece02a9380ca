"""`beamdesign size` as a user runs it: fields, exit statuses, and what is said on bad input."""

import json
import tomllib
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

import beamdesign
from beamdesign import InputError, read_problem, write_prototype
from beamdesign.cli.design import size
from beamdesign.prototype import Beam
from beamdesign.structure.section import Tube
from beamdesign.synthesis.checks import check_sections

STUDY = Path(__file__).parents[1] / "studies" / "prototype.toml"
DATA = Path(beamdesign.__file__).parent / "structure"
PUBLISHED = Tube(0.140, 0.0023), Tube(0.100, 0.0032)


@pytest.fixture
def run(tmp_path):
    """Runs the command and gives its exit status, its output, and the fields it wrote (None if it wrote none)."""
    app = typer.Typer()
    app.command()(size)

    def invoke(*arguments):
        target = tmp_path / "result.json"
        done = CliRunner().invoke(app, [*map(str, arguments), "--json", str(target)])
        if isinstance(done.exception, InputError):
            raise done.exception
        assert isinstance(done.exception, SystemExit | None)
        return done.exit_code, done.output, json.loads(target.read_text()) if target.exists() else None

    return invoke


@pytest.fixture
def edited(tmp_path):
    """Writes the published study with one piece of text replaced."""

    def write(old, new):
        text = STUDY.read_text(encoding="utf-8")
        assert old in text
        path = tmp_path / "study.toml"
        path.write_text(text.replace(old, new), encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize(("payload_kg", "more"), [(6.8, False), (500.0, True)])
def test_the_weight_that_no_check_counts_is_told(run, edited, tmp_path, payload_kg, more):
    """Statics: a cantilever of weight w L with a mass m at its tip, held there, asks 3/8 w L + m g of the prop."""
    path = edited("outer_end_mass_kg = [0.0, 6.8]", f"outer_end_mass_kg = [0.0, {payload_kg}]")
    status, output, fields = run(path)
    tube, beam = Tube(**fields["outer"]), read_problem(path).outer_beam
    per_m = beam.material.density_kg_per_m3 * (tube.width_m**2 - (tube.width_m - 2 * tube.wall_m) ** 2)
    weight = 9.80665 * (payload_kg + beam.end_mass_kg + 3 / 8 * per_m * beam.free_length_m)
    assert status == 0
    told = float(output.partition("not counted in these checks: ")[2].split()[0])
    assert weight <= told < 1.005 * weight
    assert ("more than the load of 2000 N" in output) is more
    write_prototype(
        read_problem(path).prototype(*(Tube(**fields[name]) for name in ("outer", "inner"))), tmp_path / "p.toml"
    )
    assert ("more than the load of 2000 N" in run(tmp_path / "p.toml")[1]) is more


def test_study_gives_the_fields_of_the_contract(run):
    status, output, fields = run(STUDY)
    assert status == 0
    tubes = Tube(**fields["outer"]), Tube(**fields["inner"])
    pair = check_sections(read_problem(STUDY), *tubes)
    assert fields["feasible"]
    assert fields["beam_mass_kg"] == pytest.approx(pair.beam_mass_kg)
    assert fields["governing"] == pair.governing
    for written, check in zip(fields["checks"], pair.checks, strict=True):
        assert (written["name"], written["unit"]) == (check.name, check.unit)
        assert written["value"] == pytest.approx(check.value)
        assert written["limit"] == pytest.approx(check.limit)
        assert written["utilisation"] == pytest.approx(check.utilisation)
        assert check.name.split(",")[0] in output
    assert fields["given"]["feasible"]
    assert Tube(**fields["given"]["outer"]) == PUBLISHED[0]
    assert fields["price_of_rounding_kg"] == pytest.approx(fields["beam_mass_kg"] - fields["free"]["beam_mass_kg"])
    assert fields["kkt_residual"] < 1e-8
    assert fields["shadow_prices"]["clearance_under_load_kg_per_mm"] > 0
    stock = tomllib.loads((DATA / "stock_sizes.toml").read_text(encoding="utf-8"))["square_tube"]
    ends = [1e3 * row["width_m"] for row in stock]
    assert f"outer tubes of {min(ends):g} x 2 to {max(ends):g} x 10 mm" in output
    assert "says nothing" not in output


def test_limits_that_a_study_does_not_state_are_told(run, edited):
    _, output, _ = run(edited("least_wall_m = 0.002\nlargest_width_m = 0.2\n", ""))
    assert "says nothing: sections.least_wall_m = 0.002, sections.largest_width_m = 0.2\n" in output
    _, output, _ = run(edited("[clearance]\nassembly_m = 0.005\nunder_load_m = 0.003\n", ""))
    assert "says nothing: clearance.assembly_m = 0.005, clearance.under_load_m = 0.003\n" in output


def test_where_nothing_fits_the_answer_is_no_and_says_what_to_relax(run, edited):
    status, output, fields = run(edited("largest_width_m = 0.2", "largest_width_m = 0.1"))
    assert status == 1
    assert fields["feasible"] is False
    assert fields["relaxations"][0]["key"] == "sections.largest_width_m"
    assert "sections.largest_width_m from 0.1 to 0.14" in output
    assert "NOT FEASIBLE" in output


def test_bad_study_is_refused_and_nothing_is_written(run, edited, tmp_path):
    with pytest.raises(InputError) as refused:
        run(edited('material = "6061-T6"', 'material = "6061"'))
    assert "outer_beam.material" in str(refused.value)
    assert "inner_beam.material" in str(refused.value)
    assert not (tmp_path / "result.json").exists()


def test_a_study_states_its_own_load(run):
    with pytest.raises(InputError, match="states its own load"):
        run(STUDY, "--tip-force-N", 1000)


def test_prototype_is_checked_for_the_load_that_it_was_designed_for(run, tmp_path):
    rig = read_problem(STUDY).prototype(*PUBLISHED)
    write_prototype(rig.but(payload=rig.payload.but(largest_force_N=300.0)), tmp_path / "prototype.toml")
    _, output, fields = run(tmp_path / "prototype.toml")
    assert "300 N (payload.largest_force_N)" in output
    assert fields["assumed"]["load"] == {"tip_force_N": 300.0}
    assert run(tmp_path / "prototype.toml", "--tip-force-N", 500)[2]["assumed"]["load"] == {"tip_force_N": 500.0}


def test_prototype_is_checked_for_what_its_study_asked_for(run, tmp_path):
    """Sizes, gaps and factors go with the prototype; of one that states none the usual ones are told."""
    study = read_problem(STUDY)
    asked = {
        "sections": {"least_wall_m": 0.001, "largest_width_m": 0.15, "width_to_wall_at_most": 80.0},
        "clearance": {"assembly_m": 0.004, "under_load_m": 0.0025},
        "safety": {"strength": 3.0, "local_buckling": 1.7},
    }
    own = study.but(**asked | {"sections": study.sections.but(**asked["sections"])})
    write_prototype(own.prototype(*PUBLISHED), tmp_path / "prototype.toml")
    _, output, fields = run(tmp_path / "prototype.toml")
    assert "walls of 1 mm or more, at most 150 mm wide) that are those of its study" in output
    assert {name: fields["assumed"][name] for name in asked} == asked
    write_prototype(own.prototype(*PUBLISHED).but(sized_for=None), tmp_path / "prototype.toml")
    _, output, fields = run(tmp_path / "prototype.toml")
    assert "that are the usual ones, as it states none" in output
    assert fields["assumed"]["safety"] == {"strength": 2.0, "local_buckling": 1.5}


def test_prototype_is_checked_for_the_default_load_and_says_so(run, tmp_path):
    rig = read_problem(STUDY).prototype(*PUBLISHED)
    write_prototype(rig.but(payload=rig.payload.but(largest_force_N=None)), tmp_path / "prototype.toml")
    status, output, fields = run(tmp_path / "prototype.toml")
    assert status == 0
    assert "2000 N (default)" in output
    assert fields["assumed"]["load"] == {"tip_force_N": 2000.0}
    assert fields["outer"] == {"width_m": 0.14, "wall_m": 0.0023}
    assert fields["governing"] == "outer least wall"


def test_prototype_that_fails_a_check_is_a_no(run, tmp_path):
    write_prototype(read_problem(STUDY).prototype(*PUBLISHED), tmp_path / "prototype.toml")
    status, output, fields = run(tmp_path / "prototype.toml", "--tip-force-N", 2500)
    assert status == 1
    assert not fields["feasible"]
    assert [check["name"] for check in fields["checks"] if not check["satisfied"]] == ["clearance under load, servo on"]
    assert "FAILS" in output


@pytest.mark.parametrize("force", ["0", "-5", "nan", "inf"])
def test_load_must_be_a_force(run, tmp_path, force):
    write_prototype(read_problem(STUDY).prototype(*PUBLISHED), tmp_path / "prototype.toml")
    with pytest.raises(InputError, match="plausible range"):
        run(tmp_path / "prototype.toml", f"--tip-force-N={force}")


def test_prototype_of_lumped_figures_names_the_missing_geometry(run, tmp_path):
    lumped = Beam(stiffness_N_per_m=486_800.0, effective_mass_kg=3.9)
    prototype = read_problem(STUDY).prototype(*PUBLISHED).but(outer_beam=lumped)
    write_prototype(prototype, tmp_path / "rig.toml")
    with pytest.raises(InputError) as refused:
        run(tmp_path / "rig.toml")
    assert {key for key, _ in refused.value.problems} == {
        f"outer_beam.{key}" for key in ("width_m", "wall_m", "length_m", "free_length_m", "material")
    }
