"""What a certificate may hold before any of its proofs is tried: limits of size, nesting, numbers and expressions.

All are about ten times what the largest certificates of this program hold; within them a replay ends.
"""

import ast
import tomllib
from collections import Counter
from math import comb, prod
from pathlib import Path
from typing import Any

from beamdesign.files import MEGABYTE, read_bytes

LARGEST_CERTIFICATE = 8 * MEGABYTE
DEEPEST = 32
LONGEST_NUMBER = 3_000
"""Characters of an entry of a list of numbers, or of one that stands alone."""
LONGEST_LIST = 256
"""Numbers in a row: coefficients of a polynomial, entries of a row of a matrix."""
LONGEST_EXPRESSION = 15_000
MOST_TERMS, HIGHEST_DEGREE, MOST_PRODUCTS = 2_000, 60, 100_000
"""Terms of a polynomial, power of a variable, and control points of a box, all before anything is multiplied out."""
_NOT_NUMBERS = ("tree",)


class BeyondLimits(ValueError):
    """The text is no certificate, or holds more than any certificate of this program."""


def read_certificate(path: str | Path) -> tuple[str, dict[str, Any]]:
    """Text and table of a certificate within the limits.

    Raises:
        OSError: where the file cannot be read or is too large.
        BeyondLimits: naming what is beyond.
    """
    try:
        text = read_bytes(path, LARGEST_CERTIFICATE).decode()
        table = tomllib.loads(text)
        _check(table, "", 1)
        if isinstance(leaves := table.get("leaf", {}), dict):
            for name, expression in (("p", table.get("p")), *leaves.items()):
                _check_expression(f"leaf.{name}" if name in leaves else name, expression)
    except (RecursionError, MemoryError) as error:
        raise BeyondLimits("it is nested too deeply") from error
    except BeyondLimits:
        raise
    except (ValueError, SyntaxError) as error:  # no text, TOML or expression, or an integer of thousands of digits
        raise BeyondLimits(f"not a certificate: {str(error)[:200]}") from error
    return text, table


def _check(value: Any, key: str, depth: int) -> None:
    if depth > DEEPEST:
        raise BeyondLimits(f"{key or 'it'} is nested more than {DEEPEST} deep")
    if isinstance(value, dict):
        for name, item in value.items():
            _check(item, f"{key}.{name}".lstrip("."), depth + 1)
    elif isinstance(value, list):
        numbers = sum(isinstance(item, str | int | float) for item in value)
        if numbers > LONGEST_LIST and key not in _NOT_NUMBERS:
            raise BeyondLimits(f"{key} holds {numbers} numbers in a row, more than {LONGEST_LIST}")
        for item in value:
            _check(item, key, depth + 1)
    elif isinstance(value, str) and len(value) > (
        LONGEST_EXPRESSION if "leaf" in key or key == "p" else LONGEST_NUMBER
    ):
        raise BeyondLimits(f"{key} is {len(value)} characters long")


def _check_expression(key: str, text: Any) -> None:
    if not isinstance(text, str):
        return
    terms, degrees = _size(ast.parse(text.strip(), mode="eval").body)
    points = prod(degree + 1 for name, degree in degrees.items() if name != "s")
    for found, most, what in (
        (terms, MOST_TERMS, "terms"),
        (max(degrees.values(), default=0), HIGHEST_DEGREE, "as a power of one name"),
        (points, MOST_PRODUCTS, "products of powers"),
    ):
        if found > most:
            raise BeyondLimits(f"{key} comes to {found} {what}, more than {most}")


def _size(node: ast.AST) -> tuple[int, Counter[str]]:
    """Terms of an expression when it is multiplied out, and the degree in every name, both at most."""
    match node:
        case ast.Name(id=name):
            return 1, Counter({name: 1})
        case ast.UnaryOp(operand=inner):
            return _size(inner)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(power))) if power > 0:
            terms, degrees = _size(left)
            # The largest power first: a binomial coefficient of thousands is itself long work.
            power = min(power, HIGHEST_DEGREE + 1)
            return comb(terms + power - 1, power), Counter({name: power * degree for name, degree in degrees.items()})
        case ast.BinOp(left=left, op=operation, right=right):
            (one, first), (other, second) = _size(left), _size(right)
            if isinstance(operation, ast.Add | ast.Sub):
                return one + other, first | second
            return one * other, first + second
    return 1, Counter()
