"""Commented files to start from, each of which runs as it stands."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import tomli_w

from beamdesign.files import write_set, write_whole
from beamdesign.records import InputError


@dataclass(frozen=True)
class Template:
    """One thing to start.

    Attributes:
        purpose: in a few words.
        next: the commands that take it, best first; `{it}` stands for its path, `{name}` for its name.
        files: of a folder, its names, each with the file of this package it comes from; none where it is one file,
            which comes from that of the template's name.
    """

    purpose: str
    next: tuple[str, ...]
    files: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder of files."""
        return bool(self.files)


TEMPLATES = {
    "study": Template(
        "a link to design from scratch: load, lengths, hydraulics, goals",
        ("beamdesign run {it} --out results/{name}", "beamdesign size {it}"),
    ),
    "codesign": Template(
        "a link whose sections, end mass and controller are chosen together",
        (
            "beamdesign codesign {it} --bandwidth-Hz 2 --out results/{name}",
            "beamdesign front {it} --out results/front",
            "beamdesign remedies {it} --out results/remedies",
        ),
    ),
    "rig": Template(
        "a rig that has been measured, by its lumped figures",
        ("beamdesign certify {it}", "beamdesign tune {it} --out results/{name}"),
    ),
    "sweep": Template(
        "a folder with a study and a sweep over figures of it",
        ("beamdesign study run {it}/sweep.toml --out results/{name}",),
        {"sweep.toml": "sweep.toml", "study.toml": "study.toml"},
    ),
    "bench": Template(
        "a servovalve and its cylinder on a bench",
        (
            "beamdesign new bench-scenario --out moves.toml",
            "beamdesign simulate {it} --scenario moves.toml --out results/{name}",
        ),
    ),
    "scenario": Template(
        "what is done to a rig in a simulation", ("beamdesign simulate PROTOTYPE --scenario {it} --out results/{name}",)
    ),
    "bench-scenario": Template(
        "what an actuator bench is told to do", ("beamdesign simulate BENCH --scenario {it} --out results/{name}",)
    ),
    "dataset": Template(
        "a folder for what came back from a rig, with the model that was believed",
        ("beamdesign gap diagnose {it} --out results/{name}_diagnosis",),
        {"dataset.toml": "dataset.toml", "prototype.toml": "rig.toml"},
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
    files = template.files or {"": f"{name}.toml"}
    paths = [place / inside for inside in files]
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
    sources = (Path(__file__).with_name(source).read_text(encoding="utf-8") for source in files.values())
    texts = [re.sub(r'^name = ".*"$', lambda _: own, text, count=1, flags=re.MULTILINE) for text in sources]
    if template.is_folder:
        write_set(place, {inside: (inside, text) for inside, text in zip(files, texts, strict=True)})
    else:
        write_whole(place, *texts)
    return paths


def target(name: str, out: Path | None) -> Path:
    """Where a template goes."""
    return out if out is not None else Path(name if TEMPLATES[name].is_folder else f"{name}.toml")
