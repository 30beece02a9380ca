"""Words on terminals that cannot show every letter: what they lack is written with the letters that they have."""

import codecs
import sys
import unicodedata

_IN_ASCII = {
    "±": "+-", "µ": "u", "μ": "u", "×": "x", "·": "*", "°": " deg", "≤": "<=", "≥": ">=", "→": "->", "►": ">",
    "…": "...", "–": "-", "—": "-", "−": "-", "‘": "'", "’": "'", "“": '"', "”": '"', "ß": "ss", "σ": "sigma",
    "ζ": "zeta", "Ω": "ohm",
}  # fmt: skip


def write_in_any_encoding() -> None:
    """Let standard output and error stand in for what their encoding lacks, instead of failing on it."""
    codecs.register_error("beamdesign.nearest", _nearest)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="beamdesign.nearest")


def _nearest(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    return "".join(map(in_ascii, error.object[error.start : error.end])), error.end


def in_ascii(letter: str) -> str:
    """A letter by its nearest in ASCII; a question mark where there is none."""
    plain = "".join(c for c in unicodedata.normalize("NFKD", letter) if c.isascii())
    return _IN_ASCII.get(letter) or plain or "?"
