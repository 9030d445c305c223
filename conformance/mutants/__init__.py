"""Programs with one mistake each: what the vectors are for is to find every one of them."""

from __future__ import annotations

from . import arithmetic, coding, damage, javascript, reading, writing
from .mutant import Mutant

MUTANTS: tuple[Mutant, ...] = (
    *arithmetic.MUTANTS,
    *coding.MUTANTS,
    *reading.MUTANTS,
    *damage.MUTANTS,
    *writing.MUTANTS,
    *javascript.MUTANTS,
)
