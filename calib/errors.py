"""The two ways in which a calibration can fail."""


class BoardError(ValueError):
    """The photographs or arguments are not what a calibration needs: one sentence, naming which."""


class SolveError(RuntimeError):
    """The photographs are readable, but no lens that can be trusted came out of them."""


class MisfitError(SolveError):
    """Boards that do not fit the lens on which the others agree.

    Args:
        message: one sentence. indices: of the photographs, in the order that was solved.
    """

    def __init__(self, message: str, indices: list[int]) -> None:
        super().__init__(message)
        self.indices = indices
