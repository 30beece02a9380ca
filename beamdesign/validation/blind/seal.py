"""Digests of answers and data, sealed before anybody looks for them and checked when answers are opened."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beamdesign.files import write_whole


@dataclass(frozen=True)
class Seal:
    """Digests.

    Attributes:
        answers: SHA-256 of each answer in its canonical form, by case.
        sets: SHA-256 of the files of each data set, by case.
        whole: SHA-256 of all of these.
        truth: digest of the program that drew the cases.
    """

    answers: Mapping[str, str]
    sets: Mapping[str, str]
    whole: str
    truth: str


def canonical(answer: Mapping[str, Any]) -> bytes:
    """An answer as bytes that do not depend on how it is laid out: sorted keys, no spaces, shortest figures.

    Raises:
        ValueError: for figures that are not finite.
    """
    return json.dumps(answer, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()


def sealed(answers: Mapping[str, Mapping[str, Any]], sets: Mapping[str, str], truth: str = "") -> Seal:
    """Seal answers.

    Args:
        answers: by case.
        sets: digest of each case's data, by case.
        truth: digest of the program that drew them.
    """
    each = {case: hashlib.sha256(canonical(answer)).hexdigest() for case, answer in sorted(answers.items())}
    return _whole(each, dict(sorted(sets.items())), truth)


def _whole(answers: Mapping[str, str], sets: Mapping[str, str], truth: str) -> Seal:
    content = canonical({"answers": answers, "sets": sets, "truth": truth})
    return Seal(answers, sets, hashlib.sha256(content).hexdigest(), truth)


def write_seal(seal: Seal, path: Path) -> None:
    """Write it down.

    Raises:
        OSError: where it cannot be written.
    """
    fields = {"whole": seal.whole, "truth": seal.truth, "answers": dict(seal.answers), "sets": dict(seal.sets)}
    write_whole(path, json.dumps(fields, indent=1) + "\n")


def read_seal(path: Path) -> Seal:
    """Read it back.

    Raises:
        OSError: where it cannot be read.
        ValueError: where it is no seal, or where its parts are not those that its whole was made of.
    """
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        found = _whole(fields["answers"], fields["sets"], fields["truth"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: no seal: {error}") from error
    if found.whole != fields["whole"]:
        raise ValueError(f"{path}: the digest of the whole is not that of its parts")
    return found


def broken(seal: Seal, answers: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Cases whose answer is not the one that was sealed: changed, taken away or put in."""
    wrong = [case for case in seal.answers if case not in answers] + [
        case for case in answers if case not in seal.answers
    ]
    for case, answer in answers.items():
        digest = hashlib.sha256(canonical(answer)).hexdigest()
        if case in seal.answers and digest != seal.answers[case]:
            wrong.append(case)
    return sorted(wrong)


def folder_digest(folder: Path) -> str:
    """SHA-256 of the names and the bytes of all files in a folder."""
    sha = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        sha.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()
