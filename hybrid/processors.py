"""Digital processors by name: how long their operations take, and how many operations a program is.

Stage 0 for `tasks`. The time of a cycle is the sum over its operations: an addition takes as long as a
subtraction, a comparison, a choice or a sign; every word computed is stored, which takes one `store`.
Functions that a machine has no instruction for are counted as the subroutines that they were: a
polynomial of six terms (C. Hastings, "Approximations for Digital Computers", 1955, has those of 1e-7)
is 6 multiplications and 6 additions, a square root is three steps of Newton's method (a division and an
addition each). Reading operands is in the published times of the machines that read them from memory.

Published times:

- `ibm_7090` (1959): fixed point, in cycles of 2.18 us, its core storage's: MPY at most 14, DVH at most
  14, which are one to read the instruction (I), one to read the operand (E) and twelve (L) (IBM 7090
  Customer Engineering Instruction-Reference, 223-6895, sections on the arithmetic instructions). ADD is
  I and E: 229,000 additions in a second (IBM's figure, as in "A Complete History of Mainframe
  Computing", Tom's Hardware) are two cycles. The time of STO is inferred, not published anywhere that we
  could look up: the storage is in use once to read the instruction and once to write the word, so two
  cycles, as for ADD, which reads the instruction and a word.
- `ibm_1620` (1959), with automatic floating point: add 1.2 ms, multiply 12.5 ms, divide 41.7 ms for
  mantissas of eight digits, operands in memory (IBM's announcement). Results are written by the
  operation itself.
- `apollo_guidance_computer` (Block II, 1966): 15-bit words, memory cycles of 11.72 us: AD two, MP three,
  DV six, TS two, and one for the EXTEND that goes before MP and DV (tables of times in yaAGC,
  agc_engine.c, of the Virtual AGC project; H. Blair-Smith's annotations to E. Hall, "Journey to the
  Moon").
- `cdc_6600` (1964): minor cycles of 100 ns: floating multiply 10, floating divide 29, and 3 for the
  increment unit, which sets the address that stores (J. Thornton, "Design of a Computer: the Control
  Data 6600", 1970, table of execution times); floating add 4 ("Functional units in the CDC 7600",
  University of Edinburgh, homepages.inf.ed.ac.uk/rni/comp-arch). Its units work at the same time;
  counted one after the other, this is the slow side of the truth.
- `cortex_m4f`: a microcontroller of 48 MHz with Arm's single-precision unit: add and multiply one
  cycle, divide 14, load two (Texas Instruments SWCU192, tables of the instruction set); square root as
  long as a divide, store one (gcc/config/arm/cortex-m4-fpu.md in the GNU Compiler Collection). Two loads
  stand beside every operation, one beside a square root, as in code that keeps its words in memory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class Processor:
    """Operation times in s; `square_root_s` None: a subroutine."""

    name: str
    doc: str
    add_s: float
    multiply_s: float
    divide_s: float
    store_s: float
    square_root_s: float | None = None

    def time_s(self, operations: Mapping[str, int]) -> float:
        """How long these operations take, one after the other."""
        divisions, additions = operations.get("divide", 0), operations.get("add", 0)
        roots, root_s = operations.get("square_root", 0), self.square_root_s
        if root_s is None:
            root_s = NEWTON_STEPS * (self.divide_s + self.add_s)
        return (
            additions * self.add_s
            + operations.get("multiply", 0) * self.multiply_s
            + divisions * self.divide_s
            + operations.get("store", 0) * self.store_s
            + roots * root_s
        )


OPERATIONS = ("add", "multiply", "divide", "square_root", "store")
NEWTON_STEPS = 3
_ADD = {"add": 1}
_POLYNOMIAL = {"add": 6, "multiply": 6}


def _of(*parts: Mapping[str, int]) -> Mapping[str, int]:
    total: Counter[str] = Counter()
    for part in parts:
        total.update(part)
    return MappingProxyType(dict(total))


_DIVIDE, _MULTIPLY, _ROOT = {"divide": 1}, {"multiply": 1}, {"square_root": 1}
# Operations of the tape by name; any other is a function of one polynomial.
_COST: Mapping[str, Mapping[str, int]] = {
    "copy": {"store": 1},
    **dict.fromkeys(("add", "sub", "neg", "abs", "sign", "min", "max", "not", "and", "or"), _ADD),
    **dict.fromkeys(
        ("lt", "le", "gt", "ge", "eq", "ne", "select", "skip", "floor", "ceil", "round"), _ADD
    ),
    **{key: {"add": 2} for key in ("limit", "dead_zone")},
    "mul": _MULTIPLY,
    "div": _DIVIDE,
    "sqrt": _ROOT,
    "hypot": _of(_ROOT, {"multiply": 2}, _ADD),
    "mod": _of(_DIVIDE, _MULTIPLY, {"add": 2}),
    "pow": _of(_POLYNOMIAL, _POLYNOMIAL, _MULTIPLY),
    "tan": _of(_POLYNOMIAL, _POLYNOMIAL, _DIVIDE),
    "asin": _of(_POLYNOMIAL, _ROOT),
    "acos": _of(_POLYNOMIAL, _ROOT),
    "atan2": _of(_POLYNOMIAL, _DIVIDE),
    **dict.fromkeys(("sinh", "cosh", "tanh"), _of(_POLYNOMIAL, _DIVIDE, {"add": 2})),
    **dict.fromkeys(("asinh", "acosh"), _of(_POLYNOMIAL, _ROOT, _MULTIPLY, {"add": 2})),
    "atanh": _of(_POLYNOMIAL, _DIVIDE, {"add": 2}),
}


def operations_of(codes: Iterable[str]) -> dict[str, int]:
    """How many additions, multiplications, divisions, square roots and stores these operations are.

    Args: codes: names of the tape's operations, lower case.
    """
    total: Counter[str] = Counter()
    for code, times in Counter(codes).items():
        for operation, count in _COST.get(code, _POLYNOMIAL).items():
            total[operation] += times * count
    return {operation: total[operation] for operation in OPERATIONS}


def _by_cycles(
    name: str, doc: str, cycle_s: float, *cycles: int, root: int | None = None
) -> Processor:
    add, multiply, divide, store = (cycle_s * count for count in cycles)
    return Processor(name, doc, add, multiply, divide, store, cycle_s * root if root else None)


PROCESSORS: Mapping[str, Processor] = MappingProxyType(
    {
        processor.name: processor
        for processor in (
            _by_cycles("ibm_7090", "IBM 7090, fixed point, 1959", 2.18e-6, 2, 14, 14, 2),
            Processor("ibm_1620", "IBM 1620, floating point, 1959", 1.2e-3, 12.5e-3, 41.7e-3, 0.0),
            _by_cycles(
                "apollo_guidance_computer",
                "Apollo Guidance Computer, Block II, 1966",
                11.72e-6,
                2,
                4,
                7,
                2,
            ),
            _by_cycles("cdc_6600", "Control Data 6600, floating point, 1964", 1e-7, 4, 10, 29, 3),
            _by_cycles(
                "cortex_m4f",
                "Arm Cortex-M4F microcontroller of 48 MHz",
                1.0 / 48e6,
                5,
                5,
                18,
                1,
                root=16,
            ),
        )
    }
)
