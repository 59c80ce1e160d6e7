"""Digital processors by name: how long their operations take.

Stage 0 for `tasks`. The time of a cycle is the sum over its operations, one after the other;
`operations` says how many a program has. A square root, where the machine has none, is three steps of
Newton's method, a division and an addition each. Reading operands is in the published times of the
machines that read them from memory.

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

from collections.abc import Mapping
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


NEWTON_STEPS = 3


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
