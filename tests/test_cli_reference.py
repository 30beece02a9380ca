"""Starting from templates and explaining keys: every template runs as it stands, every key is what the reader takes."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from beamdesign import InputError, read_prototype
from beamdesign.cli import app
from beamdesign.docs import (
    FILES,
    effects,
    find,
    keys,
    pages,
    reference_markdown,
    topics,
    value_lines,
    with_value,
    words,
)
from beamdesign.quantities import unit_of
from beamdesign.structure.materials import material_names
from beamdesign.templates import TEMPLATES


def invoke(*arguments: str) -> str:
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == 0, done.exception
    return done.output


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every template, and what was printed for each."""
    folder = tmp_path_factory.mktemp("new")
    paths = {}
    for name, template in TEMPLATES.items():
        paths[name] = folder / (name if template.is_folder else f"{name}.toml")
        said = invoke("new", name, "--out", str(paths[name]))
        assert f"next:    beamdesign {template.next[0].split()[1]}" in said
    return paths


def test_every_template_explains_itself_and_stands_under_the_name_of_its_file(started: dict[str, Path]) -> None:
    for name, path in started.items():
        for file in [path] if path.is_file() else path.iterdir():
            text = file.read_text(encoding="utf-8")
            assert text.startswith("# ")
            assert "beamdesign explain" in text
            own = tomllib.loads(text)["name"]
            assert own in (path.stem, "study", "sweep") if path.is_dir() else own == name


def test_nothing_is_overwritten(started: dict[str, Path]) -> None:
    for name, path in started.items():
        before = {f: f.read_bytes() for f in ([path] if path.is_file() else path.iterdir())}
        done = CliRunner().invoke(app, ["new", name, "--out", str(path)])
        assert isinstance(done.exception, InputError)
        assert "exists and is left alone; name another one with --out" in str(done.exception)
        assert {f: f.read_bytes() for f in before} == before


def test_no_result_is_proposed_to_be_written_over_a_data_set_among_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A diagnosis into the folder that it reads is refused."""
    monkeypatch.chdir(tmp_path)
    said = invoke("new", "dataset", "--out", "results/rig1")
    read, out = re.findall(r"next:    beamdesign gap diagnose (\S+) --out (\S+)", said)[0]
    assert (read, out) == ("results/rig1", "results/rig1_diagnosis")


@pytest.mark.parametrize("there", [".", "sub/.."])
def test_a_folder_here_gives_results_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: str) -> None:
    (tmp_path / "rig1" / "sub").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "rig1")
    assert "--out results/rig1\n" in invoke("new", "sweep", "--out", there)


def test_templates_are_listed_and_a_misspelt_one_is_guessed(tmp_path: Path) -> None:
    answer = tmp_path / "list.json"
    listed = invoke("new", "--list", "--json", str(answer))
    assert invoke("new") == listed
    assert [row["name"] for row in json.loads(answer.read_text())["templates"]] == list(TEMPLATES)
    assert "did you mean study?" in str(CliRunner().invoke(app, ["new", "stdy"]).exception)


def test_the_rig_is_certified_simulated_and_believed_as_it_stands(started: dict[str, Path], tmp_path: Path) -> None:
    answer = tmp_path / "answer.json"
    invoke("certify", str(started["rig"]), "--out", str(tmp_path / "proof.toml"), "--json", str(answer))
    assert json.loads(answer.read_text())["stable"] is True
    records = ["--scenario", str(started["scenario"]), "--out", str(tmp_path / "records"), "--no-plots"]
    invoke("simulate", str(started["rig"]), *records, "--json", str(answer))
    assert json.loads(answer.read_text())["stable"] is True
    believed = read_prototype(started["dataset"] / "prototype.toml")
    assert believed == read_prototype(started["rig"]).but(name="dataset")


def test_the_bench_moves_as_it_stands(started: dict[str, Path], tmp_path: Path) -> None:
    records = ["--scenario", str(started["bench-scenario"]), "--out", str(tmp_path), "--no-plots"]
    assert "records: 2 files" in invoke("simulate", str(started["bench"]), *records)


def test_the_data_set_is_read_as_it_stands(started: dict[str, Path]) -> None:
    """The four gains of the paper; their diagnosis takes ten seconds and is tested where it belongs."""
    from beamdesign.diagnosis.data.dataset import read_dataset

    data = read_dataset(started["dataset"])
    assert [gain.gain for gain in data.gains] == [0.015, 0.2, 0.007, 0.15]


def test_the_sweep_runs_as_it_stands(started: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    assert "6 done" in invoke("study", "run", str(started["sweep"] / "sweep.toml"), "--out", str(out))
    assert (out / "table.csv").is_file()


def test_every_key_says_what_it_means() -> None:
    assert {key.file for key in keys()} == set(FILES)
    assert [key.path for key in keys() if not key.meaning or not key.kind] == []
    assert len({key.path for key in keys()}) > 150


def schema_bounds(schema: dict[str, Any]) -> set[tuple[str, float]]:
    found = set()
    inside = [schema.get("items"), schema.get("additionalProperties"), *schema.get("prefixItems", [])]
    for part in (schema, *schema.get("anyOf", []), *inside):
        for word in ("exclusiveMinimum", "minimum", "exclusiveMaximum", "maximum"):
            if isinstance(part, dict) and word in part:
                found.add((word, float(part[word])))
        if isinstance(part, dict) and part is not schema:
            found |= {pair for inner in part.get("prefixItems", []) for pair in schema_bounds(inner)}
    return found


def test_bounds_and_defaults_are_those_of_the_schema_that_pydantic_makes_of_the_records() -> None:
    from importlib import import_module

    words = {"above": "exclusiveMinimum", "at least": "minimum", "below": "exclusiveMaximum", "at most": "maximum"}
    compared = 0
    for file, place in FILES.items():
        module, name = place.split(":")
        schema = getattr(import_module(module), name).model_json_schema()
        named = {name: schema} | schema.get("$defs", {})
        for key in keys():
            table, _, own = key.path.rpartition(".")
            if key.file != file or key.is_table or key.only_for or table.startswith("effects"):
                continue
            if own == "kind" and (key.default == "needed" or key.path == "actuator.kind"):
                continue  # of several laws: each has its own as a default, and yet one has to be named
            given = [d.get("properties", {}).get(own, {}) for d in named.values()]
            fields = [field for field in given if field.get("description") == key.meaning]
            told = set()
            for part in filter(None, key.bounds.split(", ")):
                if part.startswith("from "):
                    low, _, high = part.removeprefix("from ").removesuffix(" or 0").replace(" up", "").partition(" to ")
                    told |= {("minimum", 0.0 if part.endswith(" or 0") else float(low))}
                    told |= {("maximum", float(high))} if high else set()
                    continue
                word, value = part.rsplit(" ", 1)
                told.add((words[word], float(value)))
            assert any(told <= schema_bounds(field) for field in fields), (key.path, told)
            if key.kind != "a table" and key.default != "from the others":  # made anew each time: not in the schema
                assert all("default" in field for field in fields) == (key.default != "needed"), key.path
            compared += 1
    assert compared > 150


def test_explained_bounds_are_what_the_reader_enforces(remedy: Any) -> None:
    (wall,) = {key.bounds for key in find("outer_beam.wall_m") if key.file == "prototype"}
    assert wall == "from 1e-05 to 1"
    for bad in (0.0, 0.9e-5, 1.1):
        with pytest.raises(ValueError, match="wall_m"):
            remedy.outer_beam.but(width_m=1.9, wall_m=bad)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("flow_gain_m3_per_s_per_A", "m³/s/A"),
        ("line_loss_Pa_s2_per_m6", "Pa s²/m⁶"),
        ("stiffness_N_per_m", "N/m"),
        ("damping_N_s_per_m", "N s/m"),
        ("width_m", "m"),
        ("seed", ""),
        ("material", ""),
    ],
)
def test_units_are_read_from_the_suffix(name: str, unit: str) -> None:
    assert unit_of(name) == unit


def test_a_key_is_explained_with_every_place_it_may_stand(tmp_path: Path) -> None:
    answer = tmp_path / "key.json"
    said = invoke("explain", "tip_force_N", "--json", str(answer))
    for part in (
        "transverse force at the tip",
        "a number in N, from 1e-06 to 1e+07",
        "needed",
        "load.tip_force_N (study)",
    ):
        assert part in said
    (key,) = json.loads(answer.read_text())["keys"]
    assert (key["path"], key["unit"], key["default"]) == ("load.tip_force_N", "N", "needed")
    assert "outer_beam.width_m, inner_beam.width_m (prototype)" in invoke("explain", "width_m")
    assert "equations (13) and (14)" in invoke("explain", "leakage_m3_per_s_per_Pa")


@pytest.mark.parametrize(
    ("asked", "meant"),
    [
        ("material.my alloy.density_kg_per_m3", "density_kg_per_m3"),
        ("controller.section[0].zero_Hz", "controller.section.zero_Hz"),
        ("payload.outer_end_mass_kg[1]", "payload.outer_end_mass_kg"),
        ("material.NAME", "material"),
        ("[[controller.section]]", "controller.section"),
    ],
)
def test_a_key_is_explained_as_it_stands_in_a_file(asked: str, meant: str) -> None:
    assert invoke("explain", asked).splitlines()[0] == invoke("explain", meant).splitlines()[0]


def test_a_value_is_explained_with_the_figures_that_it_brings() -> None:
    said = invoke("explain", "lag")
    for part in ('kind = "lag"', "(1 + s / zero) / (1 + s / pole)", "gain_A_per_V, pole_Hz, zero_Hz", "(study)"):
        assert part in said
    assert "section" not in said  # of a structured law
    assert "rotor_inertia_kg_m2" in invoke("explain", "ball_screw")
    assert invoke("explain", "compliance").startswith("[compliance]")  # a key before a value


def test_every_value_that_a_key_names_can_be_asked_for() -> None:
    named = {value for key in keys() for value in re.findall(r'"(\w+)"', key.kind)}
    assert {"hinf", "servo_cylinder", "stock", "sobol", "bars"} <= named <= set(words())
    for value in named:
        places = [key.path.rpartition(".")[2] for key in with_value(value)]
        said = [line for line in value_lines(value, with_value(value)) if line.endswith(f' = "{value}"')]
        assert {line.partition(" ")[0] for line in said} == set(places)


def test_every_material_is_explained_by_its_name() -> None:
    every = invoke("explain", "material").splitlines()
    for name in material_names():
        said = invoke("explain", name).splitlines()
        assert said[0] == "material"
        assert [line for line in every if line.split()[:1] == [name]] == said[-1:]
    assert "6061-T6" in words()


def test_every_effect_is_explained_with_its_figures() -> None:
    for effect in effects():
        said = invoke("explain", effect.name)
        assert effect.source in said
        for q in effect.parameters:
            assert f"{q.name} = {q.default}" in said
    assert invoke("explain", "effects.sensor_lag") == invoke("explain", "sensor_lag")
    assert all(effect.name in invoke("explain", "effects") for effect in effects())


def test_all_keys_are_listed_by_table_and_an_unknown_one_is_guessed() -> None:
    listed = invoke("explain")
    for part in ("prototype:", "[load] tip_force_N", "[effects.sensor_lag] break_Hz"):
        assert part in listed
    assert "did you mean width_m" in str(CliRunner().invoke(app, ["explain", "widht_m"]).exception)
    with pytest.raises(InputError, match=r"did you mean load\.tip_force_N"):
        CliRunner().invoke(app, ["explain", "laod.tip_force_N"], catch_exceptions=False)


def test_every_topic_has_its_page(tmp_path: Path) -> None:
    answer = tmp_path / "page.json"
    listed = invoke("explain", "--json", str(answer))
    assert json.loads(answer.read_text())["topics"] == topics()
    assert {"proofs", "controllers", "effects", "datasets", "studies", "specification", "adding"} <= set(topics())
    for topic, title in topics().items():
        assert f"  {topic}: " in listed
        said = invoke("explain", topic, "--json", str(answer))
        assert said.rstrip().endswith(pages()[topic].rstrip())
        assert f"# {title}" in said
        assert json.loads(answer.read_text())["page"] == pages()[topic]


def test_a_topic_with_the_name_of_a_key_tells_the_key_first(tmp_path: Path) -> None:
    answer = tmp_path / "effects.json"
    said = invoke("explain", "effects", "--json", str(answer))
    assert said.startswith("effects\n  effects beyond the linear rig")
    assert said.index("sensor_lag (sensor)") < said.index("# Effects")
    told = json.loads(answer.read_text())
    assert [each["name"] for each in told["effects"]] == [each.name for each in effects()]
    assert told["page"] == pages()["effects"]
    assert "#" not in invoke("explain", "width_m", "--json", str(answer))
    assert json.loads(answer.read_text())["page"] is None


def test_an_unknown_word_is_guessed_among_topics_too() -> None:
    for typed, meant in (("proof", "proofs"), ("dataset", "datasets"), ("controllrs", "controllers")):
        with pytest.raises(InputError, match=f"did you mean.* {meant}"):
            CliRunner().invoke(app, ["explain", typed], catch_exceptions=False)


def test_the_page_of_all_keys_is_the_generated_one() -> None:
    _, rest = pages()["reference"].split("<!-- reference: start -->\n")
    block, _ = rest.split("<!-- reference: end -->")
    assert block == reference_markdown(), "regenerate it: beamdesign explain --reference"
    assert invoke("explain", "--reference").rstrip() == block.rstrip()
    for row in (line for line in block.splitlines() if line.startswith("|")):
        assert row.replace("\\|", "").count("|") == 5, row
