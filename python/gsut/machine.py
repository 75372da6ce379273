"""How the compiled core was built, and the instruction set that it uses on this machine."""

from gsut._core import active_isa, available_isas, describe_build, set_isa

__all__ = ["active_isa", "available_isas", "describe_build", "set_isa"]
