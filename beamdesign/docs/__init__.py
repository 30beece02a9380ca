"""What can be explained: every key of every file, as records and effects tell it, and pages on parts of the tool."""

import difflib
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, get_origin

from pydantic.fields import FieldInfo

from beamdesign.docs.fields import bounds_of, default_of, described, first_sentence, kind_of, numeric
from beamdesign.quantities import unit_of
from beamdesign.records import Record, nested_records, of_own_names
from beamdesign.structure.materials import material_names

FILES = {
    "prototype": "beamdesign.prototype:Prototype",
    "study": "beamdesign.problem:DesignProblem",
    "sweep": "beamdesign.sweep.sweep_file:Sweep",
    "scenario": "beamdesign.scenario:Scenario",
    "data set": "beamdesign.diagnosis.data.dataset_index:Index",
    "bench prototype": "beamdesign.bench_prototype:BenchPrototype",
    "bench data set": "beamdesign.diagnosis.data.bench_set:_File",
}
"""Kinds of file, each with the record that it is read as."""


@cache
def pages() -> dict[str, str]:
    """The text of each page, in Markdown, by its topic in alphabetical order: `beamdesign explain TOPIC` prints one."""
    return {path.stem: path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parent.glob("*.md"))}


def topics() -> dict[str, str]:
    """What there is a page on: name and title of each."""
    return {topic: text.partition("\n")[0].lstrip("# ").strip() for topic, text in pages().items()}


@dataclass(frozen=True)
class Key:
    """One key of one kind of file.

    Attributes:
        path: with dots, as error messages name it; lists of tables have no numbers in it.
        file: a key of `FILES`.
        meaning: in words.
        kind: what may stand there, in words.
        unit: SI; empty for text and tables, "1" for a ratio.
        bounds: in words, empty where there are none.
        default: what holds where it is absent, in words.
        table: what the table it stands in describes.
        source: of the definition; empty where there is none beside the meaning.
        only_for: kinds of the table that have it; empty where all do.
        is_table: whether it is a table (or a list of them) rather than a figure.
        values: of what has values by name, each with what it means; empty where nothing tells more than the name.
    """

    path: str
    file: str
    meaning: str
    kind: str
    unit: str
    bounds: str
    default: str
    table: str
    source: str = ""
    only_for: tuple[str, ...] = ()
    is_table: bool = False
    values: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        """The key itself, without its table."""
        return self.path.rpartition(".")[2]

    @property
    def facts(self) -> tuple[Any, ...]:
        """All that is told of it but where it stands."""
        return (self.name, self.meaning, self.kind, self.unit, self.bounds, self.default, self.source, self.only_for)


@dataclass(frozen=True)
class EffectEntry:
    """One effect of the library.

    Attributes:
        name: as prototypes spell it.
        subsystem: where it sits.
        meaning: in words.
        source: of its law.
        linear: what stands for it in proofs; empty where nothing does.
        leaves_out: what of it the proofs do not cover.
        rigs: kinds of prototype that have the ports it needs.
        parameters: its figures.
    """

    name: str
    subsystem: str
    meaning: str
    source: str
    linear: str
    leaves_out: str
    rigs: tuple[str, ...]
    parameters: tuple[Key, ...]


@cache
def keys() -> tuple[Key, ...]:
    """All keys of all kinds of file, tables before what stands in them, effects last."""
    found = []
    for file, place in FILES.items():
        module, name = place.split(":")
        found += list(_walk(getattr(import_module(module), name), file))
    return (*found, *(key for effect in effects() for key in effect.parameters))


@cache
def effects() -> tuple[EffectEntry, ...]:
    """All effects that are causes by themselves, in alphabetical order."""
    from beamdesign.plant.effects import causes

    return tuple(_entry(name) for name in causes())


def _entry(name: str) -> EffectEntry:
    from beamdesign.plant.assembly import RIGS
    from beamdesign.plant.effects import library

    effect = library()[name]
    law = next(iter(effect.laws.values()))
    words = effect.meaning or import_module(getattr(law, "func", law).__module__).__doc__ or ""  # the law of a partial
    rigs = tuple(kind for kind, rig in RIGS.items() if all(port in rig.ports for port in effect.laws))
    parameters = tuple(
        Key(
            f"effects.{name}.{q.name}", "prototype", q.meaning, "a number", unit_of(q.name) or "1",
            f"from {q.low:g} to {q.high:g}", f"{q.default:g}", first_sentence(words), effect.source,
        )
        for q in effect.parameters
    )  # fmt: skip
    in_proofs = (effect.linear.covers, effect.linear.leaves_out) if effect.linear else ("", "")
    own = effect.subsystem, " ".join(words.split()), effect.source
    return EffectEntry(name, *own, *in_proofs, rigs, parameters)


def plain(word: str) -> str:
    """A key without the brackets of tables and of entries."""
    return re.sub(r"\[\d+\]", "", word).strip("[]")


def find(word: str) -> tuple[Key, ...]:
    """The keys that a word names: a whole path, the end of one, or a table, which gives the keys in it as well.

    An entry of a list, as `controller.section[0]`, goes by its list, and a table under a name of its own by NAME.
    """
    known, word = keys(), plain(word)
    of_own = {re.escape(key.path.partition(".NAME.")[0]) for key in known if ".NAME." in key.path}
    named = re.sub(rf"^({'|'.join(of_own)})\.[^.]+", r"\1.NAME", word).removesuffix(".NAME")
    exact = [key for key in known if key.path in (word, named) or key.path.endswith("." + word)]
    tables = {key.path for key in exact if key.is_table}
    inside = [key for key in known if key.path.rpartition(".")[0].removesuffix(".NAME") in tables and key not in exact]
    return (*exact, *inside)


def with_value(word: str) -> tuple[Key, ...]:
    """The keys that a word is a value of, as "lag" of a controller's kind."""
    return tuple(key for key in keys() if f'"{word}"' in key.kind)


def effect_named(word: str) -> EffectEntry | None:
    """The effect of that name, also given as `effects.NAME`; laws to be learnt among them."""
    from beamdesign.plant.effects import library

    name = plain(word).removeprefix("effects.")
    return _entry(name) if name in library() else None


def words(beside: str = "") -> tuple[str, ...]:
    """All that can be asked for, each once: keys, tables, values, effects, topics by name; beside a dot, paths."""
    names = {key.name for key in keys()} | {effect.name for effect in effects()} | set(topics())
    names |= {value for key in keys() for value in re.findall(r'"(\w+)"', key.kind)} | set(material_names())
    return tuple(sorted({key.path for key in keys()} if "." in beside else names))


def nearest(word: str) -> tuple[str, ...]:
    """Up to three known words that look like one that is not known, best first; paths where it has a dot."""
    word = plain(word)
    close = difflib.get_close_matches(word, words(word), n=3, cutoff=0.5)
    return tuple(close or difflib.get_close_matches(word.rpartition(".")[2], words(), n=3, cutoff=0.5))


def _walk(record: type[Record], file: str, prefix: str = "") -> Iterator[Key]:
    table, source = described(record)
    for name, field in ((name, one) for name, one in record.model_fields.items() if not one.exclude):
        path = f"{prefix}{name}"
        nested = nested_records(Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation)
        if not nested:
            yield Key(
                path, file, field.description or "", kind_of(field.annotation),
                (unit_of(name) or "1") if numeric(field.annotation) else "", bounds_of(field), default_of(field), table,
                source,
            )  # fmt: skip
            continue
        yield _table(path, file, field, nested, source)
        below = path + (".NAME." if of_own_names(field.annotation) else ".")
        kinds = [str(each.model_fields["kind"].default) if len(nested) > 1 else "" for each in nested]
        inside = [(tag, key) for tag, each in zip(kinds, nested, strict=True) for key in _walk(each, file, below)]
        for tagged in _gathered(inside, lambda one: one[1].path).values():
            yield from _merged(tagged, len(nested), getattr(nested[0], "where_none_is_stated", ""))


def _table(path: str, file: str, field: FieldInfo, nested: list[type[Record]], source: str) -> Key:
    meaning = field.description or "; or ".join(described(each)[0] for each in nested)
    default = "needed" if field.is_required() else "may be left out"
    kind = "a list of tables" if get_origin(field.annotation) is tuple else "a table"
    if of_own_names(field.annotation):
        kind = "a table of tables, each under a name of your own"
    if len(nested) > 1:
        kind += ", kind one of " + ", ".join(str(each.model_fields["kind"].default) for each in nested)
    return Key(path, file, meaning, kind, "", "", default, meaning, source, is_table=True)


def _merged(tagged: list[tuple[str, Key]], kinds: int, usual: str) -> Iterator[Key]:
    """Keys of one path from several kinds of table: one where all is alike, else one for each that differs.

    The usual kind is that of a table that states none.
    """
    for alike in _gathered(tagged, lambda one: () if one[1].name == "kind" else one[1].facts).values():
        tags, key = tuple(tag for tag, _ in alike), alike[0][1]
        facts: dict[str, Any] = {"only_for": tags if len(tags) < kinds else key.only_for}
        if key.name == "kind" and kinds > 1:
            facts |= {"kind": "one of " + ", ".join(f'"{tag}"' for tag in tags), "default": usual or "needed"}
            facts["values"] = tuple((tag, one.table) for tag, one in alike)
        yield replace(key, **facts)


def places(alike: Iterable[Key]) -> str:
    """Where keys that are the same in all but their place may stand."""
    of_file = {file: ", ".join(key.path for key in own) for file, own in _gathered(alike, attrgetter("file")).items()}
    of_paths = _gathered(of_file, of_file.__getitem__)
    return "; ".join(f"{paths} ({', '.join(files)})" for paths, files in of_paths.items())


def alike(found: Iterable[Key]) -> list[list[Key]]:
    """Keys gathered by what is told of them, in order of first appearance."""
    return list(_gathered(found, attrgetter("facts")).values())


def _gathered(items: Iterable[Any], by: Callable[[Any], Any]) -> dict[Any, list[Any]]:
    """Items by something of each, in order of first appearance."""
    groups: dict[Any, list[Any]] = {}
    for item in items:
        groups.setdefault(by(item), []).append(item)
    return groups


def value_words(key: Key) -> str:
    """Type, unit and bounds of what may stand there."""
    words = key.kind
    if key.unit:
        words += " without unit" if key.unit == "1" else f" in {key.unit}"
    return words + (f", {key.bounds}" if key.bounds else "")


def key_lines(group: list[Key]) -> Iterator[str]:
    """What there is to say of one key (or of several that are alike)."""
    key = group[0]
    yield key.name if not key.is_table else f"[{key.name}]"
    yield f"  {key.meaning}"
    yield f"  value:   {value_words(key)}"
    yield f"  default: {key.default}"
    if key.only_for:
        yield f"  only in: tables of kind {', '.join(key.only_for)}"
    yield f"  stands:  {places(group)}"
    if key.source:
        yield f"  source:  {key.source}"


def value_lines(value: str, found: Iterable[Key]) -> Iterator[str]:
    """What there is to say of one value of some keys, the figures that it brings included."""

    def shown(key: Key) -> tuple[str, str, str, str]:
        table = key.path.rpartition(".")[0]
        beside = [k for k in keys() if (k.file, k.path.rpartition(".")[0]) == (key.file, table) and value in k.only_for]
        return key.name, key.meaning, dict(key.values).get(value, ""), ", ".join(k.name for k in beside)

    for k, ((name, meaning, means, brings), group) in enumerate(_gathered(found, shown).items()):
        yield from [""] * (k > 0)
        yield f'{name} = "{value}"'
        yield f"  {meaning}"
        if means:
            yield f"  means:   {means}"
        if brings:
            yield f"  with:    {brings}"
        yield f"  stands:  {places(group)}"


def effect_lines(effect: EffectEntry) -> Iterator[str]:
    """What there is to say of an effect, its parameters included."""
    yield f"[effects.{effect.name}]"
    yield f"  {effect.meaning}"
    yield f"  subsystem: {effect.subsystem}"
    yield f"  stands:    in the prototype of {' and of '.join(effect.rigs)}"
    yield f"  source:    {effect.source}"
    yield f"  in proofs: {effect.linear or 'nothing stands for it'}"
    if effect.leaves_out:
        yield f"             not covered: {effect.leaves_out}"
    for q in effect.parameters:
        yield f"  {q.name} = {q.default}"
        yield f"      {q.meaning}; {value_words(q)}"


def reference_markdown() -> str:
    """All keys and effects as Markdown: one table per kind of file, what was told before not repeated."""
    out = ["`beamdesign explain KEY` tells the same of one key, table or effect.", ""]
    stated: set[Any] = set()
    plain = (key for key in keys() if not key.path.startswith("effects."))
    for file, own in _gathered(plain, attrgetter("file")).items():
        summary = f"<details><summary>Keys of a {file}</summary>"
        out += [summary, "", "| key | meaning | value | default |", "|---|---|---|---|"]
        inside = _gathered(own, lambda key: key.path.rpartition(".")[0]).items()
        for facts, tables in _gathered(inside, lambda item: tuple(k.facts for k in item[1] if not k.is_table)).items():
            if not facts:
                continue
            heading = ", ".join(f"`[{name}]`" for name, _ in tables if name)
            if facts in stated:
                out.append(f"| {heading} | as above | | |")
                continue
            stated.add(facts)
            if heading:
                about = next((key.meaning for key in own if key.path == tables[0][0].removesuffix(".NAME")), "")
                out.append(f"| {heading} | *{_cell(about)}* | | |")
            out += (_row(key) for key in tables[0][1] if not key.is_table)
        out += ["", "</details>", ""]
    summary = "<details><summary>Effects of a prototype and their figures</summary>"
    out += [summary, "", "| effect and its figures | meaning | value | default |", "|---|---|---|---|"]
    for effect in effects():
        out.append(f"| `[effects.{effect.name}]` | *{_cell(effect.meaning.split('. ')[0].rstrip('.'))}* | | |")
        out += [_row(key) for key in effect.parameters]
    return "\n".join([*out, "", "</details>"]) + "\n"


def _row(key: Key) -> str:
    value = value_words(key).removeprefix("a number").strip(" ,")
    value = value.removeprefix("in ").replace(" without unit", "").removeprefix("without unit").strip(" ,")
    only = f" ({', '.join(key.only_for)})" if key.only_for else ""
    default = "" if key.default == "none" else key.default
    return f"| `{key.name}` | {_cell(key.meaning)}{only} | {_cell(value)} | {_cell(default)} |"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("*", "\\*").replace("<", "&lt;")
