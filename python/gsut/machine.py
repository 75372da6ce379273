"""How the compiled core was built, and the instruction set that it uses on this machine."""

from gsut import _core
from gsut._core import active_isa, available_isas, describe_build, set_isa
from gsut.bounds import check_number, name_wrong_kinds

__all__ = ["active_isa", "available_isas", "describe_build", "set_isa"]


@name_wrong_kinds
def set_num_threads(num_threads: int) -> None:
    """Sets the number of threads of all parallel loops. Results do not depend on it.

    Args:
        num_threads: at least 1; 0: all processors.

    Raises:
        InputError: no such number.
    """
    _core.set_num_threads(check_number(num_threads, "num_threads", 0, whole=True))
