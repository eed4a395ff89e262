"""Vector instructions from Python's operators: what the compiled step is written in.

The functions of this room write LLVM instructions when numba compiles an intrinsic that calls them. A
block of tables is stepped side by side, eight double-precision numbers a vector; a table alone is a
block of one, with numbers in the place of vectors and the same source. LLVM splits vectors for which a
processor has no registers. Nothing is contracted but what says so (`Value.times_plus`), so that a
table's numbers do not depend on its batch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from llvmlite import binding, ir
from numba.core import cgutils, config

from shake_env.kernels.layout import PLACES, SCALAR

BLOCK = 32  # tables side by side
VECTOR = 8  # numbers of a vector
F64, F32 = ir.DoubleType(), ir.FloatType()
I64, I32, I8, I1 = (ir.IntType(bits) for bits in (64, 32, 8, 1))
TABLE = I64.as_pointer()
NUMBERS = F64.as_pointer()


def whole(number: int | ir.Value) -> ir.Value:
    """Return a whole number as LLVM's."""
    return ir.Constant(I64, number) if isinstance(number, int) else number


def wide_registers() -> bool:
    """Return whether numba compiles for registers of 512 bits."""
    named = config.CPU_FEATURES
    if named is not None or config.CPU_NAME not in (None, "", "host"):
        return "+avx512f" in (named or "")
    return bool(binding.get_host_cpu_features().get("avx512f", False))


class Value:
    """A number or a vector of numbers; operators write instructions. Integers wrap around."""

    __slots__ = ("b", "ir")

    def __init__(self, builder: Any, value: Any) -> None:
        self.b, self.ir = builder, value

    @property
    def count(self) -> int:
        """Numbers of the vector; 1 for a number."""
        return int(self.ir.type.count) if isinstance(self.ir.type, ir.VectorType) else 1

    @property
    def element(self) -> Any:
        """Type of each number."""
        return self.ir.type.element if isinstance(self.ir.type, ir.VectorType) else self.ir.type

    @property
    def floating(self) -> bool:
        """Whether the numbers are floating-point ones."""
        return isinstance(self.element, ir.DoubleType | ir.FloatType)

    def like(self, other: Value | float) -> Value:
        """Return another value with as many numbers as this one has."""
        if not isinstance(other, Value):
            kind = self.ir.type
            values = [other] * self.count if self.count > 1 else other
            return Value(self.b, ir.Constant(kind, values))
        if other.count == self.count:
            return other
        kind = ir.VectorType(other.element, self.count)
        first = self.b.insert_element(ir.Constant(kind, ir.Undefined), other.ir, ir.Constant(I32, 0))
        places = ir.Constant(ir.VectorType(I32, self.count), [0] * self.count)
        return Value(self.b, self.b.shuffle_vector(first, ir.Constant(kind, ir.Undefined), places))

    def _with(self, floats: str, integers: str, other: Value | float, swapped: bool = False) -> Value:
        mine = self
        if isinstance(other, Value) and other.count > self.count:
            mine = other.like(self)
        pair = (mine, mine.like(other))
        left, right = reversed(pair) if swapped else pair
        return Value(self.b, getattr(self.b, floats if self.floating else integers)(left.ir, right.ir))

    def __add__(self, other: Value | float) -> Value:
        return self._with("fadd", "add", other)

    def __sub__(self, other: Value | float) -> Value:
        return self._with("fsub", "sub", other)

    def __rsub__(self, other: float) -> Value:
        return self._with("fsub", "sub", other, swapped=True)

    def __mul__(self, other: Value | float) -> Value:
        return self._with("fmul", "mul", other)

    def __truediv__(self, other: Value | float) -> Value:
        return self._with("fdiv", "", other)

    def __rtruediv__(self, other: float) -> Value:
        return self._with("fdiv", "", other, swapped=True)

    def __xor__(self, other: Value | int) -> Value:
        return self._with("", "xor", other)

    def __and__(self, other: Value | int) -> Value:
        return self._with("", "and_", other)

    def __or__(self, other: Value | int) -> Value:
        return self._with("", "or_", other)

    def __lshift__(self, other: int) -> Value:
        return self._with("", "shl", other)

    def __rshift__(self, other: int) -> Value:
        return self._with("", "lshr", other)

    def __invert__(self) -> Value:
        return Value(self.b, self.b.not_(self.ir))

    def __neg__(self) -> Value:
        return self.like(-0.0) - self

    def signed_shift(self, places: int) -> Value:
        """Return the number shifted to the right, filled up with its sign."""
        return self._with("", "ashr", places)

    def turned(self, places: int) -> Value:
        """Return a 64-bit integer turned to the left."""
        return (self << places) | (self >> (64 - places))

    def _compared(self, sign: str, other: Value | float, nan: bool = False) -> Value:
        right = self.like(other)
        if not self.floating:
            return Value(self.b, self.b.icmp_signed(sign, self.ir, right.ir))
        compare = self.b.fcmp_unordered if nan else self.b.fcmp_ordered
        return Value(self.b, compare(sign, self.ir, right.ir))

    def __lt__(self, other: Value | float) -> Value:
        return self._compared("<", other)

    def __gt__(self, other: Value | float) -> Value:
        return self._compared(">", other)

    def __le__(self, other: Value | float) -> Value:
        return self._compared("<=", other)

    def __ge__(self, other: Value | float) -> Value:
        return self._compared(">=", other)

    def equals(self, other: Value | float) -> Value:
        """Return whether the numbers are equal."""
        return self._compared("==", other)

    def beyond(self, other: Value | float) -> Value:
        """Return whether the numbers are above others, or no numbers (NaN)."""
        return self._compared(">", other, nan=True)

    def choose(self, yes: Value | float, no: Value | float) -> Value:
        """Return one of two by this truth value."""
        like = yes if isinstance(yes, Value) else no
        assert isinstance(like, Value)
        if like.count < self.count:
            like = self.like(like)
        return Value(self.b, self.b.select(self.ir, like.like(yes).ir, like.like(no).ir))

    def called(self, name: str, *others: Value | float) -> Value:
        """Return LLVM's function of that name."""
        size = f"f{64 if isinstance(self.element, ir.DoubleType) else 32}"
        kind, count = self.ir.type, 1 + len(others)
        full = f"llvm.{name}.{f'v{self.count}' if self.count > 1 else ''}{size}"
        function = cgutils.get_or_insert_function(
            self.b.module, ir.FunctionType(kind, [kind] * count), full
        )
        return Value(self.b, self.b.call(function, [self.ir, *(self.like(o).ir for o in others)]))

    def absolute(self) -> Value:
        """Return the absolute value."""
        return self.called("fabs")

    def root(self) -> Value:
        """Return the square root."""
        return self.called("sqrt")

    def signed_as(self, other: Value) -> Value:
        """Return this number with the sign of another."""
        return self.called("copysign", other)

    def times_plus(self, factor: Value | float, term: Value | float) -> Value:
        """Return the product with a factor plus a term, rounded once where the processor can."""
        if isinstance(factor, Value) and factor.count > self.count:
            return factor.times_plus(self, term)
        return self.called("fmuladd", factor, term)

    def within(self, limit: Value) -> Value:
        """Return the number between -limit and limit; a NaN stays one."""
        low = limit * -1.0
        return (self > limit).choose(self.like(limit), (self < low).choose(self.like(low), self))

    def _kind(self, element: Any) -> Any:
        return ir.VectorType(element, self.count) if self.count > 1 else element

    def as_bits(self, element: Any) -> Value:
        """Return the same bits as numbers of another type."""
        return Value(self.b, self.b.bitcast(self.ir, self._kind(element)))

    def to(self, element: Any, signed: bool = True) -> Value:
        """Return the numbers in another type, rounded to the nearest."""
        kind, floating = self._kind(element), isinstance(element, ir.DoubleType | ir.FloatType)
        if self.floating:
            cast = self.b.fpext if element == F64 else self.b.fptrunc
            assert floating
        elif floating:
            cast = self.b.sitofp if signed else self.b.uitofp
        elif element.width < self.element.width:
            cast = self.b.trunc
        else:
            cast = self.b.sext if signed else self.b.zext
        return Value(self.b, cast(self.ir, kind))

    def shuffled(self, other: Value, places: Sequence[int]) -> Value:
        """Return numbers of this vector and another, by their places in both."""
        chosen = ir.Constant(ir.VectorType(I32, len(places)), list(places))
        return Value(self.b, self.b.shuffle_vector(self.ir, other.ir, chosen))

    def followed_by(self, other: Value) -> Value:
        """Return this vector and another as one."""
        return self.shuffled(other, range(2 * self.count))

    def part(self, first: int, count: int) -> Value:
        """Return some numbers of the vector."""
        return self.shuffled(self, range(first, first + count))

    def any(self) -> Any:
        """Return whether any of the truth values holds, as LLVM's truth value."""
        if self.count == 1:
            return self.ir
        bits = ir.IntType(self.count)
        return self.b.icmp_unsigned("!=", self.b.bitcast(self.ir, bits), ir.Constant(bits, 0))


class Variable:
    """A value that changes, such as a sum."""

    def __init__(self, builder: Any, value: Value) -> None:
        self._b, self._place = builder, cgutils.alloca_once(builder, value.ir.type)
        self.set(value)

    def get(self) -> Value:
        """Return what it is."""
        return Value(self._b, self._b.load(self._place))

    def set(self, value: Value) -> None:
        """Change it."""
        self._b.store(value.ir, self._place)


class Rows:
    """Rows of a block in memory, each a double-precision number (or a 64-bit integer) a table."""

    def __init__(self, code: Code, pointer: Any) -> None:
        self.code, self.pointer = code, pointer

    def at(self, row: int | Any) -> Rows:
        """Return the rows from one on."""
        code = self.code
        start = code.b.mul(whole(row), whole(code.block))
        return Rows(code, code.b.gep(self.pointer, [start]))

    def get(self, row: int | Any, lane: Any, element: Any = F64) -> Value:
        """Return a vector of a row, from a lane on."""
        code = self.code
        place = code.b.add(code.b.mul(whole(row), whole(code.block)), whole(lane))
        return code.load(code.b.bitcast(self.pointer, element.as_pointer()), place)

    def put(self, row: int | Any, lane: Any, value: Value) -> None:
        """Write a vector to a row, from a lane on."""
        code = self.code
        place = code.b.add(code.b.mul(whole(row), whole(code.block)), whole(lane))
        pointer = code.b.bitcast(self.pointer, value.element.as_pointer())
        code.store(pointer, place, code.zero(value.element).like(value))


class Code:
    """Where instructions are written, for a block of 1 or BLOCK tables.

    Parameters
    ----------
    builder
        llvmlite's, at the place.
    block
        Tables of a block.
    table
        Pointer to the table of whole numbers and addresses (:mod:`shake_env.kernels.layout`).
    """

    def __init__(self, builder: Any, block: int, table: Any = None) -> None:
        self.b, self.block, self.table = builder, block, table
        self.wide = min(block, VECTOR)

    # Values

    def value(self, number: Any) -> Value:
        """Return a number of LLVM's as a value."""
        return Value(self.b, number)

    def zero(self, element: Any = F64) -> Value:
        """Return a vector of zeros."""
        kind = ir.VectorType(element, self.wide) if self.wide > 1 else element
        value = 0.0 if element in (F64, F32) else 0
        return Value(self.b, ir.Constant(kind, [value] * self.wide if self.wide > 1 else value))

    def variable(self, value: Value) -> Variable:
        """Return a variable that begins with a value."""
        return Variable(self.b, value)

    # The table of whole numbers

    def whole(self, name: str) -> Any:
        """Return a whole number of the table."""
        return self.b.load(self.b.gep(self.table, [whole(PLACES[name])]))

    def pointer(self, name: str, element: Any = F64) -> Any:
        """Return an address of the table as a pointer."""
        return self.b.inttoptr(self.whole(f"at_{name}"), element.as_pointer())

    def scalar(self, name: str) -> Value:
        """Return one of the scalars."""
        return self.load(self.pointer("numbers"), SCALAR[name], 1)

    def entry(self, vector: str, place: Any) -> Value:
        """Return an entry of one of the vectors of numbers."""
        start = self.b.add(self.whole(f"vector_{vector}"), whole(place))
        return self.load(self.pointer("numbers"), start, 1)

    # Memory

    def load(self, pointer: Any, place: Any, count: int | None = None) -> Value:
        """Return a vector from memory; `count` numbers, or as many as a vector of the block has."""
        count = self.wide if count is None else count
        start = self.b.gep(pointer, [whole(place)])
        element = pointer.type.pointee
        kind = ir.VectorType(element, count) if count > 1 else element
        loaded = self.b.load(self.b.bitcast(start, kind.as_pointer()))
        loaded.align = element.width // 8 if isinstance(element, ir.IntType) else (8, 4)[element == F32]
        return Value(self.b, loaded)

    def store(self, pointer: Any, place: Any, value: Value) -> None:
        """Write a value to memory."""
        start = self.b.gep(pointer, [whole(place)])
        element = value.element
        stored = self.b.store(value.ir, self.b.bitcast(start, value.ir.type.as_pointer()))
        stored.align = element.width // 8 if isinstance(element, ir.IntType) else (8, 4)[element == F32]

    # Control

    @contextmanager
    def loop(self, count: Any, start: Any = None) -> Iterator[Any]:
        """Repeat what is written in the context for a whole number, from `start` to before `count`."""
        first = None if start is None else whole(start)
        with cgutils.for_range(self.b, whole(count), start=first) as each:
            yield each.index

    @contextmanager
    def lanes(self) -> Iterator[Any]:
        """Repeat what is written in the context for the first lane of each vector."""
        if self.block == 1:
            yield whole(0)
            return
        with cgutils.for_range(self.b, whole(self.block // VECTOR)) as each:
            yield self.b.mul(each.index, whole(VECTOR))

    def positive(self, number: Any) -> Any:
        """Return whether a whole number is above 0."""
        return self.b.icmp_signed(">", number, whole(0))

    def function(self, name: str, arguments: Sequence[Any], emit: Callable[..., None]) -> Any:
        """Return a function of the module that `emit` writes, written once.

        `emit` gets the code of the function and its arguments, of which the first is the table.
        """
        module, full = self.b.module, f"shake_{name}_{self.block}"
        if full in module.globals:
            return module.globals[full]
        kind = ir.FunctionType(ir.VoidType(), [TABLE, *arguments])
        function = ir.Function(module, kind, full)
        function.linkage = "internal"
        function.attributes.add("noinline")
        function.attributes.add("nounwind")
        builder = ir.IRBuilder(function.append_basic_block("entry"))
        emit(Code(builder, self.block, function.args[0]), *function.args[1:])
        builder.ret_void()
        return function

    def call(self, function: Any, *arguments: Any) -> None:
        """Call a function of the module with the table and arguments."""
        self.b.call(function, [self.table, *(whole(each) for each in arguments)])
