"""What long work says while it lasts."""

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Called with the share of the work that is done, 0 to 1, and what is being done."""


def silent(share: float, text: str) -> None:
    """Progress that nobody asked for."""
