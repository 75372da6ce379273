"""The two ways in which a calibration can fail."""


class BoardError(ValueError):
    """The photographs or arguments are not what a calibration needs: one sentence, naming which."""


class SolveError(RuntimeError):
    """The photographs are readable, but no lens that can be trusted came out of them."""
