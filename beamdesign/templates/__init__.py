"""Commented files to start from, each of which runs as it stands."""

import re
from dataclasses import dataclass
from pathlib import Path

import tomli_w

from beamdesign.files import write_set, write_whole
from beamdesign.records import InputError


@dataclass(frozen=True)
class Template:
    """One thing to start.

    Attributes:
        purpose: in a few words.
        files: what it consists of: names in the new folder, each with the file of this package it comes from; one
            without a name is the new file itself.
        next: the commands that take it, best first; `{it}` stands for its path, `{name}` for its name.
    """

    purpose: str
    files: tuple[tuple[str, str], ...]
    next: tuple[str, ...]

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder of files."""
        return any(name for name, _ in self.files)


TEMPLATES = {
    "study": Template(
        "a link to design from scratch: load, lengths, hydraulics, goals",
        (("", "study.toml"),),
        ("beamdesign run {it} --out results/{name}", "beamdesign size {it}"),
    ),
    "codesign": Template(
        "a link whose sections, end mass and controller are chosen together",
        (("", "codesign.toml"),),
        (
            "beamdesign codesign {it} --bandwidth-Hz 2 --out results/{name}",
            "beamdesign front {it} --out results/front",
            "beamdesign remedies {it} --out results/remedies",
        ),
    ),
    "rig": Template(
        "a rig that has been measured, by its lumped figures",
        (("", "rig.toml"),),
        ("beamdesign certify {it}", "beamdesign tune {it} --out results/{name}"),
    ),
    "sweep": Template(
        "a folder with a study and a sweep over figures of it",
        (("sweep.toml", "sweep.toml"), ("study.toml", "study.toml")),
        ("beamdesign study run {it}/sweep.toml --out results/{name}",),
    ),
    "bench": Template(
        "a servovalve and its cylinder on a bench",
        (("", "bench.toml"),),
        (
            "beamdesign new bench-scenario --out moves.toml",
            "beamdesign simulate {it} --scenario moves.toml --out results/{name}",
        ),
    ),
    "scenario": Template(
        "what is done to a rig in a simulation",
        (("", "scenario.toml"),),
        ("beamdesign simulate PROTOTYPE --scenario {it} --out results/{name}",),
    ),
    "bench-scenario": Template(
        "what an actuator bench is told to do",
        (("", "bench-scenario.toml"),),
        ("beamdesign simulate BENCH --scenario {it} --out results/{name}",),
    ),
    "dataset": Template(
        "a folder for what came back from a rig, with the model that was believed",
        (("dataset.toml", "dataset.toml"), ("prototype.toml", "rig.toml")),
        ("beamdesign gap diagnose {it} --out results/{name}_diagnosis",),
    ),
}
"""By name, in the order in which a newcomer meets them."""


def start(name: str, out: Path | None = None) -> list[Path]:
    """Write a template's files; nothing that is there is touched.

    Args:
        name: a key of `TEMPLATES`.
        out: the new file, or the new folder of a template that is one; else one of the template's name.

    Returns:
        The files written.

    Raises:
        InputError: where one of them exists already.
    """
    template = TEMPLATES[name]
    place = target(name, out)
    paths = [place / inside if inside else place for inside, _ in template.files]
    if template.is_folder and place.is_file():
        raise InputError("new", [(str(place), "is a file; name a folder")])
    if template.is_folder and place.suffix in (".toml", ".csv"):
        raise InputError("new", [(str(place), f"names a file, and this is {template.purpose}; name a folder")])
    there = [path for path in paths if path.exists()]
    if there:
        reason = "exists and is left alone; name another one with --out"
        raise InputError(
            "new", [(str(path), "is a folder; name a file" if path.is_dir() else reason) for path in there]
        )
    own = tomli_w.dumps({"name": place.name if template.is_folder else place.stem}).strip()
    sources = (Path(__file__).with_name(source).read_text(encoding="utf-8") for _, source in template.files)
    texts = [re.sub(r'^name = ".*"$', lambda _: own, text, count=1, flags=re.MULTILINE) for text in sources]
    if template.is_folder:
        write_set(place, {name: (name, text) for (name, _), text in zip(template.files, texts, strict=True)})
    else:
        write_whole(place, *texts)
    return paths


def target(name: str, out: Path | None) -> Path:
    """Where a template goes."""
    return out if out is not None else Path(name if TEMPLATES[name].is_folder else f"{name}.toml")
