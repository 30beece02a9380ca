"""Machine code from a CasADi SX function: its instruction list written as LLVM IR and handed to llvmlite.

The code is straight-line, so that a function of a few hundred operations is ready within some ten milliseconds.
Products and sums may be fused (`contract`) and divisions by what depends on parameters alone become products; nothing
else of the arithmetic is rearranged. NaN and infinities pass through. No compiler is needed on the machine, and nothing
is kept on disk.
"""

import ctypes
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

_FLOAT = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul", ca.OP_DIV: "fdiv"}
_COMPARISON = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}


def _named(names: str, called: str) -> dict[int, str]:
    """Functions by CasADi's numbers of the operations that are called like them."""
    return {getattr(ca, f"OP_{name.upper()}"): called.format(name) for name in names.split()}


_CALL = _named("sqrt exp log sin cos fabs floor ceil", "llvm.{}.f64")
_CALL |= _named("tan asin acos atan sinh cosh tanh log1p expm1", "{}")
_CALL_OF_TWO = _named("pow copysign", "llvm.{}.f64") | _named("atan2 hypot", "{}") | {ca.OP_CONSTPOW: "llvm.pow.f64"}
_LINE = {code: f"{name} contract double {{0}}, {{1}}" for code, name in _FLOAT.items()}
_LINE |= {code: f"call double @{name}(double {{0}})" for code, name in _CALL.items()}
_LINE |= {code: f"call double @{name}(double {{0}}, double {{1}})" for code, name in _CALL_OF_TWO.items()}
_LINE |= {
    ca.OP_NEG: "fneg double {0}",
    ca.OP_SQ: "fmul contract double {0}, {0}",
    ca.OP_TWICE: "fadd contract double {0}, {0}",
    ca.OP_INV: "fdiv double 1.0, {0}",
}
_TRUTH = {code: f"fcmp {name} double {{0}}, {{1}}" for code, name in _COMPARISON.items()}
_TRUTH |= {ca.OP_NOT: "fcmp oeq double {0}, 0.0"}
_KNOWN = {*_LINE, *_TRUTH, ca.OP_FMIN, ca.OP_FMAX, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO, ca.OP_SIGN}
TIME, PARAMETERS = 0, 3
"""Positions of t and p among the inputs t, x, u, p of a function."""


@dataclass(frozen=True)
class Value:
    """One operation of a function, in the order of evaluation.

    Attributes:
        code: CasADi's number of the operation; OP_CONST and OP_INPUT for the leaves.
        of: operands, by position in the list; for an input its argument and entry.
        constant: of OP_CONST.
        fixed: whether it depends on parameters alone.
    """

    code: int
    of: tuple[int, ...]
    constant: float = 0.0
    fixed: bool = False


@dataclass(frozen=True)
class Trace:
    """Values of a function and which of them are the stored entries of each output."""

    values: tuple[Value, ...]
    outputs: tuple[tuple[int, ...], ...]


def trace(function: ca.Function) -> Trace:
    """Operations of an SX function, such as (t, x, u, p) -> outputs.

    Raises:
        NotImplementedError: at an operation that is not known here.
    """
    values: list[Value] = []
    held: dict[int, int] = {}  # what each work register holds
    outputs: list[dict[int, int]] = [{} for _ in range(function.n_out())]
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        target, origin = function.instruction_output(k), function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            outputs[target[0]][target[1]] = held[origin[0]]
            continue
        if code == ca.OP_ASSIGN:
            held[target[0]] = held[origin[0]]
            continue
        if code == ca.OP_CONST:
            value = Value(code, (), float(function.instruction_constant(k)), True)
        elif code == ca.OP_INPUT:
            value = Value(code, tuple(origin), fixed=origin[0] == PARAMETERS)
        elif code in _KNOWN:
            of = tuple(held[register] for register in origin)
            if code == ca.OP_DIV and values[of[1]].fixed and not values[of[0]].fixed:
                values.append(Value(ca.OP_INV, of[1:], fixed=True))
                code, of = ca.OP_MUL, (of[0], len(values) - 1)
            value = Value(code, of, fixed=all(values[j].fixed for j in of))
        else:
            raise NotImplementedError(f"CasADi operation {code}")
        values.append(value)
        held[target[0]] = len(values) - 1
    zero = len(values)
    values.append(Value(ca.OP_CONST, (), 0.0, True))
    entries = (tuple(found.get(j, zero) for j in range(function.nnz_out(i))) for i, found in enumerate(outputs))
    return Trace(tuple(values), tuple(entries))


def number(value: float) -> str:
    """A double as LLVM reads it, without loss."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


class Body:
    """Lines of one LLVM function, with the values of a trace brought in where they are first read."""

    def __init__(self, values: Sequence[Value], kept: dict[int, int] | None):
        """Start empty.

        Args:
            values: of the trace.
            kept: slots of the array c from which values that depend on parameters alone are read, filled as they are
                met; None in the function that works them out.
        """
        self.lines: list[str] = []
        self._values = values
        self._kept = kept
        self._names: dict[int, str] = {}
        self._count = 0

    def line(self, text: str) -> str:
        """Add an instruction and give the name of its result."""
        self._count += 1
        name = f"%r{self._count}"
        self.lines.append(f"{name} = {text}")
        return name

    def load(self, array: str, entry: int, kind: str = "double") -> str:
        """Read an entry (or a vector that begins there) of an array argument."""
        address = self.line(f"getelementptr double, ptr %{array}, i64 {entry}")
        return self.line(f"load {kind}, ptr {address}, align 8")

    def store(self, name: str, array: str, entry: int, kind: str = "double") -> None:
        """Write an entry (or a vector that begins there) of an array argument."""
        address = self.line(f"getelementptr double, ptr %{array}, i64 {entry}")
        self.lines.append(f"store {kind} {name}, ptr {address}, align 8")

    def read(self, k: int) -> str:
        """Name of a value, after its instructions and those of all it needs."""
        pending = [k]
        while pending:
            top = pending[-1]
            value = self._values[top]
            kept = value.fixed and self._kept is not None
            needed = () if kept or value.code in (ca.OP_CONST, ca.OP_INPUT) else value.of
            missing = [j for j in needed if j not in self._names]
            if top in self._names or not missing:
                pending.pop()
                if top not in self._names:
                    self._names[top] = self._written(top)
            else:
                pending += missing
        return self._names[k]

    def _written(self, k: int) -> str:
        value = self._values[k]
        if value.code == ca.OP_CONST:
            return number(value.constant)
        if value.fixed and self._kept is not None:
            return self.load("c", self._kept.setdefault(k, len(self._kept)))
        if value.code == ca.OP_INPUT:
            argument, entry = value.of
            return "%t" if argument == TIME else self.load("txup"[argument], entry)
        return self._operation(value.code, *(self._names[j] for j in value.of))

    def _operation(self, code: int, a: str, b: str = "") -> str:
        if code in _LINE:
            return self.line(_LINE[code].format(a, b))
        if code in _TRUTH:
            return self._as_number(self.line(_TRUTH[code].format(a, b)))
        if code in (ca.OP_FMIN, ca.OP_FMAX):
            first = self.line(f"fcmp {'olt' if code == ca.OP_FMIN else 'ogt'} double {a}, {b}")
            return self.line(f"select i1 {first}, double {a}, double {b}")
        if code in (ca.OP_AND, ca.OP_OR):
            both = "and" if code == ca.OP_AND else "or"
            return self._as_number(self.line(f"{both} i1 {self._truth(a)}, {self._truth(b)}"))
        if code == ca.OP_IF_ELSE_ZERO:
            return self.line(f"select i1 {self._truth(a)}, double {b}, double 0.0")
        above, below = (self._as_number(self.line(f"fcmp {side} double {a}, 0.0")) for side in ("ogt", "olt"))
        return self.line(f"fsub double {above}, {below}")  # the sign

    def _truth(self, name: str) -> str:
        return self.line(f"fcmp une double {name}, 0.0")

    def _as_number(self, truth: str) -> str:
        return self.line(f"uitofp i1 {truth} to double")


@dataclass(frozen=True)
class MachineCode:
    """Functions in memory.

    Attributes:
        address: by name, of functions (double t, x, u, c, out) of which all but t are pointers to doubles.
        prepare: (p, c) pointers; fills c with what depends on parameters alone, once per record.
        constants: length of c.
        engine: what keeps them in memory.
    """

    address: Mapping[str, int]
    prepare: Callable[[int, int], None]
    constants: int
    engine: Any = field(repr=False)

    def prepared(self, parameters: np.ndarray) -> np.ndarray:
        """The array c of a record, of `constants` entries."""
        given, c = np.ascontiguousarray(parameters, dtype=float), np.zeros(max(1, self.constants))
        self.prepare(given.ctypes.data, c.ctypes.data)
        return c


def machine_code(values: Sequence[Value], functions: Mapping[str, Callable[[Body], None]]) -> MachineCode:
    """Compile functions (t, x, u, c, out) that share what depends on parameters alone.

    Args:
        values: of a trace.
        functions: by name, what writes the lines of each.
    """
    kept: dict[int, int] = {}
    texts = []
    for name, write in functions.items():
        body = Body(values, kept)
        write(body)
        texts.append(_defined(name, "double %t, " + _pointers("x", "u", "c", "out"), body))
    body = Body(values, None)
    for k, slot in kept.items():
        body.store(body.read(k), "c", slot)
    texts.append(_defined("prepare", _pointers("p", "c"), body))
    declared = [f"declare double @{name}(double)" for name in sorted(set(_CALL.values()))]
    declared += [f"declare double @{name}(double, double)" for name in sorted(set(_CALL_OF_TWO.values()))]
    engine = _compiled("\n".join([*declared, *texts]))
    prepare = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(engine.get_function_address("prepare"))
    address = {name: engine.get_function_address(name) for name in functions}
    return MachineCode(address, prepare, len(kept), engine)


def _pointers(*names: str) -> str:
    return ", ".join(f"ptr noalias nocapture %{name}" for name in names)


def _defined(name: str, arguments: str, body: Body) -> str:
    return "\n  ".join([f"define void @{name}({arguments}) nounwind {{", *body.lines, "ret void"]) + "\n}"


@cache
def _target() -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


def _compiled(text: str) -> Any:
    """An engine that holds the functions of a module.

    LLVM's passes over them are left out: what they would find CasADi has found, and measured they make the code slower.
    """
    import llvmlite.binding as llvm

    machine = _target().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=2
    )
    module = llvm.parse_assembly(text)
    module.verify()
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    return engine


_LANES = 8  # widest vector of doubles a processor has; LLVM splits it for others

Rows = list[list[tuple[int, int]]]
"""Of a sparse matrix: per row its columns and the values there, by position in a trace."""


def rows_of(traced: Trace, function: ca.Function, output: int) -> Rows:
    """The rows of an output of a function."""
    shape = function.sparsity_out(output)
    rows: Rows = [[] for _ in range(shape.size1())]
    for row, column, value in zip(*shape.get_triplet(), traced.outputs[output], strict=True):
        rows[row].append((column, value))
    return rows


def add_product(body: Body, a: Rows, b: Rows, states: int, before: int, width: int) -> None:
    """Write out A S + B row by row behind the first entries of `out`; S follows the states in `x` likewise."""
    for row, (of_states, of_parameters) in enumerate(zip(a, b, strict=True)):
        first = 0
        while first < width:
            lanes = next(size for size in (_LANES, 4, 2, 1) if size <= width - first)
            kind, total = f"<{lanes} x double>", "zeroinitializer"
            for column, value in of_parameters:
                if first <= column < first + lanes:
                    total = body.line(f"insertelement {kind} {total}, double {body.read(value)}, i32 {column - first}")
            for column, value in of_states:
                s = body.load("x", states + column * width + first, kind)
                single = body.line(f"insertelement {kind} poison, double {body.read(value)}, i32 0")
                spread = body.line(f"shufflevector {kind} {single}, {kind} poison, <{lanes} x i32> zeroinitializer")
                part = body.line(f"fmul contract {kind} {spread}, {s}")
                total = part if total == "zeroinitializer" else body.line(f"fadd contract {kind} {total}, {part}")
            body.store(total, "out", before + row * width + first, kind)
            first += lanes
