"""`python -m beamdesign.checker CERTIFICATE [PROTOTYPE]`."""

import sys
from collections.abc import Sequence
from io import TextIOWrapper
from pathlib import Path

from beamdesign.checker import Unreadable, check


def main(arguments: Sequence[str]) -> int:
    """Prove a certificate again and say what was proved; exit status 0 proved, 1 not, 2 unreadable."""
    if len(arguments) not in (1, 2) or arguments[0].startswith("-"):
        print("usage: python -m beamdesign.checker CERTIFICATE [PROTOTYPE]", file=sys.stderr)
        return 2
    try:
        verdict = check(*map(Path, arguments))
    except Unreadable as error:
        print(f"{' '.join(arguments)}: {error}", file=sys.stderr)
        return 2
    if isinstance(sys.stdout, TextIOWrapper):  # a name may be of letters that a terminal does not have
        sys.stdout.reconfigure(errors="backslashreplace")
    for words in verdict.lines():
        print(words)
    print("valid" if verdict.valid else "NOT valid")
    return 0 if verdict.valid else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
