"""Replay of any certificate, by the kind it states; each kind has a stand-alone file that proves it again."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from beamdesign.proof.replay_limits import BeyondLimits, read_certificate
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
_WRONG_ENTRIES = (ArithmeticError, AttributeError, LookupError, MemoryError, RecursionError, TypeError, ValueError)
"""What comes of entries that are no figures, and of figures that make no loop."""


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
        text, table = read_certificate(path)
    except OSError as error:
        raise InputError(path, [("(certificate)", error.strerror or str(error))]) from error
    except BeyondLimits as error:
        raise InputError(path, [("(certificate)", str(error))]) from error
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in ROOMS:
        raise InputError(path, [("kind", f"must be one of {', '.join(ROOMS)}, is {str(kind)[:60]!r}")])
    room = import_module(ROOMS[kind])
    try:
        outcome = room.replay(text)
    except _WRONG_ENTRIES as error:
        words = str(error) if isinstance(error, room.Malformed) else f"an entry is not of its kind: {error!r}"
        raise InputError(path, [("(certificate)", words)]) from error
    return Replayed(kind, text, outcome.valid, outcome.reasons, outcome.claims)
