"""Times as whole nanoseconds, read from decimal text without a rounding."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from decimal import Decimal, InvalidOperation

import numpy as np

NANOSECONDS = 1_000_000_000  # in a second
UNITS = {"s": NANOSECONDS, "ms": 1_000_000, "us": 1_000, "ns": 1}
_FARTHEST = 2**62  # so that differences fit into 64 bits
# Seconds since 1970 have 10 digits before the point today, and each finer unit three more.
_LEAST = {"ns": Decimal(10) ** 17, "us": Decimal(10) ** 14, "ms": Decimal(10) ** 11}


def is_time(text: str) -> bool:
    """Returns whether this is a finite decimal number."""
    return _parse_decimal(text) is not None


def guess_unit(texts: Iterable[str]) -> str:
    """Guesses the unit of times since 1970 by the digits of the largest; "s" for smaller ones."""
    largest = max((abs(_parse_decimal(text) or Decimal(0)) for text in texts), default=Decimal(0))
    return next((unit for unit, least in _LEAST.items() if largest >= least), "s")


def to_nanoseconds(texts: Sequence[str], unit: str) -> np.ndarray:
    """Converts decimal numbers in this unit, see `UNITS`, to (N,) int64; 146 years at most."""
    times = (_convert(text, unit) for text in texts)
    return np.array([max(-_FARTHEST, min(time, _FARTHEST)) for time in times], np.int64)


def format_range(texts: Iterable[str], unit: str) -> str:
    """Formats the first and the last time, in seconds."""
    times = [_convert(text, unit) for text in texts]
    return f"{format_seconds(min(times))} to {format_seconds(max(times))} s"


def _convert(text: str, unit: str) -> int:
    return round((_parse_decimal(text) or Decimal(0)) * UNITS[unit])


def format_seconds(nanoseconds: int) -> str:
    """Formats a time as decimal seconds with nine digits."""
    sign, rest = "-" if nanoseconds < 0 else "", abs(int(nanoseconds))
    return f"{sign}{rest // NANOSECONDS}.{rest % NANOSECONDS:09d}"


def _parse_decimal(text: str) -> Decimal | None:
    try:
        value = Decimal(text)
    except InvalidOperation:
        return None
    return value if value.is_finite() else None
