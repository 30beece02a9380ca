"""Replay of any certificate, by the kind it states; each kind has a stand-alone file that proves it again."""

import tomllib
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from beamdesign.records import InputError

ROOMS = {
    "beamdesign.mass_range": "beamdesign.proof.replay",
    "beamdesign.arm_plane": "beamdesign.proof.replay_arm",
    "beamdesign.members": "beamdesign.proof.replay_members",
    "beamdesign.switching": "beamdesign.proof.replay_lyapunov",
    "beamdesign.box": "beamdesign.proof.replay_box",
    "beamdesign.contact": "beamdesign.proof.replay_contact",
    "beamdesign.stages": "beamdesign.proof.replay_stages",
}
"""Kinds of certificates, and the stand-alone module that replays each."""


@dataclass(frozen=True)
class Replayed:
    """Outcome of a replay.

    Attributes:
        kind: of the certificate.
        text: the certificate.
        valid: whether every statement was proved again.
        reasons: in words, every statement that was not.
        claims: in words, every statement that was.
    """

    kind: str
    text: str
    valid: bool
    reasons: tuple[str, ...]
    claims: tuple[str, ...]


def replay(path: str | Path) -> Replayed:
    """Prove a certificate again from its own figures.

    Raises:
        InputError: where the file is not a certificate that can be read.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        kind = tomllib.loads(text).get("kind")
    except OSError as error:
        raise InputError(path, [("(certificate)", error.strerror or str(error))]) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(path, [("(certificate)", f"not a certificate: {error}")]) from error
    if kind not in ROOMS:
        raise InputError(path, [("kind", f"must be one of {', '.join(ROOMS)}, is {kind!r}")])
    room = import_module(ROOMS[kind])
    try:
        outcome = room.replay(path)
    except room.Malformed as error:
        raise InputError(path, [("(certificate)", str(error))]) from error
    return Replayed(kind, text, outcome.valid, outcome.reasons, outcome.claims)
