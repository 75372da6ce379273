"""The instruction set that the compiled core uses on this machine."""

from gsut._core import active_isa, available_isas, set_isa

__all__ = ["active_isa", "available_isas", "set_isa"]
