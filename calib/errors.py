"""The ways in which a calibration can fail; gsut's command line prints each as one sentence."""

import gsut


class BoardError(gsut.InputError):
    """The photographs or arguments do not allow a calibration; the message names which."""


class SolveError(gsut.SolveError):
    """The photographs are readable, but no trustworthy lens came out of them."""


class MisfitError(SolveError):
    """Some boards do not fit the lens on which the others agree.

    Args:
        message: one sentence. indices: of these photographs, in the order that was solved.
    """

    def __init__(self, message: str, indices: list[int]) -> None:
        super().__init__(message)
        self.indices = indices
